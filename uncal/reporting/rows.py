"""The numbers of the paper's Table 1 from the predictions on a test set."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import torch
from torch import Tensor

from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS, invert, pose_to_matrix
from uncal.metrics.functional import covered, interval_score, mpiw
from uncal.uncertainty.conformal import ConformalCalibrator, miscoverage
from uncal.uncertainty.coverage_law import coverage_band

BAND_CONFIDENCE = 0.999
"""Probability with which the exact law's band holds the coverage of one DoF at one level."""


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
        coverage_low: lowest coverage inside the exact law's band, percent.
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
    calibrator: ConformalCalibrator,
    levels: Sequence[float],
) -> list[ResultRow]:
    """One row per level and degree of freedom, levels outermost.

    Args:
        mean: (n, 6) estimated decalibration, metres and radians.
        std: (n, 6) σ of the estimate.
        target: (n, 6) true decalibration.
        calibrator: fitted on the uncertainty calibration set.
        levels: coverage levels in (0, 1).

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        NotCalibratedError: the calibrator is not fitted.
        ValueError: no levels, shapes other than (n, 6), or values that are not finite.
    """
    mean, std, target = _in_double(mean, std, target)
    if not levels:
        raise ValueError("no coverage levels; give at least one, such as 0.9.")
    scale = torch.tensor(DOF_SCALE, dtype=torch.float64)
    before = (target.abs().mean(0) * scale).tolist()
    after = ((target - mean).abs().mean(0) * scale).tolist()
    n, m = len(target), int(calibrator.count)
    rows = []
    for level in levels:
        intervals = calibrator.predict(mean, std, level)
        alpha = miscoverage(level)
        # As counts, since only those compare exactly.
        low, high = (round(n * bound) for bound in coverage_band(n, m, alpha, BAND_CONFIDENCE))
        inside = covered(intervals.lower, intervals.upper, target).sum(0).tolist()
        widths = (mpiw(intervals.lower, intervals.upper) * scale).tolist()
        scores = interval_score(intervals.lower, intervals.upper, target, float(alpha)) * scale
        rows += [
            ResultRow(
                dof=name,
                unit=DOF_UNITS[j],
                level=float(100 * Fraction(str(level))),
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
    mean, target = _in_double(mean, target)
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


def _in_double(*tensors: Tensor) -> list[Tensor]:
    """On the CPU in double precision, so that a table is the same wherever it is made."""
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
    return [tensor.detach().to("cpu", torch.float64) for tensor in tensors]
