"""KITTI's calibration text files and the chain from the LiDAR to one rectified camera.

KITTI projects a LiDAR point p by P_rect_0i · R_rect_00 · T_velo_to_cam · p. With
P_rect_0i = K · [I | b], b = K⁻¹ · P_rect_0i[:, 3], the extrinsic of camera i is therefore

    T_cam_lidar = [I | b] · R_rect_00 · T_velo_to_cam        (odometry: [I | b] · Tr).

Code in circulation keeps only b_x ≈ P[0, 3] / P[0, 0]. For the grey cameras that is the same; for
the colour cameras of KITTI it is some 3 mm off the projection that KITTI defines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import CalibrationMissing, RecordingError, RotationError

_ROTATION_TOLERANCE = 1e-3
"""Largest entry of R·Rᵀ - I; KITTI prints seven digits, so a larger one is a damaged file."""

_RESTORE = "Restore the file from KITTI's archive."


@dataclass(frozen=True)
class CameraCalibration:
    """What one camera of one rig needs.

    Attributes:
        K: (3, 3) camera matrix, pixels.
        T_cam_lidar: (4, 4) true extrinsic, LiDAR → this camera, metres.
        size: (H, W) of the images that K is for, pixels; None where the files do not say.
    """

    K: NDArray[np.float64]
    T_cam_lidar: NDArray[np.float64]
    size: tuple[int, int] | None = None


def read_calibration_file(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read ``key: numbers`` lines; lines whose values are not all numbers (dates) are left out.

    Args:
        path: a KITTI calibration text file.

    Returns:
        The numbers of each key, flat, in the file's order.

    Raises:
        RecordingError: the file is missing or cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise CalibrationMissing(
            f"Cannot read the calibration file {path} ({error.strerror}). KITTI offers the "
            "calibration as an archive of its own; unpack it over the recordings."
        ) from error
    values: dict[str, NDArray[np.float64]] = {}
    for line in text.splitlines():
        key, _, text_after = line.partition(":")
        try:
            numbers = np.array([float(number) for number in text_after.split()])
        except ValueError:
            continue
        if numbers.size:
            values[key.strip()] = numbers
    return values


def raw_calibration(date_folder: Path, camera: int) -> CameraCalibration:
    """Calibration of one camera of a KITTI raw date folder.

    Args:
        date_folder: folder with ``calib_cam_to_cam.txt`` and ``calib_velo_to_cam.txt``.
        camera: 0..3, the number of the image folder.

    Returns:
        K and T_cam_lidar of the rectified camera.

    Raises:
        RecordingError: a file or a key is missing or damaged.
    """
    cameras_path = date_folder / "calib_cam_to_cam.txt"
    lidar_path = date_folder / "calib_velo_to_cam.txt"
    cameras = read_calibration_file(cameras_path)
    lidar = read_calibration_file(lidar_path)

    T_cam0_lidar = np.eye(4)
    T_cam0_lidar[:3, :3] = _rotation(lidar, "R", lidar_path)
    T_cam0_lidar[:3, 3] = _matrix(lidar, "T", (3,), lidar_path)
    T_rect0_cam0 = np.eye(4)
    T_rect0_cam0[:3, :3] = _rotation(cameras, "R_rect_00", cameras_path)
    projection = _matrix(cameras, f"P_rect_0{camera}", (3, 4), cameras_path)
    calibration = _from_projection(projection, T_rect0_cam0 @ T_cam0_lidar, cameras_path)
    return replace(calibration, size=_size(cameras, f"S_rect_0{camera}", cameras_path))


def odometry_calibration(path: Path, camera: int) -> CameraCalibration:
    """Calibration of one camera of a KITTI odometry sequence.

    Args:
        path: the sequence's ``calib.txt`` with P0..P3 and Tr (LiDAR → rectified camera 0).
        camera: 0..3, the number of the image folder.

    Returns:
        K and T_cam_lidar of the rectified camera.

    Raises:
        RecordingError: the file or a key is missing or damaged.
    """
    values = read_calibration_file(path)
    if "Tr" not in values:
        raise RecordingError(
            f"{path} has no key 'Tr' (LiDAR → camera 0); keys there: {_listed(values)}. "
            "Use the calib.txt of data_odometry_calib.zip, which has it."
        )
    T_rect0_lidar = np.eye(4)
    T_rect0_lidar[:3] = _matrix(values, "Tr", (3, 4), path)
    check_rotation(T_rect0_lidar[:3, :3], "'Tr'", path, _RESTORE)
    projection = _matrix(values, f"P{camera}", (3, 4), path)
    return _from_projection(projection, T_rect0_lidar, path)


def _from_projection(
    projection: NDArray[np.float64],  # (3, 4), P_rect_0i
    T_rect0_lidar: NDArray[np.float64],  # (4, 4), LiDAR → rectified camera 0
    path: Path,
) -> CameraCalibration:
    K = projection[:, :3].copy()
    if not (K[0, 0] > 0 and K[1, 1] > 0 and K[2, 2] == 1):
        raise RecordingError(
            f"{path}: the projection matrix starts with {K.tolist()}, which is no camera matrix "
            "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]. {remedy}"
        )
    T_cam_rect0 = np.eye(4)
    T_cam_rect0[:3, 3] = np.linalg.solve(K, projection[:, 3])
    return CameraCalibration(K=K, T_cam_lidar=T_cam_rect0 @ T_rect0_lidar)


def _size(values: dict[str, NDArray[np.float64]], key: str, path: Path) -> tuple[int, int] | None:
    """(H, W) of the images after rectification; the file has width first."""
    if key not in values:
        return None
    width, height = _matrix(values, key, (2,), path)
    return round(height), round(width)


def _matrix(
    values: dict[str, NDArray[np.float64]], key: str, shape: tuple[int, ...], path: Path
) -> NDArray[np.float64]:
    if key not in values:
        raise RecordingError(f"{path} has no key '{key}'; keys there: {_listed(values)}.")
    numbers = values[key]
    if numbers.size != np.prod(shape) or not np.isfinite(numbers).all():
        raise RecordingError(
            f"{path}: '{key}' holds {numbers.size} numbers {numbers.tolist()}, "
            f"expected {np.prod(shape)} finite ones."
        )
    return numbers.reshape(shape)


def _rotation(values: dict[str, NDArray[np.float64]], key: str, path: Path) -> NDArray[np.float64]:
    rotation = _matrix(values, key, (3, 3), path)
    check_rotation(rotation, f"'{key}'", path, _RESTORE)
    return rotation


def check_rotation(rotation: NDArray[np.float64], name: str, path: Path, remedy: str) -> None:
    """Make sure that a (3, 3) matrix is a rotation.

    Raises:
        RotationError: it is not; the message names file, matrix and remedy.
    """
    defect = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if defect > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise RotationError(
            f"{path}: {name} is not a rotation (R·Rᵀ is off the identity by {defect:.2g}, "
            f"det {np.linalg.det(rotation):.3f}). {remedy}"
        )


def _listed(values: dict[str, NDArray[np.float64]]) -> str:
    return ", ".join(sorted(values)) or "none"
