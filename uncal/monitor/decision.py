"""From an estimate with its interval to a verdict and a sentence."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uncal.geometry.transforms import DOF_NAMES
from uncal.monitor.settings import DriftSettings, Limits
from uncal.monitor.verdict import DRIFTING, OK, RECALIBRATE, UNTRUSTED

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Interval:
    """An estimate and its regions, all in metres and radians.

    Attributes:
        correction: (6,).
        lower: (6,) of the interval of each DoF.
        upper: (6,).
        joint_lower: (6,) of the box that holds all six at once.
        joint_upper: (6,).
    """

    correction: Vector
    lower: Vector
    upper: Vector
    joint_lower: Vector
    joint_upper: Vector

    @classmethod
    def around(cls, mean: Vector, std: Vector, multiples: Vector) -> Interval:
        """``mean ± q σ``.

        Args:
            mean: (6,).
            std: (6,) σ.
            multiples: (7,) q of six DoF and of the joint box.
        """
        half, joint = multiples[:6] * std, multiples[6] * std
        return cls(mean, mean - half, mean + half, mean - joint, mean + joint)

    @classmethod
    def unknown(cls) -> Interval:
        """Without evidence: zeros, and the whole line."""
        zero, line = np.zeros(6), np.full(6, math.inf)
        return cls(zero, -line, line, -line, line)

    @property
    def away(self) -> NDArray[np.bool_]:
        """(6,) whether the joint box excludes zero in this DoF."""
        return self.beyond(np.zeros(6))

    def beyond(self, least: Vector) -> NDArray[np.bool_]:
        """(6,) whether all of the joint box lies on one side beyond some distance from zero.

        Args:
            least: (6,) distances, at least 0.
        """
        return np.asarray((self.joint_lower > least) | (self.joint_upper < -least))


def decide(
    interval: Interval,
    limits: Limits,
    drift: Interval,
    settings: DriftSettings,
    doubts: list[str],
    frames: int,
    window: int,
) -> tuple[str, str]:
    """Verdict and reason.

    Args:
        interval: of the estimate.
        limits: beyond which to recalibrate.
        drift: of the same estimate, at the level of a drift.
        settings: of a drift.
        doubts: why the estimate is not to be trusted; empty if it is.
        frames: whose evidence is in the estimate.
        window: how many there can be.
    """
    if doubts:
        return UNTRUSTED, "; ".join(doubts)
    beyond = np.abs(interval.correction) > limits.correction
    if beyond.any():
        j = _worst(np.abs(interval.correction) / limits.correction)
        return RECALIBRATE, (
            f"{DOF_NAMES[j]} is off by {_shown(interval.correction[j], j)}, more than "
            f"{_shown(limits.correction[j], j)}"
        )
    width = interval.upper - interval.lower
    away = drift.beyond(settings.least)
    # A window that is still filling is wide; a drift is one all the same.
    if (width > limits.width).any() and not (frames < window and away.any()):
        j = _worst(width / limits.width)
        wide = (
            f"the interval of {DOF_NAMES[j]} is {_shown(width[j], j)} wide, more than "
            f"{_shown(limits.width[j], j)}"
        )
        if frames < window:
            return UNTRUSTED, f"{frames} of {window} frames so far: {wide}"
        return RECALIBRATE, wide
    level = f"joint {100 * settings.level:g} % region"
    if away.any():
        gap = np.maximum(drift.joint_lower, -drift.joint_upper)
        j = _worst(np.where(away, gap / limits.correction, -math.inf))
        return DRIFTING, (
            f"the {level} excludes zero: {DOF_NAMES[j]} is off by "
            f"{_shown(drift.correction[j], j)} ({_shown(drift.joint_lower[j], j)} to "
            f"{_shown(drift.joint_upper[j], j)})"
        )
    return OK, f"the {level} holds zero, or comes next to it"


def _worst(values: Vector) -> int:
    return int(np.argmax(values))


def _shown(value: float, j: int) -> str:
    """For people: centimetres or degrees.

    >>> _shown(0.012, 0), _shown(math.radians(0.5), 5)
    ('1.2 cm', '0.50°')
    """
    return f"{100 * value:.1f} cm" if j < 3 else f"{math.degrees(value):.2f}°"
