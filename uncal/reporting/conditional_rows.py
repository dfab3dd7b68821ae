"""Coverage where σ is small and where it is large, where the decalibration is and where not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor

from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS, pose_to_matrix
from uncal.metrics.conditional import BinnedCoverage, coverage_by_bin
from uncal.metrics.functional import covered
from uncal.reporting.layout import Section, number
from uncal.reporting.predictions import Predictions, band_counts, percent
from uncal.reporting.rows import rotation_angle
from uncal.uncertainty.calibrator import IntervalCalibrator
from uncal.uncertainty.quantile import miscoverage

TERCILES = 3
"""Bins of the report: low, middle and high."""

_SHOWN = {"sigma": "σ", "decalibration": "|decalibration|"}


@dataclass(frozen=True)
class ConditionalRow:
    """One DoF in one bin at one level; the columns of conditional.csv, coverage in percent.

    Attributes:
        by: what the test set is split by: ``sigma`` (of the DoF), ``decalibration`` (its absolute
            value), ``translation`` (length over X, Y, Z) or ``rotation`` (angle of the whole).
        dof: X, Y, Z, Roll, Pitch or Yaw.
        level: coverage asked for.
        bin: 1 for the lowest values.
        unit: "cm" or "°", of ``value_from`` and ``value_to``.
        value_from: smallest value that belongs to the bin.
        value_to: where the next bin starts; in the last bin the largest value.
        n: samples in the bin; ties can make bins unequal, or empty.
        picp: coverage found; NaN in an empty bin.
        coverage_low: lowest coverage inside the exact law's band for n samples; NaN in an empty
            bin. Right only for bins that have nothing to do with the score: a method may be far
            from its level in a bin of σ and keep all it has promised, since it promises the
            coverage over all frames. So the band is a yardstick for what is noise.
        coverage_high: highest coverage inside that band.
    """

    by: str
    dof: str
    level: float
    bin: int
    unit: str
    value_from: float
    value_to: float
    n: int
    picp: float
    coverage_low: float
    coverage_high: float


def conditional_rows(
    tested: Predictions,
    calibrator: IntervalCalibrator,
    levels: Sequence[float],
    bins: int = TERCILES,
) -> list[ConditionalRow]:
    """One row per level, kind of split, DoF and bin, in this order.

    Args:
        tested: the test set.
        calibrator: fitted on the uncertainty calibration set.
        levels: coverage levels in (0, 1).
        bins: quantile bins, at least 1.

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        NotCalibratedError: the calibrator is not fitted.
        ValueError: no bins.
    """
    m = int(calibrator.count)
    rows = []
    for level in levels:
        intervals = tested.intervals(calibrator, level)
        inside = covered(intervals.lower, intervals.upper, tested.target)
        for split in _splits(tested):
            binned = coverage_by_bin(inside, split.values, bins)
            rows += [
                _row(split, binned, level, m, dof=j, g=g)
                for j in range(len(DOF_NAMES))
                for g in range(bins)
            ]
    return rows


def conditional_section(rows: Sequence[ConditionalRow]) -> Section:
    """The first level's coverage by σ and by |decalibration| as a small table, DoF as columns.

    Args:
        rows: :func:`conditional_rows`.
    """
    level = rows[0].level
    grid = [["", *DOF_NAMES]]
    n_bins = max(row.bin for row in rows)
    middle = ["lowest", *(f"{g}." for g in range(2, n_bins)), "highest"]
    names = ["lowest", "middle", "highest"] if n_bins == TERCILES else middle
    for by, title in _SHOWN.items():
        for g in range(n_bins):
            cells = [row for row in rows if (row.by, row.level, row.bin) == (by, level, g + 1)]
            sizes = sorted({row.n for row in cells})
            size = f"{sizes[0]}" if len(sizes) == 1 else f"{sizes[0]}-{sizes[-1]}"
            label = f"{title} {names[g]}, {size} frames (%)"
            grid.append([label, *(number(row.picp, 1) for row in cells)])
    usable = [row for row in rows if row.level == level and row.n > 0]
    typical = sorted(usable, key=lambda row: row.n)[len(usable) // 2]
    return Section(
        f"Coverage of the {level:g}% intervals by σ and by size of the decalibration",
        grid,
        [
            "Each DoF's test frames in bins of its own σ, and of its own |decalibration|. No "
            "method here promises the level within a bin. If a bin had nothing to do with the "
            f"error, {typical.coverage_low:.1f}-{typical.coverage_high:.1f}% would be within what "
            f"{typical.n} frames of a split conformal method can show."
        ],
    )


class _Split(NamedTuple):
    """What the test set is split by: a name, (n, 6) values, per DoF their scale and unit."""

    by: str
    values: Tensor
    scale: tuple[float, ...]
    units: tuple[str, ...]


def _splits(tested: Predictions) -> list[_Split]:
    size = tested.target.abs()
    length = tested.target[:, :3].norm(dim=1)[:, None].expand_as(size)
    angle = rotation_angle(pose_to_matrix(tested.target))[:, None].expand_as(size)
    return [
        _Split("sigma", tested.std, DOF_SCALE, DOF_UNITS),
        _Split("decalibration", size, DOF_SCALE, DOF_UNITS),
        _Split("translation", length, DOF_SCALE[:1] * 6, DOF_UNITS[:1] * 6),
        _Split("rotation", angle, DOF_SCALE[-1:] * 6, DOF_UNITS[-1:] * 6),
    ]


def _row(
    split: _Split, binned: BinnedCoverage, level: float, m: int, *, dof: int, g: int
) -> ConditionalRow:
    values = split.values[:, dof]
    ends = [values.min().item(), *binned.edges[:, dof].tolist(), values.max().item()]
    n = int(binned.counts[g, dof])
    low, high = math.nan, math.nan
    if n:
        fewest, most = band_counts(n, m, miscoverage(level))
        low, high = 100 * fewest / n, 100 * most / n
    return ConditionalRow(
        by=split.by,
        dof=DOF_NAMES[dof],
        level=percent(level),
        bin=g + 1,
        unit=split.units[dof],
        value_from=ends[g] * split.scale[dof],
        value_to=ends[g + 1] * split.scale[dof],
        n=n,
        # Of whole numbers, so that 1/3 is not the float32 of it.
        picp=100 * round(n * binned.coverage[g, dof].item()) / n if n else math.nan,
        coverage_low=low,
        coverage_high=high,
    )
