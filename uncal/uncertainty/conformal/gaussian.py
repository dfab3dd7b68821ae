"""Intervals that take σ for the standard deviation of a normal error: no calibration at all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from statistics import NormalDist
from typing import ClassVar

from torch import Tensor

from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.intervals import Anchors


class GaussianIntervals(IntervalCalibrator):
    """MC dropout alone: [ŷ - z σ, ŷ + z σ] with z = Φ⁻¹(1 - α/2)   (paper, Table 2).

    No guarantee: it covers 1-α only where the error is normal with the standard deviation σ.
    The box of :meth:`predict_joint` takes the outputs' errors for independent: P(max_j |Z_j| ≤ z)
    = (2Φ(z) - 1)^D = 1-α, so that z is that of the level (1-α)^(1/D) per output. Errors that are
    normal and correlated are covered at least as often (Šidák's inequality), and Bonferroni's z
    is a little larger still.

    The fit learns no scores; it notes the predictor, the number of samples and of outputs.

    Args:
        names: the outputs' names in messages.
        sigma_floor: smallest σ to use, in the network's own units.

    Raises:
        ConfigurationError: a negative or non-finite floor.

    >>> import torch
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
        """Make an instance that knows no predictor yet."""
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
