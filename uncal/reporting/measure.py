"""The results of a test, measured once: a few tidy frames and the errors of the whole pose.

What the columns mean is documented in :mod:`uncal.reporting.frames`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS, pose_to_matrix
from uncal.metrics.conditional import BinnedCoverage, coverage_by_bin
from uncal.metrics.functional import covered, interval_score, mpiw
from uncal.metrics.joint import jointly_covered, relative_size
from uncal.metrics.joint import log_volume as log_volume_of_boxes
from uncal.metrics.pose_error import PoseErrors, pose_errors, rotation_angle
from uncal.reporting.control import control_table
from uncal.reporting.evaluation import Evaluation, Guarantee, percent
from uncal.reporting.frames import bound_columns, table
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.ellipsoid import EllipsoidCalibrator, log_volume, mahalanobis
from uncal.uncertainty.conformal.intervals import Intervals
from uncal.uncertainty.conformal.quantile import miscoverage

if TYPE_CHECKING:
    import pandas as pd

    from uncal.inference.control import ControlPrediction

CURVE_LEVELS: tuple[float, ...] = tuple(float(Fraction(k, 20)) for k in range(1, 20))
"""5%, 10%, … 95%."""

TERCILES = 3
"""Bins of the conditional coverage: low, middle and high."""

_SCALE = torch.tensor(DOF_SCALE, dtype=torch.float64)


@dataclass(frozen=True)
class Results:
    """What was measured on a test set; the frames are those of the run's CSV files.

    Attributes:
        per_dof: per level and DoF, the paper's table (results.csv).
        summary: errors of the whole pose.
        joint: per level, all six DoF at once.
        conditional: coverage by σ and by size of the decalibration.
        curve: coverage from 5% to 95%.
        guarantee: of the interval method.
        control: per DoF, what the camera contributes; None where no control was run.
        predictions: per frame and DoF; None where the frames have no names.
    """

    per_dof: pd.DataFrame
    summary: PoseErrors
    joint: pd.DataFrame
    conditional: pd.DataFrame
    curve: pd.DataFrame
    guarantee: Guarantee
    control: pd.DataFrame | None = None
    predictions: pd.DataFrame | None = None


def measure(
    mean: Tensor,
    std: Tensor,
    target: Tensor,
    calibrator: IntervalCalibrator,
    levels: Sequence[float],
    *,
    groups: Sequence[str] | None = None,
    bounds: tuple[Tensor, Tensor] | None = None,
    control: ControlPrediction | None = None,
    frames: Sequence[str] | None = None,
    ellipsoid: tuple[EllipsoidCalibrator, Tensor] | None = None,
) -> Results:
    """Measure everything that the report shows.

    Args:
        mean: (n, 6) estimated decalibration, metres and radians.
        std: (n, 6) σ of the estimate.
        target: (n, 6) true decalibration.
        calibrator: fitted on the uncertainty calibration set.
        levels: coverage levels in (0, 1); the first is the one shown by bins.
        groups: n labels, where the calibrator needs them.
        bounds: (n, 6) lower and upper quantile outputs, where the calibrator needs them.
        control: the image-blind control on the same frames.
        frames: n names of the frames, for the single predictions.
        ellipsoid: a second joint region, fitted, and the (n, 6, 6) covariances.

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        NotCalibratedError: the calibrator is not fitted.
        ValueError: no levels, shapes other than (n, 6), values that are not finite, or not one
            label or name per sample.
    """
    test = Evaluation.of(mean, std, target, calibrator, groups, bounds)
    per_dof = per_dof_table(test, levels)
    mae_after = [float(value) for value in per_dof["mae_after"].iloc[: len(DOF_NAMES)]]
    return Results(
        per_dof=per_dof,
        summary=pose_errors(test.mean, test.target, test.m),
        joint=joint_table(test, levels, ellipsoid),
        conditional=conditional_table(test, levels),
        curve=curve_table(test),
        guarantee=test.guarantee,
        control=None if control is None else control_table(control, mae_after),
        predictions=None if frames is None else predictions_table(test, levels, frames),
    )


def per_dof_table(test: Evaluation, levels: Sequence[float]) -> pd.DataFrame:
    """The paper's Table 1: one row per level and DoF, levels outermost."""
    if not levels:
        raise ValueError("no coverage levels; give at least one, such as 0.9.")
    before = (test.target.abs().mean(0) * _SCALE).tolist()
    after = ((test.target - test.mean).abs().mean(0) * _SCALE).tolist()
    rows: list[Mapping[str, object]] = []
    for level in levels:
        lower, upper = test.intervals(level).lower, test.intervals(level).upper
        inside = covered(lower, upper, test.target).sum(0).tolist()
        widths = (mpiw(lower, upper) * _SCALE).tolist()
        alpha = float(miscoverage(level))
        scores = (interval_score(lower, upper, test.target, alpha) * _SCALE).tolist()
        rows += [
            {
                "dof": dof,
                "unit": DOF_UNITS[j],
                "level": percent(level),
                "picp": 100 * inside[j] / test.n,
                "mpiw": widths[j],
                "is": scores[j],
                **_band(test, level, inside[j]),
                "mae_before": before[j],
                "mae_after": after[j],
                "ratio": _ratio(after[j], before[j]),
                "n_test": test.n,
                "n_calibration": test.m,
            }
            for j, dof in enumerate(DOF_NAMES)
        ]
    return table(rows)


