"""Settings of the simulator: frozen, complete, checked; every default lives in the YAML.

The groups mirror ``conf/simulation/street.yaml``, which says what each key means.
"""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Annotated, ClassVar, TypeVar, cast, get_type_hints

from uncal.errors import ConfigurationError

VERSION = 1
"""Raised whenever the same settings would no longer give the same files."""

MAX_RIGS = 3652
"""One rig per calendar day of ten years."""

GroupT = TypeVar("GroupT", bound="SettingsGroup")


@dataclass(frozen=True)
class Within:
    """Bounds of a setting, both allowed; an annotation of its field."""

    low: float
    high: float


@dataclass(frozen=True)
class SettingsGroup:
    """A group of settings that checks its own bounds and can be built from a mapping."""

    key: ClassVar[str] = "simulation"

    def __post_init__(self) -> None:
        """Check every bounded field.

        Raises:
            ConfigurationError: names the key, its value and the bound.
        """
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            for bound in getattr(hint, "__metadata__", ()):
                value = getattr(self, name)
                if not bound.low <= value <= bound.high:
                    raise ConfigurationError(
                        f"{self.key}.{name} is {value}; it must lie between {bound.low} and "
                        f"{bound.high}"
                    )

    def require_order(self, lower: str, upper: str) -> None:
        """Raise unless the field ``lower`` is smaller than the field ``upper``."""
        if not getattr(self, lower) < getattr(self, upper):
            raise ConfigurationError(
                f"{self.key}.{lower} is {getattr(self, lower)}; it must be smaller than "
                f"{self.key}.{upper}, which is {getattr(self, upper)}"
            )

    @classmethod
    def from_mapping(cls: type[GroupT], mapping: Mapping[str, object]) -> GroupT:
        """Build the group from a plain or OmegaConf mapping.

        Args:
            mapping: exactly the keys of this class; nested groups are mappings themselves.

        Raises:
            ConfigurationError: a key is unknown or missing, or a value has the wrong type or lies
                out of bounds.
        """
        hints = get_type_hints(cls)
        names = [item.name for item in fields(cls)]
        for key in mapping:
            if key not in names:
                close = difflib.get_close_matches(str(key), names, n=1)
                hint = f"; did you mean {cls.key}.{close[0]}?" if close else ""
                raise ConfigurationError(
                    f"unknown setting {cls.key}.{key}{hint} Known here: {', '.join(names)}"
                )
        missing = [name for name in names if name not in mapping]
        if missing:
            raise ConfigurationError(
                f"missing setting {', '.join(f'{cls.key}.{name}' for name in missing)}; "
                "conf/simulation/street.yaml lists every key with its unit"
            )
        return cls(**{name: _convert(cls.key, name, hints[name], mapping[name]) for name in names})


def _convert(group: str, name: str, expected: type, value: object) -> object:
    """Turn a YAML value into the field's type without losing anything."""
    if issubclass(expected, SettingsGroup):
        if not isinstance(value, Mapping):
            raise ConfigurationError(f"{group}.{name} is {value!r}; it must be a group of keys")
        return expected.from_mapping(cast(Mapping[str, object], value))
    if expected is bool and isinstance(value, bool):
        return value
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if expected is float and is_number:
        return float(cast(float, value))
    if expected is int and is_number and float(cast(float, value)).is_integer():
        return int(cast(float, value))
    kind = {bool: "true or false", int: "a whole number", float: "a number"}[expected]
    raise ConfigurationError(f"{group}.{name} is {value!r}; it must be {kind}")


@dataclass(frozen=True)
class CameraSettings(SettingsGroup):
    """The pinhole camera; see the YAML for units."""

    key: ClassVar[str] = "simulation.camera"
    height: Annotated[int, Within(8, 4096)]
    width: Annotated[int, Within(8, 4096)]
    focal_px: Annotated[float, Within(4.0, 10000.0)]
    supersampling: Annotated[int, Within(1, 8)]
    shadows: bool
    exposure: Annotated[float, Within(0.05, 20.0)]
    noise: Annotated[float, Within(0.0, 0.5)]
    vignetting: Annotated[float, Within(0.0, 1.0)]
    haze_m: Annotated[float, Within(10.0, 1e6)]


