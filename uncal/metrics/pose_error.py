"""Errors of the whole pose: lengths and angles before and after the estimate is applied."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from uncal.geometry import DOF_NAMES, invert, pose_to_matrix


@dataclass(frozen=True)
class PoseErrors:
    """Errors of the whole pose.

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


def pose_errors(mean: Tensor, target: Tensor, n_calibration: int) -> PoseErrors:
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
    >>> errors = pose_errors(target / 2, target, n_calibration=1)
    >>> round(errors.translation_before, 6), round(errors.translation_after, 6)
    (5.0, 2.5)
    """
    mean, target = in_double(mean, target)
    before, after = target.abs().mean(0).tolist(), (target - mean).abs().mean(0).tolist()
    ratios = [a / b for a, b in zip(after, before, strict=True) if b > 0]
    truth = pose_to_matrix(target)
    residual = truth @ invert(pose_to_matrix(mean))
    return PoseErrors(
        mean_ratio=sum(ratios) / len(ratios) if ratios else math.nan,
        translation_before=100 * target[:, :3].norm(dim=1).mean().item(),
        translation_after=100 * (target - mean)[:, :3].norm(dim=1).mean().item(),
        rotation_before=math.degrees(rotation_angle(truth).mean().item()),
        rotation_after=math.degrees(rotation_angle(residual).mean().item()),
        n_test=len(target),
        n_calibration=n_calibration,
    )


def rotation_angle(transform: Tensor) -> Tensor:
    """(...) geodesic angles, 0..π radians, of (..., 4, 4) transforms.

    By ‖R - I‖ = 2√2 sin(θ/2), which is exact for small angles too.

    >>> pose = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 1e-6], dtype=torch.float64)
    >>> round(rotation_angle(pose_to_matrix(pose)).item(), 12)
    1e-06
    """
    rotation = transform[..., :3, :3]
    identity = torch.eye(3, dtype=rotation.dtype, device=rotation.device)
    chord = torch.linalg.matrix_norm(rotation - identity)
    return 2 * torch.asin((chord / 8**0.5).clamp_max(1.0))


def in_double(*tensors: Tensor) -> list[Tensor]:
    """(n, 6) tensors on the CPU in double precision, so that a table is the same on any device.

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
