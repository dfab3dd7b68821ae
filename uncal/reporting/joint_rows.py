"""How often the whole pose is held: six intervals together, and boxes made for all six at once."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

from torch import Tensor

from uncal.geometry import DOF_NAMES
from uncal.metrics.joint import jointly_covered, relative_size
from uncal.reporting.layout import Section, number
from uncal.reporting.predictions import Predictions, Promise, band_counts, percent
from uncal.uncertainty.calibrator import IntervalCalibrator
from uncal.uncertainty.errors import NotCalibratedError
from uncal.uncertainty.intervals import Intervals
from uncal.uncertainty.quantile import miscoverage, samples_needed


@dataclass(frozen=True)
class JointRow:
    """All six degrees of freedom at one level; the columns of joint.csv, coverage in percent.

    What an interval method does not offer is None, and its column is left out of the csv.

    Attributes:
        level: coverage asked for.
        together: how often all six per-DoF intervals hold at once; nobody promises it.
        joint: how often the joint box ("max", made for all six at once) holds.
        joint_low: lowest coverage of that box inside the exact law's band. As in results.csv, the
            law is that of split conformal boxes; for other methods a yardstick.
        joint_high: highest coverage inside that band.
        joint_in_band: whether ``joint`` is in that band.
        bonferroni: how often the box of six intervals at level 1-α/6 holds; at least the level,
            but no exact law is known.
        bonferroni_size: how many times as wide per DoF as the joint box that one is (geometric
            mean); inf if only it is infinite, NaN if both are.
        n_test: samples of the test set.
        n_calibration: samples of the uncertainty calibration set.
    """

    level: float
    together: float
    joint: float | None
    joint_low: float | None
    joint_high: float | None
    joint_in_band: bool | None
    bonferroni: float | None
    bonferroni_size: float | None
    n_test: int
    n_calibration: int


def joint_rows(
    tested: Predictions, calibrator: IntervalCalibrator, levels: Sequence[float]
) -> list[JointRow]:
    """One row per level.

    Args:
        tested: the test set.
        calibrator: fitted on the uncertainty calibration set.
        levels: coverage levels in (0, 1).

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        NotCalibratedError: the calibrator is not fitted.
    """
    return [_row(tested, calibrator, level) for level in levels]


def _row(tested: Predictions, calibrator: IntervalCalibrator, level: float) -> JointRow:
    n, m = len(tested.target), int(calibrator.count)
    together = _held(tested.intervals(calibrator, level), tested.target)
    box = _boxes(tested, calibrator, level, "max")
    with warnings.catch_warnings():
        # Nobody asked for 1-α/6; the table says what an infinite box means.
        warnings.simplefilter("ignore", UserWarning)
        bonferroni = _boxes(tested, calibrator, level, "bonferroni")
    held = None if box is None else _held(box, tested.target)
    low, high = band_counts(n, m, miscoverage(level))
    size = None
    if box is not None and bonferroni is not None:
        size = relative_size(bonferroni.lower, bonferroni.upper, box.lower, box.upper).item()
    return JointRow(
        level=percent(level),
        together=100 * together / n,
        joint=None if held is None else 100 * held / n,
        joint_low=None if held is None else 100 * low / n,
        joint_high=None if held is None else 100 * high / n,
        joint_in_band=None if held is None else low <= held <= high,
        bonferroni=None if bonferroni is None else 100 * _held(bonferroni, tested.target) / n,
        bonferroni_size=size,
        n_test=n,
        n_calibration=m,
    )


def joint_section(rows: Sequence[JointRow], promise: Promise) -> Section:
    """The rows as a small table, levels as columns.

    Args:
        rows: :func:`joint_rows`.
        promise: what the interval method promises.
    """
    grid = [["", *(f"{row.level:g}%" for row in rows)]]
    grid.append(["All six intervals at once (%)", *(number(row.together, 1) for row in rows)])
    notes = ["All six intervals at once: the level is asked of each DoF alone, not of the six."]
    if any(row.joint is not None for row in rows):
        exact = promise == "exact"
        marks = ["*" if exact and row.joint_in_band is False else "" for row in rows]
        cells = [number(row.joint, 1) + mark for row, mark in zip(rows, marks, strict=True)]
        grid.append(["Joint box (%)", *cells])
        if exact:
            bands = [f"{number(row.joint_low, 1)}-{number(row.joint_high, 1)}" for row in rows]
            grid.append(["Joint box, allowed (%)", *bands])
        notes.append("Joint box: intervals for all six DoF at once, from the largest score.")
        if any(marks):
            notes.append("*: outside the allowed band.")
    if any(row.bonferroni is not None for row in rows):
        grid.append(["Bonferroni box (%)", *(number(row.bonferroni, 1) for row in rows)])
        sizes = [number(row.bonferroni_size, 2) for row in rows]
        if any(row.bonferroni_size is not None for row in rows):
            grid.append(["Bonferroni / joint, width", *sizes])
        notes.append("Bonferroni box: each DoF at level 1 - α/6.")
        notes += _too_few(rows, promise)
    return Section("The whole pose", grid, notes)


def _too_few(rows: Sequence[JointRow], promise: Promise) -> list[str]:
    """Why Bonferroni boxes are infinite, where the number of samples alone says so."""
    if promise != "exact":
        return []
    alphas = {row.level: (1 - Fraction(str(row.level)) / 100) / len(DOF_NAMES) for row in rows}
    return [
        f"∞: at {row.level:g}% the Bonferroni box needs {samples_needed(alphas[row.level])} "
        f"samples in the uncertainty calibration set; there are {row.n_calibration}."
        for row in rows
        if row.n_calibration < samples_needed(alphas[row.level])
    ]


def _boxes(
    tested: Predictions,
    calibrator: IntervalCalibrator,
    level: float,
    method: Literal["max", "bonferroni"],
) -> Intervals | None:
    """The boxes, or None from an old checkpoint that has none."""
    try:
        return tested.boxes(calibrator, level, method)
    except NotCalibratedError:
        return None


def _held(intervals: Intervals, target: Tensor) -> int:
    return int(jointly_covered(intervals.lower, intervals.upper, target).sum())
