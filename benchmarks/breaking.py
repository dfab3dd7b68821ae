"""What breaks a good recording of any layout: its transforms, points and files."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from uncal.geometry import euler_to_matrix, matrix_to_euler

Matrix = NDArray[np.float64]
Break = Callable[[Path], None]
"""Changes a copy of a recording in place."""

XY = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
"""x to the right, y forward."""

YZ = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""y and z swapped."""

Y_RIGHT = np.diag([1.0, -1.0, 1.0])
"""The other handedness."""

K1 = -0.3
"""Radial distortion that is left in an image."""


def inverse(T: Matrix) -> Matrix:
    """Camera → LiDAR in place of LiDAR → camera."""
    return np.asarray(np.linalg.inv(T), np.float64)


def in_millimetres(T: Matrix) -> Matrix:
    """Its translation a thousand times as long."""
    return np.block([[T[:3, :3], 1000 * T[:3, 3:]], [T[3:]]])


def scaled(T: Matrix) -> Matrix:
    """No rotation any more."""
    return np.block([[1.02 * T[:3, :3], T[:3, 3:]], [T[3:]]])


def degrees_for_radians(T: Matrix) -> Matrix:
    """Its angles in degrees, taken for radians."""
    angles = matrix_to_euler(torch.from_numpy(T[:3, :3])).rad2deg()
    return np.block([[euler_to_matrix(angles).numpy(), T[:3, 3:]], [T[3:]]])


def distort(points: Matrix, K: Matrix) -> Matrix:
    """(n, 2) pixels where a lens with :data:`K1` sees what a pinhole camera sees at these."""
    x, y = ((points[:, axis] - K[axis, 2]) / K[axis, axis] for axis in (0, 1))
    longer = 1.0 + K1 * (x * x + y * y)
    return np.stack([K[0, 0] * longer * x + K[0, 2], K[1, 1] * longer * y + K[1, 2]], -1)


def undistort(points: Matrix, K: Matrix) -> Matrix:
    """The way back."""
    lens = np.array([K1, 0.0, 0.0, 0.0])
    found = cv2.undistortPoints(points.reshape(-1, 1, 2), K, lens, P=K)
    return np.asarray(found, np.float64).reshape(-1, 2)


def first_of_each(root: Path, pattern: str) -> Iterator[Path]:
    """The first such file of every folder."""
    folders = {path.parent for path in root.rglob(pattern)}
    return (sorted(folder.glob(pattern))[0] for folder in sorted(folders))


def cut(paths: Iterator[Path], share: float) -> None:
    """Keep a share of each file; 0: nothing."""
    for path in paths:
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content)) | 1 if share else 0])


def remove(root: Path, *names: str) -> None:
    """Delete files or folders of these names (or ends of paths) wherever they are."""
    for path in [path for name in names for path in root.rglob(name)]:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
