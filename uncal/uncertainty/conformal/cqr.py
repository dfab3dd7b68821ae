"""Conformalised quantile regression: the network's own quantiles, made to cover."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor

from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.intervals import Anchors


class QuantileCalibrator(IntervalCalibrator):
    """Intervals [l - Q, u + Q] around the quantile outputs l, u of the network.

    s = max(l - y, y - u), Q = s_(⌈(m+1)(1-α)⌉)   (Romano, Patterson, Candès 2019, eqs. 6-8)

    Holds each output with probability at least 1-α, whatever the quantile outputs are worth. Q is
    negative where they are too wide. Where l - Q > u + Q the set of targets with a score up to Q
    is empty, and the answer is the one point (l + u)/2: more than the empty set, so the guarantee
    stays. The box of :meth:`predict_joint` has the score max_j s_j / scale_j.

    Args:
        names: the outputs' names in messages.
        scales: (D,) such as the largest decalibration per output, in its units; constants. None
            for ones.

    Raises:
        ConfigurationError: scales that are not positive and finite.

    >>> zeros, target = torch.zeros(9, 1), torch.arange(1.0, 10.0)[:, None]
    >>> calibrator = QuantileCalibrator()
    >>> _ = calibrator.fit(zeros, zeros, target, bounds=(zeros, zeros + 5))
    >>> calibrator.quantile(0.8).item()  # of the scores -1, -2, -2, -1, 0, 1, 2, 3, 4
    3.0
    >>> intervals = calibrator.predict(zeros, zeros, 0.8, bounds=(zeros, zeros + 5))
    >>> intervals.lower[0].item(), intervals.upper[0].item()
    (-3.0, 8.0)
    """

    kind: ClassVar[str] = "quantile"
    needs_std: ClassVar[bool] = False
    needs_bounds: ClassVar[bool] = True

    def __init__(
        self, names: Sequence[str] | None = None, scales: Sequence[float] | None = None
    ) -> None:
        """Make an unfitted calibrator."""
        super().__init__(names, scales=scales)

    def _anchors(self, mean: Tensor, std: Tensor, bounds: tuple[Tensor, Tensor] | None) -> Anchors:
        lower, upper = self._check.bounds(bounds, mean.shape)
        return Anchors(lower, upper, torch.ones_like(lower))