@dataclass(frozen=True)
class LidarSettings(SettingsGroup):
    """The spinning LiDAR; see the YAML for units."""

    key: ClassVar[str] = "simulation.lidar"
    beams: Annotated[int, Within(1, 512)]
    elevation_min_deg: Annotated[float, Within(-89.0, 89.0)]
    elevation_max_deg: Annotated[float, Within(-89.0, 89.0)]
    beam_jitter_deg: Annotated[float, Within(0.0, 2.0)]
    azimuth_step_deg: Annotated[float, Within(0.01, 45.0)]
    azimuth_fov_deg: Annotated[float, Within(1.0, 360.0)]
    range_min_m: Annotated[float, Within(0.0, 50.0)]
    range_max_m: Annotated[float, Within(1.0, 500.0)]
    range_noise_m: Annotated[float, Within(0.0, 1.0)]
    reflectance_noise: Annotated[float, Within(0.0, 1.0)]
    dropout: Annotated[float, Within(0.0, 0.99)]

    def __post_init__(self) -> None:
        """Check bounds and the order of pairs."""
        super().__post_init__()
        if self.beams > 1:
            self.require_order("elevation_min_deg", "elevation_max_deg")
        self.require_order("range_min_m", "range_max_m")


@dataclass(frozen=True)
class RigSettings(SettingsGroup):
    """How one rig (date folder) differs from the next."""

    key: ClassVar[str] = "simulation.rig"
    rotation_deg: Annotated[float, Within(0.0, 30.0)]
    translation_cm: Annotated[float, Within(0.0, 200.0)]
    focal_percent: Annotated[float, Within(0.0, 50.0)]
    principal_point_px: Annotated[float, Within(0.0, 200.0)]
    lidar_attitude_deg: Annotated[float, Within(0.0, 30.0)]
    lidar_height_m: Annotated[float, Within(0.3, 10.0)]
    lidar_height_variation_m: Annotated[float, Within(0.0, 2.0)]


@dataclass(frozen=True)
class VehicleSettings(SettingsGroup):
    """How the vehicle moves along the street and sways."""

    key: ClassVar[str] = "simulation.vehicle"
    speed_mps: Annotated[float, Within(0.0, 60.0)]
    frame_interval_s: Annotated[float, Within(0.001, 100.0)]
    attitude_deg: Annotated[float, Within(0.0, 20.0)]
    height_m: Annotated[float, Within(0.0, 0.5)]
    heading_deg: Annotated[float, Within(0.0, 30.0)]
    drift_m: Annotated[float, Within(0.0, 1.5)]


@dataclass(frozen=True)
class SceneSettings(SettingsGroup):
    """How densely the street is furnished."""

    key: ClassVar[str] = "simulation.scene"
    view_m: Annotated[float, Within(40.0, 400.0)]
    bend_deg: Annotated[float, Within(0.0, 10.0)]
    slope_deg: Annotated[float, Within(0.0, 5.0)]
    crossing_probability: Annotated[float, Within(0.0, 1.0)]
    building_gap_probability: Annotated[float, Within(0.0, 1.0)]
    building_height_m: Annotated[float, Within(2.5, 60.0)]
    parked_cars_per_100m: Annotated[float, Within(0.0, 30.0)]
    moving_cars_per_100m: Annotated[float, Within(0.0, 15.0)]
    poles_per_100m: Annotated[float, Within(0.0, 60.0)]
    trees_per_100m: Annotated[float, Within(0.0, 60.0)]
    pedestrians_per_100m: Annotated[float, Within(0.0, 100.0)]
    clutter_per_100m: Annotated[float, Within(0.0, 200.0)]


@dataclass(frozen=True)
class SimulationSettings(SettingsGroup):
    """Everything that determines the simulated files.

    Two equal settings give byte-identical recordings on one platform.
    """

    key: ClassVar[str] = "simulation"
    seed: Annotated[int, Within(0, 2**63 - 1)]
    n_rigs: Annotated[int, Within(1, MAX_RIGS)]
    drives_per_rig: Annotated[int, Within(1, 9999)]
    frames_per_drive: Annotated[int, Within(1, 1_000_000)]
    camera: CameraSettings
    lidar: LidarSettings
    rig: RigSettings
    vehicle: VehicleSettings
    scene: SceneSettings

    @property
    def n_frames(self) -> int:
        """Frames of all drives of all rigs."""
        return self.n_rigs * self.drives_per_rig * self.frames_per_drive

    def as_dict(self) -> dict[str, object]:
        """Nested plain values, as written into the manifest."""
        return asdict(self)

    def fingerprint(self) -> str:
        """Hash of the settings and of :data:`VERSION`: equal fingerprint, equal files."""
        text = json.dumps({"version": VERSION, **self.as_dict()}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]
