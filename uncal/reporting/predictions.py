"""What was predicted on a test set, in the form in which every table wants it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Literal

from torch import Tensor

from uncal.geometry import DOF_NAMES
from uncal.uncertainty.calibrator import IntervalCalibrator
from uncal.uncertainty.coverage_law import coverage_band
from uncal.uncertainty.intervals import Intervals

BAND_CONFIDENCE = 0.999
"""Probability with which the exact law's band holds the coverage of one DoF at one level."""

Promise = Literal["exact", "by group", "none"]
"""What an interval method promises: coverage with the exact law of pooled frames, coverage within
a group or for a new group (where that law does not hold), or nothing."""


@dataclass(frozen=True)
class Predictions:
    """Predictions on a test set, on the CPU in double precision; make it with :meth:`of`.

    Attributes:
        mean: (n, 6) estimated decalibration, metres and radians.
        std: (n, 6) σ of the estimate.
        target: (n, 6) true decalibration.
        groups: n labels, such as the drive or rig of each frame, or None.
        bounds: (n, 6) lower and upper quantile outputs of the network, or None.
    """

    mean: Tensor
    std: Tensor
    target: Tensor
    groups: tuple[str, ...] | None = None
    bounds: tuple[Tensor, Tensor] | None = None

    @staticmethod
    def of(
        mean: Tensor,
        std: Tensor,
        target: Tensor,
        groups: Sequence[str] | None = None,
        bounds: tuple[Tensor, Tensor] | None = None,
    ) -> Predictions:
        """Check, move and cast.

        Args:
            mean: (n, 6) estimated decalibration, metres and radians.
            std: (n, 6) σ of the estimate.
            target: (n, 6) true decalibration.
            groups: n labels, where the interval method needs them.
            bounds: (n, 6) lower and upper quantile outputs, where the interval method needs them.

        Raises:
            ValueError: shapes other than (n, 6), no samples, values that are not finite, or not
                one label per sample.
        """
        mean, std, target, *both = in_double(mean, std, target, *(bounds or ()))
        if groups is not None and (isinstance(groups, str) or len(groups) != len(mean)):
            raise ValueError(
                f"{len(groups)} groups for {len(mean)} samples; give a list of one label each."
            )
        return Predictions(
            mean,
            std,
            target,
            None if groups is None else tuple(groups),
            (both[0], both[1]) if both else None,
        )

    def intervals(self, calibrator: IntervalCalibrator, level: float | Fraction) -> Intervals:
        """The intervals per DoF at a level.

        Args:
            calibrator: fitted on the uncertainty calibration set.
            level: coverage level in (0, 1).
        """
        return calibrator.predict(
            self.mean, self.std, level, groups=self.groups, bounds=self.bounds
        )

    def boxes(
        self,
        calibrator: IntervalCalibrator,
        level: float | Fraction,
        method: Literal["max", "bonferroni"],
    ) -> Intervals:
        """The boxes that hold all DoF at once at a level.

        Args:
            calibrator: fitted on the uncertainty calibration set.
            level: coverage level of the whole box, in (0, 1).
            method: of :meth:`IntervalCalibrator.predict_joint`.
        """
        return calibrator.predict_joint(
            self.mean, self.std, level, groups=self.groups, bounds=self.bounds, method=method
        )


def promise_of(calibrator: IntervalCalibrator) -> Promise:
    """What the interval method promises about the coverage on exchangeable frames.

    Args:
        calibrator: any.

    >>> from uncal.uncertainty import ConformalCalibrator, GaussianIntervals
    >>> promise_of(ConformalCalibrator()), promise_of(GaussianIntervals())
    ('exact', 'none')
    """
    if not calibrator.guaranteed:
        return "none"
    return "by group" if calibrator.needs_groups else "exact"


@lru_cache(maxsize=1024)
def band_counts(n: int, m: int, alpha: Fraction) -> tuple[int, int]:
    """:func:`coverage_band` at :data:`BAND_CONFIDENCE` as counts, since only those compare exactly.

    Args:
        n: test samples.
        m: samples in the uncertainty calibration set.
        alpha: miscoverage level α in (0, 1).

    Returns:
        Fewest and most covered samples inside the band.

    >>> band_counts(1000, 1000, Fraction(1, 10))
    (852, 940)
    """
    low, high = (round(n * bound) for bound in coverage_band(n, m, alpha, BAND_CONFIDENCE))
    return low, high


def percent(level: float | Fraction) -> float:
    """A level as percent, without the noise of the multiplication.

    Args:
        level: in 0..1; a float counts as the decimal it prints as.

    >>> percent(0.07)
    7.0
    """
    return float(100 * Fraction(str(level)))


def in_double(*tensors: Tensor) -> list[Tensor]:
    """On the CPU in double precision, so that a table is the same wherever it is made.

    Args:
        *tensors: (n, 6) each.

    Raises:
        ValueError: other shapes, no samples, or values that are not finite.
    """
    for tensor in tensors:
        if tensor.shape != tensors[0].shape or tensor.ndim != 2 or tensor.shape[1] != 6:
            raise ValueError(
                f"shapes {[tuple(t.shape) for t in tensors]}: all must be (n, {len(DOF_NAMES)}), "
                f"in the order {', '.join(DOF_NAMES)}."
            )
        if len(tensor) == 0 or not tensor.isfinite().all():
            raise ValueError(
                f"the test set has {len(tensor)} samples and {int((~tensor.isfinite()).sum())} "
                "values that are NaN or infinite; a table needs finite values and one sample."
            )
    return [tensor.detach().double().cpu() for tensor in tensors]
