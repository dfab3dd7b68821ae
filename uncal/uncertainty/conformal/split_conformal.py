"""Split conformal calibration of MC-dropout intervals, per degree of freedom (eqs. 3-5)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from torch import Tensor

from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.intervals import Anchors, Intervals
from uncal.uncertainty.conformal.quantile import (
    conformal_quantile,
    conformal_rank,
    miscoverage,
    samples_needed,
)

__all__ = [
    "ConformalCalibrator",
    "Intervals",
    "conformal_quantile",
    "conformal_rank",
    "miscoverage",
    "samples_needed",
]


class ConformalCalibrator(IntervalCalibrator):
    """Intervals that hold each output, or all at once, with probability at least 1-α.

    s = |ŷ - y| / max(σ, floor), Q = s_(⌈(m+1)(1-α)⌉), [ŷ - Q σ, ŷ + Q σ]   (paper, eqs. 3-5)

    The guarantee is per output, over the draw of the uncertainty calibration set and of a frame
    exchangeable with its frames; that of :meth:`predict_joint`, with the score max_j s_j, is for
    the box as a whole.

    Args:
        names: the outputs' names in messages.
        sigma_floor: smallest σ to divide by, in the network's own units.

    Raises:
        ConfigurationError: a negative or non-finite floor.

    >>> import torch
    >>> target = torch.arange(1.0, 101.0)[:, None]
    >>> calibrator = ConformalCalibrator()
    >>> _ = calibrator.fit(torch.zeros(100, 1), torch.ones(100, 1), target)
    >>> intervals = calibrator.predict(torch.zeros(1), 2 * torch.ones(1), level=0.9)
    >>> intervals.lower.item(), intervals.upper.item()
    (-182.0, 182.0)
    """

    kind: ClassVar[str] = "conformal"

    def __init__(self, names: Sequence[str] | None = None, sigma_floor: float = 0.0) -> None:
        """Make an unfitted calibrator."""
        super().__init__(names, sigma_floor)

    def _anchors(self, mean: Tensor, std: Tensor, bounds: tuple[Tensor, Tensor] | None) -> Anchors:
        return Anchors(mean, mean, std)
