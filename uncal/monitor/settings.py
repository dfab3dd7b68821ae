"""Settings of the monitor; their defaults are in conf/monitor.yaml and nowhere else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf

from uncal.errors import ConfigurationError
from uncal.settings.configuration import CONFIG_DIR

ADAPTATIONS: tuple[str, ...] = ("off", "aci", "pid")
"""What adjusts the intervals where reference extrinsics arrive."""


EXCHANGEABLE: tuple[str, ...] = ("drive", "window")
"""A new drive, or other windows of drives like those of the references (which promises less)."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Beyond these the verdict is ``recalibrate``.

    Attributes:
        correction_cm: largest |correction| of a translation.
        correction_deg: of a rotation.
        width_cm: widest interval of a translation.
        width_deg: of a rotation.
    """

    correction_cm: float
    correction_deg: float
    width_cm: float
    width_deg: float

    @property
    def correction(self) -> NDArray[np.float64]:
        """(6,) metres and radians."""
        return per_dof(self.correction_cm, self.correction_deg)

    @property
    def width(self) -> NDArray[np.float64]:
        """(6,) metres and radians."""
        return per_dof(self.width_cm, self.width_deg)


@dataclass(frozen=True, kw_only=True)
class SensorLimits:
    """When a sensor gives nothing to go by.

    Attributes:
        min_points: of a sweep, all around.
        min_edges: of the sweep, in the image.
        min_brightness: mean of an image, 0..255.
        min_contrast: standard deviation of an image, 0..255.
        min_events: of an event camera's window.
        margin: how far beyond the range of the references an input may be, in widths of it.
        pairing: by how much a sweep may fit the image of another frame better than its own, in
            spreads of edge strength.
    """

    min_points: int
    min_edges: int
    min_brightness: float
    min_contrast: float
    min_events: int
    margin: float
    pairing: float


@dataclass(frozen=True, kw_only=True)
class AlarmSettings:
    """Of the exchangeability martingale.

    Attributes:
        false_alarm_rate: largest probability of an alarm within a period without a change.
        period: windows after which the test begins anew.
        recovery: windows in a row that must look like the references to end an alarm.
    """

    false_alarm_rate: float
    period: int
    recovery: int


@dataclass(frozen=True, kw_only=True)
class DriftSettings:
    """When a correction is a drift.

    Attributes:
        level: of the joint region that must exclude zero; as high as the references allow, if they
            are too few for it.
        least_cm: the region must lie beyond this in a translation, since no extrinsic is exact.
        least_deg: in a rotation.
        jump: a frame contradicts the window where it does so this many times as much as any of the
            references; two in a row empty the window.
    """

    level: float
    least_cm: float
    least_deg: float
    jump: float

    @property
    def least(self) -> NDArray[np.float64]:
        """(6,) metres and radians."""
        return per_dof(self.least_cm, self.least_deg)


@dataclass(frozen=True, kw_only=True)
class UpdateSettings:
    """When and how far the extrinsic in use moves.

    Attributes:
        apply: whether it moves at all; None: only with references of real recordings.
        confirmations: frames in a row whose joint region must exclude zero.
        step_cm: largest step of a translation.
        step_deg: of a rotation.
    """

    apply: bool | None
    confirmations: int
    step_cm: float
    step_deg: float

    @property
    def step(self) -> NDArray[np.float64]:
        """(6,) metres and radians."""
        return per_dof(self.step_cm, self.step_deg)


@dataclass(frozen=True, kw_only=True)
class MonitorSettings:
    """All that a monitor is told.

    Attributes:
        window: frames whose evidence adds up.
        forgetting: weight of a frame relative to the next one, in (0, 1].
        level: of the intervals and the joint region.
        exchangeable: one of :data:`EXCHANGEABLE`: what a new stream is like.
        limits: of the verdict ``recalibrate``.
        drift: of the verdict ``drifting``.
        sensors: of the verdict ``untrusted``.
        alarm: of the exchangeability martingale.
        update: of the extrinsic in use.
        adapt: one of :data:`ADAPTATIONS`.
        seed: of the dropout masks and of ties between p-values.
    """

    window: int
    forgetting: float
    level: float
    exchangeable: str
    limits: Limits
    drift: DriftSettings
    sensors: SensorLimits
    alarm: AlarmSettings
    update: UpdateSettings
    adapt: str
    seed: int

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ConfigurationError: one is out of its range.
        """
        _check("window", self.window, 1, 1000, whole=True)
        _check("forgetting", self.forgetting, 1e-3, 1)
        _check("level", self.level, 1e-6, 1 - 1e-6)
        _check("drift.level", self.drift.level, 1e-6, 1 - 1e-6)
        _check("drift.jump", self.drift.jump, 0, 1e9)
        _check("alarm.false_alarm_rate", self.alarm.false_alarm_rate, 1e-9, 0.5)
        _check("alarm.period", self.alarm.period, 1, 10**7, whole=True)
        _check("alarm.recovery", self.alarm.recovery, 1, 10**6, whole=True)
        _check("update.confirmations", self.update.confirmations, 1, 10**6, whole=True)
        positive = {
            **{f"limits.{name}": value for name, value in asdict(self.limits).items()},
            "update.step_cm": self.update.step_cm,
            "update.step_deg": self.update.step_deg,
        }
        for name in ("least_cm", "least_deg"):
            _check(f"drift.{name}", getattr(self.drift, name), 0, 1e6)
        for key, value in positive.items():
            _check(key, value, 1e-6, 1e6)
        for name, value in asdict(self.sensors).items():
            _check(f"sensors.{name}", value, 0, 1e9)
        words = {"adapt": ADAPTATIONS, "exchangeable": EXCHANGEABLE}
        for name, known in words.items():
            value = getattr(self, name)
            if value not in known:
                raise ConfigurationError(f"{name}={value}: expected one of {', '.join(known)}")

    @classmethod
    def of(cls, given: Mapping[str, object]) -> MonitorSettings:
        """Settings out of the keys of conf/monitor.yaml; others there are not looked at.

        Args:
            given: nested keys and values.

        Raises:
            ConfigurationError: a key is missing, unknown in its group or out of its range.
        """
        groups: dict[str, type] = {
            "limits": Limits,
            "drift": DriftSettings,
            "sensors": SensorLimits,
            "alarm": AlarmSettings,
            "update": UpdateSettings,
        }
        made: dict[str, object] = {}
        for field in fields(cls):
            if field.name not in given:
                raise ConfigurationError(f"{field.name}: must be given, as {field.name}=…")
            value = given[field.name]
            kind = groups.get(field.name)
            made[field.name] = value if kind is None else _group(kind, field.name, value)
        return cls(**made)  # type: ignore[arg-type]

    @classmethod
    def shipped(cls, **changes: object) -> MonitorSettings:
        """The defaults of conf/monitor.yaml, but for what is asked for.

        Args:
            **changes: keys of the YAML; a group takes a mapping of those keys that change.

        >>> MonitorSettings.shipped(window=4, limits={"width_cm": 20.0}).limits.width_cm
        20.0
        """
        shipped = cast("DictConfig", OmegaConf.load(Path(CONFIG_DIR) / "monitor.yaml"))
        names = {field.name for field in fields(cls)}
        if unknown := [name for name in changes if name not in names]:
            raise ConfigurationError(
                f"{', '.join(unknown)}: no setting of the monitor; it has "
                f"{', '.join(sorted(names))}"
            )
        own = {name: shipped[name] for name in names}
        merged = OmegaConf.merge(OmegaConf.create(own), OmegaConf.create(dict(changes)))
        return cls.of(cast("dict[str, object]", OmegaConf.to_container(merged, resolve=True)))


def per_dof(centimetres: float, degrees: float) -> NDArray[np.float64]:
    """(6,) metres and radians.

    >>> per_dof(10.0, 180.0)[[0, 5]].round(3).tolist()
    [0.1, 3.142]
    """
    return np.array([centimetres / 100.0] * 3 + [math.radians(degrees)] * 3)


def _group(kind: type, name: str, value: object) -> object:
    given = dict(cast("Mapping[str, object]", value))
    names = [field.name for field in fields(kind)]
    wrong = [key for key in given if key not in names] + [key for key in names if key not in given]
    if wrong:
        raise ConfigurationError(f"{name}.{wrong[0]}: {name} takes exactly {', '.join(names)}")
    return kind(**given)


def _check(key: str, value: object, low: float, high: float, whole: bool = False) -> None:
    kinds = (int,) if whole else (int, float)
    if isinstance(value, bool) or not isinstance(value, kinds) or not low <= value <= high:
        kind = "a whole number" if whole else "a number"
        raise ConfigurationError(f"{key}={value}: expected {kind} from {low:g} to {high:g}")
