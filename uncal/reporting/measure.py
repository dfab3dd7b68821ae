"""The results of a test, measured once: a few tidy frames and the errors of the whole pose.

What the columns mean is documented in :mod:`uncal.reporting.frames`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import pandas as pd
import torch
from torch import Tensor

from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS, pose_to_matrix
from uncal.metrics.conditional import coverage_by_bin
from uncal.metrics.functional import covered, interval_score, mpiw
from uncal.metrics.joint import jointly_covered, relative_size
from uncal.metrics.joint import log_volume as log_volume_of_boxes
from uncal.metrics.pose_error import PoseErrors, pose_errors, rotation_angle
from uncal.reporting.control import control_table
from uncal.reporting.evaluation import Evaluation, Guarantee, percent
from uncal.reporting.frames import CONDITIONAL, RESULTS, bound_columns
from uncal.uncertainty.conformal.ellipsoid import EllipsoidCalibrator, log_volume, mahalanobis
from uncal.uncertainty.conformal.quantile import miscoverage

if TYPE_CHECKING:
    from uncal.models.split_prediction import ControlPrediction

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
    test: Evaluation,
    levels: Sequence[float],
    *,
    control: ControlPrediction | None = None,
    frames: Sequence[str] | None = None,
    ellipsoid: tuple[EllipsoidCalibrator, Tensor] | None = None,
) -> Results:
    """Measure everything that the report shows.

    Args:
        test: n frames.
        levels: coverage levels in (0, 1); the first is the one shown by bins.
        control: the image-blind control on the same frames.
        frames: n names of the frames, for the single predictions.
        ellipsoid: a second joint region, fitted, and the (n, 6, 6) covariances.

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        ValueError: no levels, or not one name per sample.
    """
    per_dof = per_dof_table(test, levels)
    mae_after = per_dof["mae_after"].iloc[: len(DOF_NAMES)].tolist()
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
    frame = _coverage(test, levels)
    before = test.target.abs().mean(0) * _SCALE
    after = (test.target - test.mean).abs().mean(0) * _SCALE
    made = [(test.intervals(level), float(miscoverage(level))) for level in levels]
    scores = [interval_score(i.lower, i.upper, test.target, alpha) for i, alpha in made]
    measured = {
        "mpiw": torch.stack([mpiw(i.lower, i.upper) for i, _ in made]) * _SCALE,
        "is": torch.stack(scores) * _SCALE,
        "mae_before": before.repeat(len(levels)),
        "mae_after": after.repeat(len(levels)),
        "ratio": (after / before.where(before > 0, math.nan)).repeat(len(levels)),
    }
    frame = frame.assign(
        unit=list(DOF_UNITS) * len(levels),
        **{name: values.flatten().numpy() for name, values in measured.items()},
        n_test=test.n,
        n_calibration=test.m,
    )
    ordered: pd.DataFrame = frame[list(RESULTS.columns)]
    return ordered


def joint_table(
    test: Evaluation,
    levels: Sequence[float],
    ellipsoid: tuple[EllipsoidCalibrator, Tensor] | None = None,
) -> pd.DataFrame:
    """One row per level: how often the whole pose is held."""
    rows = pd.DataFrame([_joint_row(test, level, ellipsoid) for level in levels])
    frame: pd.DataFrame = rows.assign(n_test=test.n, n_calibration=test.m)
    return frame


def conditional_table(
    test: Evaluation, levels: Sequence[float], bins: int = TERCILES
) -> pd.DataFrame:
    """Coverage within quantile bins: one row per level, kind of split, DoF and bin."""
    size = test.target.abs()
    length = test.target[:, :3].norm(dim=1)[:, None].expand_as(size)
    angle = rotation_angle(pose_to_matrix(test.target))[:, None].expand_as(size)
    own = list(range(len(DOF_NAMES)))
    # What bins the test set: (n, 6) values, and the DoF whose scale and unit each column has.
    splits = {
        "sigma": (test.std, own),
        "decalibration": (size, own),
        "translation": (length, [0] * 6),
        "rotation": (angle, [5] * 6),
    }
    parts = []
    for level in levels:
        made = test.intervals(level)
        inside = covered(made.lower, made.upper, test.target)
        for by, (values, units) in splits.items():
            inner, *per_bin = coverage_by_bin(inside, values, bins)
            counts, hits = (each.T.flatten() for each in per_bin)
            edges = torch.cat([values.amin(0)[None], inner, values.amax(0)[None]]) * _SCALE[units]
            none = (math.nan, math.nan)
            band = [test.band(level, n) if n else none for n in counts.tolist()]
            low, high = torch.tensor(band, dtype=torch.float64).T
            columns = {
                "dof": [dof for dof in DOF_NAMES for _ in range(bins)],
                "bin": list(range(1, bins + 1)) * len(DOF_NAMES),
                "unit": [DOF_UNITS[j] for j in units for _ in range(bins)],
                "value_from": edges[:-1].T.flatten(),
                "value_to": edges[1:].T.flatten(),
                "n": counts,
                "picp": 100 * hits.double() / counts,
                "coverage_low": 100 * low / counts,
                "coverage_high": 100 * high / counts,
            }
            parts.append(pd.DataFrame(columns).assign(by=by, level=percent(level)))
    frame: pd.DataFrame = pd.concat(parts, ignore_index=True)[list(CONDITIONAL.columns)]
    return frame


def curve_table(test: Evaluation, levels: Sequence[float] = CURVE_LEVELS) -> pd.DataFrame:
    """The calibration curves: one row per DoF and level, DoF outermost."""
    frame: pd.DataFrame = _coverage(test, levels).sort_values(
        "dof", key=lambda names: names.map(DOF_NAMES.index), kind="stable", ignore_index=True
    )
    return frame


def predictions_table(
    test: Evaluation, levels: Sequence[float], frames: Sequence[str]
) -> pd.DataFrame:
    """One row per frame and DoF, frames outermost, in the order given."""
    if len(frames) != test.n:
        raise ValueError(f"{len(frames)} frame names for {test.n} samples; give one each.")
    numbers = {"truth": test.target, "estimate": test.mean, "sigma": test.std}
    for level in levels:
        made = test.intervals(level)
        numbers |= zip(bound_columns(percent(level)), (made.lower, made.upper), strict=True)
    frame: pd.DataFrame = pd.DataFrame(
        {
            "frame": [frame for frame in frames for _ in DOF_NAMES],
            "dof": list(DOF_NAMES) * test.n,
            "unit": list(DOF_UNITS) * test.n,
            **{name: (_SCALE * values).flatten() for name, values in numbers.items()},
        }
    )
    return frame


def _coverage(test: Evaluation, levels: Sequence[float]) -> pd.DataFrame:
    """Empirical coverage and its reference band: one row per level and DoF, levels outermost."""
    parts = []
    for level in levels:
        made = test.intervals(level)
        inside = covered(made.lower, made.upper, test.target).sum(0)
        low, high = test.band(level)
        columns = {
            "dof": DOF_NAMES,
            "level": percent(level),
            "picp": 100 * inside.double() / test.n,
            "coverage_low": 100 * low / test.n,
            "coverage_high": 100 * high / test.n,
            "in_band": (low <= inside) & (inside <= high),
        }
        parts.append(pd.DataFrame(columns))
    frame: pd.DataFrame = pd.concat(parts, ignore_index=True)
    return frame


def _joint_row(
    test: Evaluation, level: float, ellipsoid: tuple[EllipsoidCalibrator, Tensor] | None
) -> dict[str, float]:
    box = test.boxes(level, "max")
    with warnings.catch_warnings():
        # The user did not choose the level 1-α/6; the table explains infinite boxes.
        warnings.simplefilter("ignore", UserWarning)
        bonferroni = test.boxes(level, "bonferroni")
    together, joint, each = (
        int(jointly_covered(region.lower, region.upper, test.target).sum())
        for region in (test.intervals(level), box, bonferroni)
    )
    low, high = test.band(level)
    size = relative_size(bonferroni.lower, bonferroni.upper, box.lower, box.upper)
    row = {
        "level": percent(level),
        "together": 100 * together / test.n,
        "joint": 100 * joint / test.n,
        "joint_low": 100 * low / test.n,
        "joint_high": 100 * high / test.n,
        "joint_in_band": low <= joint <= high,
        "bonferroni": 100 * each / test.n,
        "bonferroni_size": size.item(),
        "ellipsoid": math.nan,
        "ellipsoid_size": math.nan,
    }
    if ellipsoid is not None and ellipsoid[0].is_fitted:
        covariance = ellipsoid[1].cpu().double()
        radius = ellipsoid[0].radius(level).cpu().double()
        inside = mahalanobis(test.mean, covariance, test.target) <= radius
        row["ellipsoid"] = 100 * float(inside.double().mean())
        if radius.isfinite():
            volumes = log_volume_of_boxes(box.lower, box.upper) - log_volume(covariance, radius)
            row["ellipsoid_size"] = float((volumes.mean() / len(DOF_NAMES)).exp())
    return row
