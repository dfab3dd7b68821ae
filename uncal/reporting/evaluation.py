"""Predictions on a test set and the calibrator that makes intervals of them."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Literal

from torch import Tensor

from uncal.metrics.pose_error import in_double
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.intervals import Intervals
from uncal.uncertainty.conformal.quantile import coverage_band, miscoverage

BAND_CONFIDENCE = 0.999
"""Probability with which the reference band holds the coverage of one DoF at one level."""

Guarantee = Literal["exact", "by group", "none"]
"""An interval method's guarantee: coverage with the Beta-Binomial law of pooled frames, coverage
within a group or for a new group (where that law does not apply), or none."""

_NO_GUARANTEE = {
    "none": "the interval method guarantees no coverage",
    "by group": "the interval method guarantees coverage by group, not for pooled frames",
}


class Evaluation:
    """A test set on the CPU in double precision, with a fitted calibrator.

    It has n samples, the uncertainty calibration set had m.

    Args:
        mean: (n, 6) estimated decalibration, metres and radians.
        std: (n, 6) σ of the estimate.
        target: (n, 6) true decalibration.
        calibrator: fitted on the uncertainty calibration set.
        groups: n labels, such as the drive or rig of each frame, or None.
        bounds: (n, 6) lower and upper quantile outputs of the network, or None.

    Raises:
        ValueError: shapes other than (n, 6), no samples, values that are not finite, or not one
            label per sample.
    """

    def __init__(
        self,
        mean: Tensor,
        std: Tensor,
        target: Tensor,
        calibrator: IntervalCalibrator,
        groups: Sequence[str] | None = None,
        bounds: tuple[Tensor, Tensor] | None = None,
    ) -> None:
        self.mean, self.std, self.target, *both = in_double(mean, std, target, *(bounds or ()))
        if groups is not None and (isinstance(groups, str) or len(groups) != len(mean)):
            raise ValueError(
                f"{len(groups)} groups for {len(mean)} samples; give a list of one label each."
            )
        self.calibrator, self.groups = calibrator, groups
        self.bounds = (both[0], both[1]) if both else None
        self.n, self.m = len(mean), int(calibrator.count)
        self.guarantee = guarantee_of(type(calibrator))
        self._intervals: dict[float | Fraction, Intervals] = {}

    def intervals(self, level: float | Fraction) -> Intervals:
        """The intervals per DoF at a level in (0, 1), computed once."""
        if level not in self._intervals:
            self._intervals[level] = self.calibrator.predict(
                self.mean, self.std, level, groups=self.groups, bounds=self.bounds
            )
        return self._intervals[level]

    def boxes(self, level: float | Fraction, method: Literal["max", "bonferroni"]) -> Intervals:
        """The boxes of all DoF at once, at a level in (0, 1) of the whole box."""
        return self.calibrator.predict_joint(
            self.mean, self.std, level, groups=self.groups, bounds=self.bounds, method=method
        )

    def band(self, level: float | Fraction, n: int | None = None) -> tuple[int, int]:
        """The reference band at a level, as covered samples among n (default: the test set's)."""
        return _band(self.n if n is None else n, self.m, miscoverage(level))


def guarantee_of(kind: type[IntervalCalibrator]) -> Guarantee:
    """What an interval method guarantees for exchangeable frames.

    >>> from uncal.uncertainty import ConformalCalibrator, GaussianIntervals
    >>> guarantee_of(ConformalCalibrator), guarantee_of(GaussianIntervals)
    ('exact', 'none')
    """
    if not kind.guaranteed:
        return "none"
    return "by group" if kind.needs_groups else "exact"


def band_caveat(guarantee: Guarantee, split_by: str, test: str = "own") -> str:
    """Why the coverage need not follow the Beta-Binomial law in a run; empty where it must.

    >>> band_caveat("exact", "frame"), band_caveat("none", "rig")
    ('', 'the interval method guarantees no coverage')
    """
    if guarantee != "exact":
        return _NO_GUARANTEE[guarantee]
    if test == "unseen":
        return "the test frames are of rigs that the uncertainty calibration set does not contain"
    if split_by != "frame":
        return f"the split is by {split_by}, so that its frames are not exchangeable"
    return ""


@lru_cache(maxsize=1024)
def _band(n: int, m: int, alpha: Fraction) -> tuple[int, int]:
    """:func:`coverage_band` at :data:`BAND_CONFIDENCE` as counts, since only those compare exactly.

    >>> _band(1000, 1000, Fraction(1, 10))
    (852, 940)
    """
    low, high = (round(n * bound) for bound in coverage_band(n, m, alpha, BAND_CONFIDENCE))
    return low, high


def percent(level: float | Fraction) -> float:
    """A level in 0..1 as percent; a float counts as the decimal it prints as.

    >>> percent(0.07)
    7.0
    """
    return float(100 * Fraction(str(level)))
