"""The numbers of the paper's Table 1 from the predictions on a test set."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS, invert, pose_to_matrix
from uncal.metrics.functional import covered, interval_score, mpiw
from uncal.reporting.predictions import Predictions, band_counts, in_double, percent
from uncal.uncertainty.calibrator import IntervalCalibrator
from uncal.uncertainty.quantile import miscoverage


@dataclass(frozen=True)
class ResultRow:
    """One degree of freedom at one coverage level, in centimetres or degrees and percent.

    Attributes:
        dof: X, Y, Z, Roll, Pitch or Yaw.
        unit: "cm" or "°", of all lengths and angles in the row.
        level: coverage asked for, percent.
        picp: coverage found, percent.
        mpiw: mean width of the intervals; inf if the uncertainty calibration set is too small.
        interval_score: mean interval score; the column ``is``.
        coverage_low: lowest coverage inside the exact law's band, percent. The law is that of
            split conformal intervals; for a method without it (:data:`predictions.Promise`) the
            band says what they would be allowed.
        coverage_high: highest coverage inside the exact law's band, percent.
        in_band: whether ``picp`` is in that band.
        mae_before: mean |decalibration|.
        mae_after: mean |decalibration - estimate|.
        ratio: ``mae_after`` / ``mae_before``; NaN if the test set has no decalibration on it.
        n_test: samples of the test set.
        n_calibration: samples of the uncertainty calibration set.
    """

    dof: str
    unit: str
    level: float
    picp: float
    mpiw: float
    interval_score: float
    coverage_low: float
    coverage_high: float
    in_band: bool
    mae_before: float
    mae_after: float
    ratio: float
    n_test: int
    n_calibration: int


@dataclass(frozen=True)
class Summary:
    """What the test set says as a whole.

    Attributes:
        mean_ratio: mean over the decalibrated DoF of mean absolute error after / before.
        translation_before: mean length of the decalibration's translation, cm.
        translation_after: mean length of the translation error that is left, cm.
        rotation_before: mean angle of the decalibration's rotation, degrees.
        rotation_after: mean angle of the rotation error that is left, degrees.
        n_test: samples of the test set.
        n_calibration: samples of the uncertainty calibration set.
    """

    mean_ratio: float
    translation_before: float
    translation_after: float
    rotation_before: float
    rotation_after: float
    n_test: int
    n_calibration: int


def results_table(
    mean: Tensor,
    std: Tensor,
    target: Tensor,
    calibrator: IntervalCalibrator,
    levels: Sequence[float],
    *,
    groups: Sequence[str] | None = None,
    bounds: tuple[Tensor, Tensor] | None = None,
) -> list[ResultRow]:
    """One row per level and degree of freedom, levels outermost.

    Args:
        mean: (n, 6) estimated decalibration, metres and radians.
        std: (n, 6) σ of the estimate.
        target: (n, 6) true decalibration.
        calibrator: fitted on the uncertainty calibration set.
        levels: coverage levels in (0, 1).
        groups: n labels, where the calibrator needs them.
        bounds: (n, 6) lower and upper quantile outputs, where the calibrator needs them.

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        NotCalibratedError: the calibrator is not fitted.
        ValueError: no levels, shapes other than (n, 6), values that are not finite, or not one
            label per sample.
    """
    tested = Predictions.of(mean, std, target, groups, bounds)
    mean, target = tested.mean, tested.target
    if not levels:
        raise ValueError("no coverage levels; give at least one, such as 0.9.")
    scale = torch.tensor(DOF_SCALE, dtype=torch.float64)
    before = (target.abs().mean(0) * scale).tolist()
    after = ((target - mean).abs().mean(0) * scale).tolist()
    n, m = len(target), int(calibrator.count)
    rows = []
    for level in levels:
        intervals = tested.intervals(calibrator, level)
        alpha = miscoverage(level)
        low, high = band_counts(n, m, alpha)
        inside = covered(intervals.lower, intervals.upper, target).sum(0).tolist()
        widths = (mpiw(intervals.lower, intervals.upper) * scale).tolist()
        scores = interval_score(intervals.lower, intervals.upper, target, float(alpha)) * scale
        rows += [
            ResultRow(
                dof=name,
                unit=DOF_UNITS[j],
                level=percent(level),
                picp=100 * inside[j] / n,
                mpiw=widths[j],
                interval_score=scores[j].item(),
                coverage_low=100 * low / n,
                coverage_high=100 * high / n,
                in_band=low <= inside[j] <= high,
                mae_before=before[j],
                mae_after=after[j],
                ratio=_ratio(after[j], before[j]),
                n_test=n,
                n_calibration=m,
            )
            for j, name in enumerate(DOF_NAMES)
        ]
    return rows


def summarise(mean: Tensor, target: Tensor, n_calibration: int) -> Summary:
    """Errors of the whole pose before and after the estimate is applied.

    The translation error is the length of the difference of the translations, as the paper's; the
    rotation error is the angle of the residual transform T(target) · T(estimate)⁻¹.

    Args:
        mean: (n, 6) estimated decalibration, metres and radians.
        target: (n, 6) true decalibration.
        n_calibration: samples of the uncertainty calibration set.

    Raises:
        ValueError: shapes other than (n, 6), or values that are not finite.

    >>> target = torch.tensor([[0.03, 0.04, 0.0, 0.0, 0.0, 0.0]])
    >>> summary = summarise(target / 2, target, n_calibration=1)
    >>> round(summary.translation_before, 6), round(summary.translation_after, 6)
    (5.0, 2.5)
    """
    mean, target = in_double(mean, target)
    before, after = target.abs().mean(0).tolist(), (target - mean).abs().mean(0).tolist()
    ratios = [_ratio(a, b) for a, b in zip(after, before, strict=True) if b > 0]
    truth = pose_to_matrix(target)
    residual = truth @ invert(pose_to_matrix(mean))
    return Summary(
        mean_ratio=sum(ratios) / len(ratios) if ratios else math.nan,
        translation_before=100 * target[:, :3].norm(dim=1).mean().item(),
        translation_after=100 * (target - mean)[:, :3].norm(dim=1).mean().item(),
        rotation_before=math.degrees(rotation_angle(truth).mean().item()),
        rotation_after=math.degrees(rotation_angle(residual).mean().item()),
        n_test=len(target),
        n_calibration=n_calibration,
    )


def rotation_angle(transform: Tensor) -> Tensor:
    """The geodesic angle of transforms, by ‖R - I‖ = 2√2 sin(θ/2), exact for small angles too.

    Args:
        transform: (..., 4, 4) rigid transforms.

    Returns:
        (...) angles in 0..π radians.

    >>> pose = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 1e-6], dtype=torch.float64)
    >>> round(rotation_angle(pose_to_matrix(pose)).item(), 12)
    1e-06
    """
    rotation = transform[..., :3, :3]
    identity = torch.eye(3, dtype=rotation.dtype, device=rotation.device)
    chord = torch.linalg.matrix_norm(rotation - identity)
    return 2 * torch.asin((chord / 8**0.5).clamp_max(1.0))


def _ratio(after: float, before: float) -> float:
    return after / before if before > 0 else math.nan
