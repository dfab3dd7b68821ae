"""Rigid transforms in numpy, for worker processes that must start without loading torch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def pose_matrix(
    translation: tuple[float, float, float] | NDArray[np.float64],
    euler: tuple[float, float, float] | NDArray[np.float64],
) -> Matrix:
    """(4, 4) transform, R = Rz(yaw) · Ry(pitch) · Rx(roll); x, y, z in metres, angles in radians.

    >>> pose_matrix((1, 2, 3), (0, 0, np.pi / 2)).round().astype(int).tolist()
    [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler), np.sin(euler)
    transform = np.eye(4)
    transform[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    transform[:3, 3] = translation
    return transform


def inverse(transform: Matrix) -> Matrix:
    """Inverse of a (4, 4) rigid transform.

    >>> T = pose_matrix((0.3, -1.0, 2.0), (0.1, 0.2, 0.3))
    >>> bool(np.allclose(inverse(T) @ T, np.eye(4)))
    True
    """
    result = np.eye(4)
    result[:3, :3] = transform[:3, :3].T
    result[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return result
