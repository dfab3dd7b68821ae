"""The forty-eight ways in which three axes can be named, and which of them a sweep uses."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray


def signed_permutations() -> list[NDArray[np.float32]]:
    """(3, 3) each: 24 rotations and 24 reflections; the identity first."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3), np.float32)
            matrix[range(3), order] = signs
            found.append(matrix)
    return found


def describe(matrix: NDArray[np.float32]) -> str:
    """What a signed permutation makes of x, y, z.

    >>> describe(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float32))
    '(-y, x, z)'
    """
    names = []
    for row in matrix:
        axis = int(np.abs(row).argmax())
        names.append(("-" if row[axis] < 0 else "") + "xyz"[axis])
    return f"({', '.join(names)})"


def to_lidar_axes(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """(3, 3) rotation, one ±1 a row, that brings the axis of an (N, 3) sweep to z, up.

    A sweep is flat: it reaches far to the sides, and hardly up or down. Most of its returns come
    from below the sensor.

    >>> sweep = np.array([[0, 1.5, 9], [9, 1.6, 1], [-9, 1.7, 2], [3, 1.6, -9]], np.float32)
    >>> describe(to_lidar_axes(sweep))
    '(z, -x, -y)'
    """
    xyz = points[:, :3]
    low, high = np.quantile(xyz, (0.1, 0.9), axis=0)
    up = int((high - low).argmin())
    sign = -1.0 if float(np.median(xyz[:, up])) > 0 else 1.0
    rows = np.zeros((3, 3), np.float32)
    rows[2, up] = sign
    # z forward and x right is what most write who write y down.
    forward = {0: 2, 1: 2, 2: 0}[up]
    rows[0, forward] = 1.0
    rows[1] = np.cross(rows[2], rows[0])
    return rows
