"""The extrinsic in use: moved only on good evidence, in bounded steps, and back again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from uncal.errors import ConfigurationError
from uncal.geometry.decalibration import correct
from uncal.monitor.decision import Interval
from uncal.monitor.settings import UpdateSettings

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Change:
    """One entry of the history.

    Attributes:
        frame: that it was made at.
        reason: for people.
        before: (4, 4) T_cam_lidar until then.
        after: (4, 4) from then on.
    """

    frame: str
    reason: str
    before: Vector
    after: Vector

    def as_json(self) -> dict[str, object]:
        """A line of ``extrinsics.jsonl``."""
        return {
            "frame": self.frame,
            "reason": self.reason,
            "before": self.before.tolist(),
            "after": self.after.tolist(),
        }


def harmless_step(interval: Interval, largest: Vector) -> Vector:
    """How far to go towards an estimate so that no truth within the joint box makes it worse.

    A DoF moves only where the box excludes zero. Let the box say l ≤ d ≤ u with l > 0: a step s
    leaves |d - s| ≤ |d| exactly if s ≤ 2d, which s ≤ 2l ensures for every d of the box.

    Args:
        interval: of the estimate.
        largest: (6,) largest step.

    Returns:
        (6,) step, towards the estimate; 0 where the box holds zero.

    >>> line = np.array([3.0, 1, 1, 1, 1, 1])
    >>> box = Interval(line / 2, -line, line, np.array([0.5, -1, -1, -1, -1, -1]), line)
    >>> harmless_step(box, np.full(6, 5.0)).tolist()
    [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """
    nearest = np.maximum(np.maximum(interval.joint_lower, -interval.joint_upper), 0.0)
    size = np.minimum(np.minimum(2.0 * nearest, np.abs(interval.correction)), largest)
    return np.asarray(np.sign(interval.correction) * size)


class ExtrinsicInUse:
    """The extrinsic that everything else works with.

    Args:
        nominal: (4, 4) T_cam_lidar to begin with.
        settings: when and how far it moves.

    Attributes:
        current: (4, 4) T_cam_lidar in use.
        history: its changes, oldest first.
        agreed: frames in a row that spoke for a move.
    """

    def __init__(self, nominal: Vector, settings: UpdateSettings) -> None:
        self.nominal = np.array(nominal, float)
        self.current = self.nominal.copy()
        self.settings = settings
        self.history: list[Change] = []
        self.agreed = 0

    def consider(self, frame: str, interval: Interval, trusted: bool) -> Vector | None:
        """Move if the joint region has excluded zero for long enough.

        Args:
            frame: at hand.
            interval: of the estimate.
            trusted: whether it may be acted upon at all.

        Returns:
            (6,) decalibration taken out, metres and radians; None without a move.
        """
        self.agreed = self.agreed + 1 if trusted and interval.away.any() else 0
        if not self.settings.apply or self.agreed < self.settings.confirmations:
            return None
        step = harmless_step(interval, self.settings.step)
        self._move(frame, "the joint region excludes zero", after_step(self.current, step))
        return step

    def revert(self, frame: str, changes: int = 1) -> None:
        """Take back the last changes; that is a change of its own.

        Args:
            frame: at hand.
            changes: how many.

        Raises:
            ConfigurationError: there are not so many.
        """
        if not 1 <= changes <= len(self.history):
            raise ConfigurationError(
                f"revert={changes}: the extrinsic has been changed {len(self.history)} time(s)"
            )
        self._move(frame, f"taken back: {changes} change(s)", self.history[-changes].before)

    def _move(self, frame: str, reason: str, after: Vector) -> None:
        self.history.append(Change(frame, reason, self.current.copy(), after.copy()))
        self.current = after.copy()
        self.agreed = 0


def after_step(T_cam_lidar: Vector, step: Vector) -> Vector:
    """``T · D⁻¹``.

    Args:
        T_cam_lidar: (4, 4).
        step: (6,) decalibration to take out, metres and radians.
    """
    return np.asarray(correct(torch.from_numpy(T_cam_lidar), torch.from_numpy(step)).numpy())