def joint_table(
    test: Evaluation,
    levels: Sequence[float],
    ellipsoid: tuple[EllipsoidCalibrator, Tensor] | None = None,
) -> pd.DataFrame:
    """One row per level: how often the whole pose is held."""
    return table(
        [
            {
                **_joint_row(test, level),
                **_ellipsoid_columns(test, level, ellipsoid),
                "n_test": test.n,
                "n_calibration": test.m,
            }
            for level in levels
        ]
    )


def _ellipsoid_columns(
    test: Evaluation, level: float, ellipsoid: tuple[EllipsoidCalibrator, Tensor] | None
) -> dict[str, object]:
    """Coverage of the ellipsoid, and how many times as wide per DoF the joint box is."""
    if ellipsoid is None or not ellipsoid[0].is_fitted:
        return {"ellipsoid": math.nan, "ellipsoid_size": math.nan}
    covariance = ellipsoid[1].cpu().double()
    radius = ellipsoid[0].radius(level).cpu().double()
    inside = mahalanobis(test.mean, covariance, test.target) <= radius
    box = test.boxes(level, "max")
    ratio = log_volume_of_boxes(box.lower, box.upper) - log_volume(covariance, radius)
    size = (ratio.mean() / test.mean.shape[1]).exp()
    return {
        "ellipsoid": 100 * float(inside.double().mean()),
        "ellipsoid_size": float(size) if radius.isfinite() else math.nan,
    }


def conditional_table(
    test: Evaluation, levels: Sequence[float], bins: int = TERCILES
) -> pd.DataFrame:
    """Coverage within quantile bins: one row per level, kind of split, DoF and bin."""
    size = test.target.abs()
    length = test.target[:, :3].norm(dim=1)[:, None].expand_as(size)
    angle = rotation_angle(pose_to_matrix(test.target))[:, None].expand_as(size)
    # What bins the test set: (n, 6) values, and the DoF whose scale and unit they have; None: own.
    splits: dict[str, tuple[Tensor, int | None]] = {
        "sigma": (test.std, None),
        "decalibration": (size, None),
        "translation": (length, 0),
        "rotation": (angle, 5),
    }
    rows: list[Mapping[str, object]] = []
    for level in levels:
        intervals = test.intervals(level)
        inside = covered(intervals.lower, intervals.upper, test.target)
        for by, (values, unit) in splits.items():
            binned = coverage_by_bin(inside, values, bins)
            rows += [
                {"by": by, "dof": dof, "level": percent(level)}
                | _bin(test, level, binned, values[:, j], j, g, j if unit is None else unit)
                for j, dof in enumerate(DOF_NAMES)
                for g in range(bins)
            ]
    return table(rows)


