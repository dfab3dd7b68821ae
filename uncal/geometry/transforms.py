"""Rigid transforms and Euler angles, batched in torch.

Frames follow the field: LiDAR x forward, y left, z up; camera x right, y down, z forward.
``T_a_b`` maps points of frame b into frame a. Metres and radians throughout.
"""

from __future__ import annotations

import torch
from torch import Tensor

DOF_NAMES: tuple[str, ...] = ("X", "Y", "Z", "Roll", "Pitch", "Yaw")
"""The order of every 6-vector in this package: translation, then rotation, in the LiDAR frame."""

DOF_UNITS: tuple[str, ...] = ("cm", "cm", "cm", "°", "°", "°")
"""The units in which a person reads the six numbers."""

DOF_SCALE: tuple[float, ...] = (100.0,) * 3 + (180.0 / 3.141592653589793,) * 3
"""Factors from metres and radians to :data:`DOF_UNITS`."""


def euler_to_matrix(angles: Tensor) -> Tensor:
    """(..., 3, 3) rotations R = Rz(yaw) · Ry(pitch) · Rx(roll) of (..., 3) radians.

    >>> euler_to_matrix(torch.tensor([0.0, 0.0, torch.pi / 2])).round().int().tolist()
    [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    """
    roll, pitch, yaw = angles.unbind(-1)
    cr, sr = roll.cos(), roll.sin()
    cp, sp = pitch.cos(), pitch.sin()
    cy, sy = yaw.cos(), yaw.sin()
    rows = [
        torch.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], -1),
        torch.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], -1),
        torch.stack([-sp, cp * sr, cp * cr], -1),
    ]
    return torch.stack(rows, -2)


def matrix_to_euler(rotation: Tensor) -> Tensor:
    """(..., 3) roll, pitch, yaw in radians of (..., 3, 3) rotations with |pitch| < 90°.

    The inverse of :func:`euler_to_matrix`.

    >>> angles = torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64)
    >>> torch.allclose(matrix_to_euler(euler_to_matrix(angles)), angles)
    True
    """
    roll = torch.atan2(rotation[..., 2, 1], rotation[..., 2, 2])
    pitch = torch.asin((-rotation[..., 2, 0]).clamp(-1.0, 1.0))
    yaw = torch.atan2(rotation[..., 1, 0], rotation[..., 0, 0])
    return torch.stack([roll, pitch, yaw], -1)


def pose_to_matrix(pose: Tensor) -> Tensor:
    """(..., 4, 4) transforms of (..., 6) metres and radians in the order of :data:`DOF_NAMES`.

    >>> pose_to_matrix(torch.tensor([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]))[:3, 3].tolist()
    [1.0, 2.0, 3.0]
    """
    transform = torch.zeros(*pose.shape[:-1], 4, 4, dtype=pose.dtype, device=pose.device)
    transform[..., :3, :3] = euler_to_matrix(pose[..., 3:])
    transform[..., :3, 3] = pose[..., :3]
    transform[..., 3, 3] = 1.0
    return transform


def matrix_to_pose(transform: Tensor) -> Tensor:
    """(..., 6) metres and radians of (..., 4, 4) rigid transforms with |pitch| < 90°.

    The inverse of :func:`pose_to_matrix`.

    >>> matrix_to_pose(torch.eye(4)).abs().sum().item()
    0.0
    """
    return torch.cat([transform[..., :3, 3], matrix_to_euler(transform[..., :3, :3])], -1)


def invert(transform: Tensor) -> Tensor:
    """Inverses of (..., 4, 4) rigid transforms (transpose of the rotation, no general solve).

    >>> T = pose_to_matrix(torch.tensor([0.3, -1.0, 2.0, 0.1, 0.2, 0.3], dtype=torch.float64))
    >>> torch.allclose(invert(T) @ T, torch.eye(4, dtype=torch.float64))
    True
    """
    rotation = transform[..., :3, :3].transpose(-1, -2)
    inverse = torch.zeros_like(transform)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3] = -(rotation @ transform[..., :3, 3:]).squeeze(-1)
    inverse[..., 3, 3] = 1.0
    return inverse


def transform_points(transform: Tensor, points: Tensor) -> Tensor:
    """(..., N, 3) points in frame a, metres, by (..., 4, 4) ``T_a_b`` and (..., N, 3) in frame b.

    >>> T = pose_to_matrix(torch.tensor([1.0, 0.0, 0.0, 0.0, 0.0, torch.pi / 2]))
    >>> transform_points(T, torch.tensor([[1.0, 0.0, 0.0]])).round().tolist()
    [[1.0, 1.0, 0.0]]
    """
    return points @ transform[..., :3, :3].transpose(-1, -2) + transform[..., None, :3, 3]
