"""Coverage found against coverage asked for, from 5% to 95%."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import torch

from uncal.geometry import DOF_NAMES
from uncal.metrics.calibration_curve import calibration_error, covered_per_level
from uncal.reporting.layout import Section, number
from uncal.reporting.predictions import Predictions, Promise, band_counts, percent
from uncal.uncertainty.calibrator import IntervalCalibrator
from uncal.uncertainty.quantile import miscoverage

CURVE_LEVELS: tuple[float, ...] = tuple(float(Fraction(k, 20)) for k in range(1, 20))
"""5%, 10%, … 95%."""


@dataclass(frozen=True)
class CurveRow:
    """One point of one DoF's calibration curve; the columns of calibration_curve.csv, percent.

    Attributes:
        dof: X, Y, Z, Roll, Pitch or Yaw.
        level: coverage asked for.
        picp: coverage found.
        coverage_low: lowest coverage inside the exact law's band of this point. As in results.csv,
            the law is that of split conformal intervals; for other methods a yardstick.
        coverage_high: highest coverage inside that band.
        in_band: whether ``picp`` is in that band.
    """

    dof: str
    level: float
    picp: float
    coverage_low: float
    coverage_high: float
    in_band: bool


def curve_rows(
    tested: Predictions,
    calibrator: IntervalCalibrator,
    levels: Sequence[float] = CURVE_LEVELS,
) -> list[CurveRow]:
    """One row per DoF and level, DoF outermost.

    Args:
        tested: the test set.
        calibrator: fitted on the uncertainty calibration set.
        levels: coverage levels in (0, 1).

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        NotCalibratedError: the calibrator is not fitted.
    """
    intervals = [tested.intervals(calibrator, level) for level in levels]
    lower = torch.stack([each.lower for each in intervals])
    upper = torch.stack([each.upper for each in intervals])
    counts = covered_per_level(lower, upper, tested.target).sum(1).tolist()
    n, m = len(tested.target), int(calibrator.count)
    bands = [band_counts(n, m, miscoverage(level)) for level in levels]
    return [
        CurveRow(
            dof=name,
            level=percent(level),
            picp=100 * inside[j] / n,
            coverage_low=100 * low / n,
            coverage_high=100 * high / n,
            in_band=low <= inside[j] <= high,
        )
        for j, name in enumerate(DOF_NAMES)
        for level, inside, (low, high) in zip(levels, counts, bands, strict=True)
    ]


def curve_section(rows: Sequence[CurveRow], promise: Promise) -> Section:
    """How far each DoF's curve is from the diagonal.

    Args:
        rows: :func:`curve_rows`.
        promise: what the interval method promises.
    """
    per_dof = [[row for row in rows if row.dof == name] for name in DOF_NAMES]
    levels = [row.level / 100 for row in per_dof[0]]
    found = [[row.picp / 100 for row in points] for points in per_dof]
    observed = torch.tensor(found, dtype=torch.float64).T
    error = calibration_error(observed, levels)
    grid = [
        ["", *DOF_NAMES],
        ["Mean |found - asked| (points)", *(number(100 * e, 1) for e in error.absolute.tolist())],
        ["Mean found - asked (points)", *(f"{100 * e:+.1f}" for e in error.signed.tolist())],
    ]
    notes = ["Points of percent; found above asked means intervals wider than they need be."]
    if promise == "exact":
        outside = [str(sum(not row.in_band for row in points)) for points in per_dof]
        grid.append(["Levels outside the allowed band", *outside])
        notes.append("The points of one curve stand on the same frames, hence hang together.")
    title = f"Calibration curve, {per_dof[0][0].level:g}% to {per_dof[0][-1].level:g}%"
    return Section(title, grid, notes)
