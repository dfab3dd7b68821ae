"""How pixels move when a decalibration is taken out: to first order, and exactly."""

from __future__ import annotations

import torch
from torch import Tensor

from uncal.geometry import invert, transform_points
from uncal.geometry.decalibration import correct


def displacement_jacobian(points_cam: Tensor, K: Tensor, T_init: Tensor) -> Tensor:
    """How pixels move when a decalibration is taken out, to first order.

    A point p of the LiDAR frame, seen at q = T_init p, belongs at T_init D⁻¹ p, that is
    q - R_init (t + ω × p) for a small D with translation t and rotation vector ω.

    Args:
        points_cam: (B, N, 3) points q in the decalibrated camera frame, metres.
        K: (B, 3, 3) camera matrices.
        T_init: (B, 4, 4) decalibrated extrinsics.

    Returns:
        (B, N, 2, 6) pixels per metre and per radian.
    """
    x, y, z = points_cam.unbind(-1)
    fx, fy = K[:, 0, 0, None], K[:, 1, 1, None]
    zero = torch.zeros_like(z)
    pixel_by_point = torch.stack(
        [
            torch.stack([fx / z, zero, -fx * x / z**2], -1),
            torch.stack([zero, fy / z, -fy * y / z**2], -1),
        ],
        -2,
    )
    points = transform_points(invert(T_init), points_cam)
    by_translation = -(pixel_by_point @ T_init[:, None, :3, :3])
    # a · (ω × p) = ω · (p × a)
    by_rotation = torch.linalg.cross(
        points[:, :, None, :].expand_as(by_translation), by_translation
    )
    return torch.cat([by_translation, by_rotation], -1)


def true_displacement(points_cam: Tensor, K: Tensor, T_init: Tensor, target: Tensor) -> Tensor:
    """Where pixels really belong, minus where they are; exact, not linearised.

    Args:
        points_cam: (B, N, 3) points in the decalibrated camera frame, metres.
        K: (B, 3, 3) camera matrices.
        T_init: (B, 4, 4) decalibrated extrinsics.
        target: (B, 6) the decalibration.

    Returns:
        (B, N, 2) columns and rows, pixels.
    """
    move = correct(T_init, target) @ invert(T_init)
    moved = transform_points(move, points_cam)
    here = points_cam[..., :2] / points_cam[..., 2:]
    there = moved[..., :2] / moved[..., 2:].clamp(min=0.1)
    focal = torch.stack([K[:, 0, 0], K[:, 1, 1]], -1)[:, None]
    return (there - here) * focal
