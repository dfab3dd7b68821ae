"""What breaks a good recording of any layout: its transforms, points and files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
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


Faults = dict[str, tuple[str, Break]]
"""Name of a fault → the kind that a check should name, and what puts it in."""


def geometric(
    extrinsic: Callable[[Path, Callable[[Matrix], Matrix]], None],
    points: Callable[[Path, Matrix], None],
    camera_frame: Break,
    K: Callable[[Path, float], None],
) -> Faults:
    """Faults of the geometry that any layout can have, under one name in all.

    Args:
        extrinsic: writes another (4, 4) extrinsic, made of the one that is there.
        points: multiplies all points by a (3, 3) matrix.
        camera_frame: moves all points into the camera's frame.
        K: scales the camera matrix.
    """
    return {
        "inverted extrinsic": ("inverted", lambda root: extrinsic(root, inverse)),
        "axes: x right, y forward": ("axes", lambda root: points(root, XY)),
        "axes: y and z swapped": ("axes", lambda root: points(root, YZ)),
        "handedness: y to the right": ("axes", lambda root: points(root, Y_RIGHT)),
        "points in the camera's frame": ("camera frame", camera_frame),
        "points in millimetres": ("millimetres", lambda root: points(root, 1000 * np.eye(3))),
        "translation in millimetres": ("millimetres", lambda root: extrinsic(root, in_millimetres)),
        "degrees taken for radians": ("degrees", lambda root: extrinsic(root, degrees_for_radians)),
        "K of half the size": ("resolution", lambda root: K(root, 0.5)),
        "K of twice the size": ("resolution", lambda root: K(root, 2.0)),
        "rotation with a scale": ("rotation", lambda root: extrinsic(root, scaled)),
    }


def of_files(image: str, images: str, scan: str, scans: str, calibration: str) -> Faults:
    """Files cut off, empty or missing, under one name in all layouts.

    Args:
        image: pattern of the files that hold images or events.
        images: what is gone without them.
        scan: pattern of the files that hold scans.
        scans: what is gone without them.
        calibration: the file that is gone.
    """
    return {
        "image (events) truncated": ("truncated", lambda root: cut(root, image, 0.6)),
        "image (events) empty": ("truncated", lambda root: cut(root, image, 0.0)),
        "scan (bag) truncated": ("truncated", lambda root: cut(root, scan, 0.6)),
        "scan (bag) empty": ("truncated", lambda root: cut(root, scan, 0.0)),
        "no scans": ("scans", lambda root: remove(root, scans)),
        "no images (events)": ("scans", lambda root: remove(root, images)),
        "no calibration": ("calibration", lambda root: remove(root, calibration)),
    }


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


def cut(root: Path, pattern: str, share: float) -> None:
    """Keep a share of the first such file of every folder; 0: nothing of it."""
    for folder in {path.parent for path in root.rglob(pattern)}:
        path = min(folder.glob(pattern))
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content)) | 1 if share else 0])


def remove(root: Path, name: str) -> None:
    """Delete files or folders of this name (or end of a path) wherever they are."""
    for path in list(root.rglob(name)):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
