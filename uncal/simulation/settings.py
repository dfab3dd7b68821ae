"""Settings of the simulator: frozen, complete, checked; every default lives in the YAML.

The groups mirror ``conf/simulation/street.yaml``, ``event_street.yaml`` and ``motion/step.yaml``,
which say what each key means.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Annotated, ClassVar

from uncal.errors import ConfigurationError
from uncal.settings.group import SettingsGroup
from uncal.settings.rules import FLAG, number

VERSION = 3
"""Raised whenever the same settings would no longer give the same files."""

MAX_RIGS = 3652
"""One rig per calendar day of ten years."""

MAX_SEQUENCES = 26
MAX_SEQUENCE_S = 1800.0
"""26 sequences of half an hour each begin at 08:00 and end before midnight."""


@dataclass(frozen=True)
class CameraSettings(SettingsGroup):
    """The pinhole camera; see the YAML for units."""

    key: ClassVar[str] = "simulation.camera"
    height: Annotated[int, number(8, 4096, whole=True)]
    width: Annotated[int, number(8, 4096, whole=True)]
    focal_px: Annotated[float, number(4.0, 10000.0)]
    supersampling: Annotated[int, number(1, 8, whole=True)]
    shadows: Annotated[bool, FLAG]
    exposure: Annotated[float, number(0.05, 20.0)]
    noise: Annotated[float, number(0.0, 0.5)]
    vignetting: Annotated[float, number(0.0, 1.0)]
    haze_m: Annotated[float, number(10.0, 1e6)]
    exposure_stops: Annotated[float, number(0.0, 4.0)] = 0.0
    tint: Annotated[float, number(0.0, 0.9)] = 0.0
    blur_px: Annotated[float, number(0.0, 10.0)] = 0.0


@dataclass(frozen=True)
class LidarSettings(SettingsGroup):
    """The spinning LiDAR; see the YAML for units."""

    key: ClassVar[str] = "simulation.lidar"
    beams: Annotated[int, number(1, 512, whole=True)]
    elevation_min_deg: Annotated[float, number(-89.0, 89.0)]
    elevation_max_deg: Annotated[float, number(-89.0, 89.0)]
    beam_jitter_deg: Annotated[float, number(0.0, 2.0)]
    azimuth_step_deg: Annotated[float, number(0.01, 45.0)]
    azimuth_fov_deg: Annotated[float, number(1.0, 360.0)]
    range_min_m: Annotated[float, number(0.0, 50.0)]
    range_max_m: Annotated[float, number(1.0, 500.0)]
    range_noise_m: Annotated[float, number(0.0, 1.0)]
    reflectance_noise: Annotated[float, number(0.0, 1.0)]
    dropout: Annotated[float, number(0.0, 0.99)]
    hdl64: Annotated[bool, FLAG] = False
    range_bias_m: Annotated[float, number(0.0, 0.5)] = 0.0
    stagger: Annotated[bool, FLAG] = False
    motion_distortion: Annotated[bool, FLAG] = False
    laser_gain: Annotated[float, number(0.0, 3.0)] = 0.0

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
    rotation_deg: Annotated[float, number(0.0, 30.0)]
    translation_cm: Annotated[float, number(0.0, 200.0)]
    focal_percent: Annotated[float, number(0.0, 50.0)]
    principal_point_px: Annotated[float, number(0.0, 200.0)]
    lidar_attitude_deg: Annotated[float, number(0.0, 30.0)]
    lidar_height_m: Annotated[float, number(0.3, 10.0)]
    lidar_height_variation_m: Annotated[float, number(0.0, 2.0)]


@dataclass(frozen=True)
class VehicleSettings(SettingsGroup):
    """How the vehicle moves along the street and sways."""

    key: ClassVar[str] = "simulation.vehicle"
    speed_mps: Annotated[float, number(0.0, 60.0)]
    frame_interval_s: Annotated[float, number(0.001, 100.0)]
    attitude_deg: Annotated[float, number(0.0, 20.0)]
    height_m: Annotated[float, number(0.0, 0.5)]
    heading_deg: Annotated[float, number(0.0, 30.0)]
    drift_m: Annotated[float, number(0.0, 1.5)]
    speed_variation: Annotated[float, number(0.0, 0.99)] = 0.0


@dataclass(frozen=True)
class SceneSettings(SettingsGroup):
    """How densely the street is furnished."""

    key: ClassVar[str] = "simulation.scene"
    view_m: Annotated[float, number(40.0, 400.0)]
    bend_deg: Annotated[float, number(0.0, 10.0)]
    slope_deg: Annotated[float, number(0.0, 5.0)]
    crossing_probability: Annotated[float, number(0.0, 1.0)]
    building_gap_probability: Annotated[float, number(0.0, 1.0)]
    building_height_m: Annotated[float, number(2.5, 60.0)]
    parked_cars_per_100m: Annotated[float, number(0.0, 30.0)]
    moving_cars_per_100m: Annotated[float, number(0.0, 15.0)]
    poles_per_100m: Annotated[float, number(0.0, 60.0)]
    trees_per_100m: Annotated[float, number(0.0, 60.0)]
    pedestrians_per_100m: Annotated[float, number(0.0, 100.0)]
    clutter_per_100m: Annotated[float, number(0.0, 200.0)]


@dataclass(frozen=True)
class EventSettings(SettingsGroup):
    """The event camera, and the motion that it needs; see the YAML for units."""

    key: ClassVar[str] = "simulation.events"
    window_ms: Annotated[float, number(1.0, 1000.0)]
    subframes: Annotated[int, number(1, 1000, whole=True)]
    threshold_on: Annotated[float, number(0.02, 2.0)]
    threshold_off: Annotated[float, number(0.02, 2.0)]
    threshold_mismatch: Annotated[float, number(0.0, 0.5)]
    refractory_us: Annotated[float, number(0.0, 1e5)]
    noise_hz: Annotated[float, number(0.0, 1000.0)]
    dark: Annotated[float, number(1e-4, 1.0)]
    distortion: Annotated[float, number(-0.3, 0.3)]
    yaw_rate_deg_s: Annotated[float, number(0.0, 90.0)]
    sway_rate_deg_s: Annotated[float, number(0.0, 90.0)]


@dataclass(frozen=True)
class MotionSettings(SettingsGroup):
    """How the LiDAR moves in its mount during every drive; see the YAML for units."""

    key: ClassVar[str] = "simulation.motion"
    first_frame: Annotated[int, number(0, 1_000_000, whole=True)]
    ramp_frames: Annotated[int, number(1, 1_000_000, whole=True)]
    x_cm: Annotated[float, number(-100.0, 100.0)]
    y_cm: Annotated[float, number(-100.0, 100.0)]
    z_cm: Annotated[float, number(-100.0, 100.0)]
    roll_deg: Annotated[float, number(-10.0, 10.0)]
    pitch_deg: Annotated[float, number(-10.0, 10.0)]
    yaw_deg: Annotated[float, number(-10.0, 10.0)]
    vibration_cm: Annotated[float, number(0.0, 20.0)]
    vibration_deg: Annotated[float, number(0.0, 5.0)]
    vibration_hz: Annotated[float, number(0.0, 1000.0)]


@dataclass(frozen=True)
class SimulationSettings(SettingsGroup):
    """Everything that determines the simulated files.

    Two equal settings give byte-identical recordings on one platform. With ``events`` the camera
    is an event camera and the layout DSEC's; without, it takes pictures and the layout is KITTI's.
    With ``motion`` the LiDAR moves, and the calibration files do not follow.
    """

    key: ClassVar[str] = "simulation"
    seed: Annotated[int, number(0, 2**63 - 1, whole=True)]
    n_rigs: Annotated[int, number(1, MAX_RIGS, whole=True)]
    drives_per_rig: Annotated[int, number(1, 9999, whole=True)]
    frames_per_drive: Annotated[int, number(1, 1_000_000, whole=True)]
    camera: CameraSettings
    lidar: LidarSettings
    rig: RigSettings
    vehicle: VehicleSettings
    scene: SceneSettings
    events: EventSettings | None = None
    motion: MotionSettings | None = None

    def __post_init__(self) -> None:
        """Check bounds, that a motion begins, and that a recording with events fits its clocks."""
        super().__post_init__()
        if self.motion is not None and self.motion.first_frame >= self.frames_per_drive:
            raise ConfigurationError(
                f"simulation.motion.first_frame is {self.motion.first_frame}; it must be smaller "
                f"than simulation.frames_per_drive, which is {self.frames_per_drive}"
            )
        if self.events is None:
            return
        if self.drives_per_rig > MAX_SEQUENCES:
            raise ConfigurationError(
                f"simulation.drives_per_rig is {self.drives_per_rig}; with simulation.events at "
                f"most {MAX_SEQUENCES}, one per letter of DSEC's names"
            )
        if self.frames_per_drive * self.vehicle.frame_interval_s > MAX_SEQUENCE_S:
            raise ConfigurationError(
                f"simulation.frames_per_drive is {self.frames_per_drive}; with simulation.events "
                f"at most {int(MAX_SEQUENCE_S / self.vehicle.frame_interval_s)} fit into half an "
                "hour, one of DSEC's sequences; raise simulation.drives_per_rig instead"
            )
        if self.events.window_ms > 1000 * self.vehicle.frame_interval_s:
            raise ConfigurationError(
                f"simulation.events.window_ms is {self.events.window_ms}; it must not be longer "
                f"than simulation.vehicle.frame_interval_s, {self.vehicle.frame_interval_s} s"
            )

    @property
    def n_frames(self) -> int:
        """Frames of all drives of all rigs."""
        return self.n_rigs * self.drives_per_rig * self.frames_per_drive

    def as_dict(self) -> dict[str, object]:
        """Nested plain values, as written into the manifest; nothing where there is no group."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    def fingerprint(self) -> str:
        """Hash of the settings and of :data:`VERSION`: equal fingerprint, equal files."""
        text = json.dumps({"version": VERSION, **self.as_dict()}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]
