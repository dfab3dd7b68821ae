"""What the monitor says of one frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

OK, DRIFTING, RECALIBRATE, UNTRUSTED = "ok", "drifting", "recalibrate", "untrusted"

VERDICTS: tuple[str, ...] = (OK, DRIFTING, RECALIBRATE, UNTRUSTED)
"""All is well; the joint region excludes zero; a limit is exceeded; do not believe the estimate."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One frame's estimate, interval and verdict.

    DoF in the order of :data:`uncal.geometry.DOF_NAMES`, in the LiDAR frame. The correction is the
    estimated decalibration of the extrinsic in use before this frame: with the true extrinsic T,
    ``T_used = T · D``, and ``T_used · D̂⁻¹`` is the estimate of T.

    Attributes:
        frame: name of the frame, ``rig/drive/0000000007``.
        time: of the frame, seconds; NaN where the recording has none.
        correction: (6,) D̂, metres and radians; zeros without evidence.
        lower: (6,) of the interval of each DoF; -inf where too little is known.
        upper: (6,) of the same.
        sigma: (6,) σ of the estimate; infinite without evidence.
        joint_lower: (6,) of the box that holds all six DoF at once.
        joint_upper: (6,) of the same.
        verdict: one of :data:`VERDICTS`.
        reason: a sentence for people.
        extrinsic: (4, 4) T_cam_lidar in use from here on.
        updated: whether this frame changed the extrinsic in use.
        frames: number of frames whose evidence is in the estimate.
        wealth: of the exchangeability martingale; it fires at 1 / false-alarm rate.
    """

    frame: str
    time: float
    correction: Vector
    lower: Vector
    upper: Vector
    sigma: Vector
    joint_lower: Vector
    joint_upper: Vector
    verdict: str
    reason: str
    extrinsic: Vector
    updated: bool
    frames: int
    wealth: float

    def as_json(self) -> dict[str, object]:
        """What a line of ``monitor.jsonl`` holds; what is not finite is null there."""
        return {
            "frame": self.frame,
            "time": _number(self.time),
            "verdict": self.verdict,
            "reason": self.reason,
            "correction": _numbers(self.correction),
            "lower": _numbers(self.lower),
            "upper": _numbers(self.upper),
            "sigma": _numbers(self.sigma),
            "joint_lower": _numbers(self.joint_lower),
            "joint_upper": _numbers(self.joint_upper),
            "extrinsic": [_numbers(row) for row in self.extrinsic],
            "updated": self.updated,
            "frames": self.frames,
            "wealth": _number(self.wealth),
        }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(values: Vector) -> list[float | None]:
    return [_number(value) for value in values]