def curve_table(test: Evaluation, levels: Sequence[float] = CURVE_LEVELS) -> pd.DataFrame:
    """The calibration curves: one row per DoF and level, DoF outermost."""
    counts = [
        covered(test.intervals(level).lower, test.intervals(level).upper, test.target)
        .sum(0)
        .tolist()
        for level in levels
    ]
    return table(
        [
            {"dof": dof, "level": percent(level), "picp": 100 * inside[j] / test.n}
            | _band(test, level, inside[j])
            for j, dof in enumerate(DOF_NAMES)
            for level, inside in zip(levels, counts, strict=True)
        ]
    )


def predictions_table(
    test: Evaluation, levels: Sequence[float], frames: Sequence[str]
) -> pd.DataFrame:
    """One row per frame and DoF, frames outermost, in the order given.

    Raises:
        ValueError: not one name per sample.
    """
    import pandas as pd

    if len(frames) != test.n:
        raise ValueError(f"{len(frames)} frame names for {test.n} samples; give one each.")

    def flat(values: Tensor) -> list[float]:
        column: list[float] = (_SCALE * values).flatten().tolist()
        return column

    columns: dict[str, list[str] | list[float]] = {
        "frame": [frame for frame in frames for _ in DOF_NAMES],
        "dof": list(DOF_NAMES) * test.n,
        "unit": list(DOF_UNITS) * test.n,
        "truth": flat(test.target),
        "estimate": flat(test.mean),
        "sigma": flat(test.std),
    }
    for level in levels:
        lower, upper = bound_columns(percent(level))
        columns[lower] = flat(test.intervals(level).lower)
        columns[upper] = flat(test.intervals(level).upper)
    frame: pd.DataFrame = pd.DataFrame(columns)
    return frame


def _joint_row(test: Evaluation, level: float) -> dict[str, object]:
    together = _held(test, test.intervals(level))
    box = test.boxes(level, "max")
    with warnings.catch_warnings():
        # The user did not choose the level 1-α/6; the table explains infinite boxes.
        warnings.simplefilter("ignore", UserWarning)
        bonferroni = test.boxes(level, "bonferroni")
    size = relative_size(bonferroni.lower, bonferroni.upper, box.lower, box.upper)
    band = _band(test, level, _held(test, box))
    return {
        "level": percent(level),
        "together": 100 * together / test.n,
        "joint": 100 * _held(test, box) / test.n,
        "joint_low": band["coverage_low"],
        "joint_high": band["coverage_high"],
        "joint_in_band": band["in_band"],
        "bonferroni": 100 * _held(test, bonferroni) / test.n,
        "bonferroni_size": size.item(),
    }


def _held(test: Evaluation, region: Intervals) -> int:
    return int(jointly_covered(region.lower, region.upper, test.target).sum())


def _band(test: Evaluation, level: float, inside: int) -> dict[str, object]:
    low, high = test.band(level)
    return {
        "coverage_low": 100 * low / test.n,
        "coverage_high": 100 * high / test.n,
        "in_band": low <= inside <= high,
    }


def _bin(
    test: Evaluation,
    level: float,
    binned: BinnedCoverage,
    values: Tensor,
    j: int,
    g: int,
    unit: int,
) -> dict[str, object]:
    """Bin g of DoF j, whose edges have the unit of another DoF."""
    ends = [values.min().item(), *binned.edges[:, j].tolist(), values.max().item()]
    n = int(binned.counts[g, j])
    low, high = test.band(level, n) if n else (math.nan, math.nan)
    return {
        "bin": g + 1,
        "unit": DOF_UNITS[unit],
        "value_from": ends[g] * DOF_SCALE[unit],
        "value_to": ends[g + 1] * DOF_SCALE[unit],
        "n": n,
        # Of whole numbers, so that 1/3 is not the float32 of it.
        "picp": 100 * round(n * binned.coverage[g, j].item()) / n if n else math.nan,
        "coverage_low": 100 * low / n if n else math.nan,
        "coverage_high": 100 * high / n if n else math.nan,
    }


def _ratio(after: float, before: float) -> float:
    return after / before if before > 0 else math.nan
