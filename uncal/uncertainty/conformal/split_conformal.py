"""The interval methods that know no groups: split conformal (eqs. 3-5), its relatives, plain σ.

Arguments and errors are those of :class:`uncal.uncertainty.IntervalCalibrator`
as far as a method takes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from statistics import NormalDist
from typing import ClassVar

import torch
from torch import Tensor

from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.intervals import Anchors


class ConformalCalibrator(IntervalCalibrator):
    """Intervals that hold each output, or all at once, with probability at least 1-α.

    s = |ŷ - y| / max(σ, floor), Q = s_(⌈(m+1)(1-α)⌉), [ŷ - Q σ, ŷ + Q σ]   (paper, eqs. 3-5)

    The guarantee is per output, over the draw of the uncertainty calibration set and of a frame
    exchangeable with its frames; that of :meth:`predict_joint`, with the score max_j s_j, is for
    the box as a whole.

    >>> target = torch.arange(1.0, 101.0)[:, None]
    >>> calibrator = ConformalCalibrator()
    >>> _ = calibrator.fit(torch.zeros(100, 1), torch.ones(100, 1), target)
    >>> intervals = calibrator.predict(torch.zeros(1), 2 * torch.ones(1), level=0.9)
    >>> intervals.lower.item(), intervals.upper.item()
    (-182.0, 182.0)
    """

    kind: ClassVar[str] = "conformal"

    def __init__(self, names: Sequence[str] | None = None, sigma_floor: float = 0.0) -> None:
        super().__init__(names, sigma_floor)

    def _anchors(self, mean: Tensor, std: Tensor, bounds: tuple[Tensor, Tensor] | None) -> Anchors:
        return Anchors(mean, mean, std)


class _WithoutStd(IntervalCalibrator):
    """Scores that look at no σ, so that the joint score needs scales: metres beside radians."""

    needs_std: ClassVar[bool] = False

    def __init__(
        self, names: Sequence[str] | None = None, scales: Sequence[float] | None = None
    ) -> None:
        super().__init__(names, scales=scales)


class AbsoluteCalibrator(_WithoutStd):
    """Intervals [ŷ - Q, ŷ + Q] that hold each output with probability at least 1-α.

    s = |ŷ - y|, Q = s_(⌈(m+1)(1-α)⌉): what conformal prediction gives without any σ, and so the
    measure of what σ adds. The box of :meth:`predict_joint` has the score max_j |r_j| / scale_j
    and half widths Q·scale_j.

    >>> target = torch.arange(1.0, 10.0)[:, None] * torch.tensor([0.1, 1.0])
    >>> zeros = torch.zeros(9, 2)
    >>> calibrator = AbsoluteCalibrator(scales=[0.1, 2.0]).fit(zeros, zeros, target)
    >>> calibrator.predict(zeros[0], zeros[0], 0.5).upper
    tensor([0.5000, 5.0000])
    >>> calibrator.predict_joint(zeros[0], zeros[0], 0.5).upper
    tensor([ 0.5000, 10.0000])
    """

    kind: ClassVar[str] = "absolute"

    def _anchors(self, mean: Tensor, std: Tensor, bounds: tuple[Tensor, Tensor] | None) -> Anchors:
        return Anchors(mean, mean, torch.ones_like(mean))


class QuantileCalibrator(_WithoutStd):
    """Intervals [l - Q, u + Q] around the quantile outputs l, u of the network.

    s = max(l - y, y - u), Q = s_(⌈(m+1)(1-α)⌉)   (Romano, Patterson, Candès 2019, eqs. 6-8)

    Holds each output with probability at least 1-α, whatever the quantile outputs are worth. Q is
    negative where they are too wide. Where l - Q > u + Q the set of targets with a score up to Q
    is empty, and the answer is the one point (l + u)/2: more than the empty set, so the guarantee
    stays. The box of :meth:`predict_joint` has the score max_j s_j / scale_j.

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
    needs_bounds: ClassVar[bool] = True

    def _anchors(self, mean: Tensor, std: Tensor, bounds: tuple[Tensor, Tensor] | None) -> Anchors:
        lower, upper = self._check.bounds(bounds, mean.shape)
        return Anchors(lower, upper, torch.ones_like(lower))


class GaussianIntervals(IntervalCalibrator):
    """MC dropout alone: [ŷ - z σ, ŷ + z σ] with z = Φ⁻¹(1 - α/2)   (paper, Table 2).

    No guarantee: it covers 1-α only where the error is normal with the standard deviation σ.
    The box of :meth:`predict_joint` takes the outputs' errors for independent: P(max_j |Z_j| ≤ z)
    = (2Φ(z) - 1)^D = 1-α, so that z is that of the level (1-α)^(1/D) per output. Errors that are
    normal and correlated are covered at least as often (Šidák's inequality), and Bonferroni's z
    is a little larger still.

    The fit learns no scores; it notes the predictor, the number of samples and of outputs.

    >>> zeros, ones = torch.zeros(5, 2), torch.ones(5, 2)
    >>> intervals = GaussianIntervals().fit(zeros, ones, zeros)
    >>> intervals.predict(zeros[0], ones[0], level=0.9).upper
    tensor([1.6449, 1.6449])
    >>> intervals.predict_joint(zeros[0], ones[0], level=0.9).upper
    tensor([1.9488, 1.9488])
    """

    kind: ClassVar[str] = "gaussian"
    guaranteed: ClassVar[bool] = False

    def __init__(self, names: Sequence[str] | None = None, sigma_floor: float = 0.0) -> None:
        super().__init__(names, sigma_floor)

    def _anchors(self, mean: Tensor, std: Tensor, bounds: tuple[Tensor, Tensor] | None) -> Anchors:
        return Anchors(mean, mean, std)

    def _learn(self, scores: Tensor, groups: Sequence[str]) -> None:
        """No scores, but how many outputs there are."""
        self.scores, self.joint_scores = scores[:0].clone(), scores[:0, 0].clone()

    def _pick(self, alpha: Fraction, *, joint: bool, groups: Sequence[str] | None) -> Tensor:
        size = self.scores.shape[1]
        # 1 - (1-α)^(1/D) without the cancellation of small α.
        miss = -math.expm1(math.log1p(-float(alpha)) / size) if joint else float(alpha)
        z = -NormalDist().inv_cdf(miss / 2)
        return self.scores.new_full((1 if joint else size,), z)
