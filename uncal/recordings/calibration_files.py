"""Calibration files: what all layouts share, and the chains from the LiDAR to a camera.

KITTI projects a LiDAR point p by P_rect_0i · R_rect_00 · T_velo_to_cam · p. With
P_rect_0i = K · [I | b], b = K⁻¹ · P_rect_0i[:, 3], the extrinsic of camera i is therefore

    T_cam_lidar = [I | b] · R_rect_00 · T_velo_to_cam        (odometry: [I | b] · Tr).

Code in circulation keeps only b_x ≈ P[0, 3] / P[0, 0]. For the grey cameras that is the same; for
the colour cameras of KITTI it is some 3 mm off the projection that KITTI defines.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from uncal.errors import CalibrationMissing, RecordingError, RotationError

_ROTATION_TOLERANCE = 1e-3
"""Largest entry of R·Rᵀ - I; KITTI prints seven digits, so a larger one is a damaged file."""

_RESTORE = "Restore the file from the archive of its data set."

SIDES: dict[str, int] = {"left": 0, "right": 3}
"""Event camera → its number in ``cam_to_cam.yaml``."""

_SOURCE = "DSEC offers the calibration as an archive of its own; unpack it over the sequences."


@dataclass(frozen=True)
class CameraCalibration:
    """What one camera of one rig needs.

    Attributes:
        K: (3, 3) camera matrix, pixels.
        T_cam_lidar: (4, 4) true extrinsic, LiDAR → this camera, metres.
        size: (H, W) of the images as recorded, pixels; None where the files do not say.
    """

    K: NDArray[np.float64]
    T_cam_lidar: NDArray[np.float64]
    size: tuple[int, int] | None = None


def read_calibration_text(path: Path, source: str) -> str:
    """The text of a calibration file; ``source`` is a sentence that says where to get it."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise CalibrationMissing(
            f"Cannot read the calibration file {path} ({error.strerror}). {source}"
        ) from error


def read_calibration_yaml(path: Path, source: str) -> object:
    """The content of a YAML file; see :func:`read_calibration_text`."""
    try:
        return yaml.safe_load(read_calibration_text(path, source))
    except yaml.YAMLError as error:
        raise RecordingError(f"{path} is no YAML file; copy it again ({error}).") from error


def numbers_at(
    content: object, keys: str, shape: tuple[int, ...], path: Path
) -> NDArray[np.float64]:
    """Finite numbers at a dotted key of nested mappings, such as ``extrinsics.T_10``."""
    parts = keys.split(".")
    for depth, key in enumerate(parts, 1):
        if not isinstance(content, Mapping) or key not in content:
            there = ", ".join(map(str, content)) if isinstance(content, Mapping) else "none"
            raise RecordingError(
                f"{path} has no key '{'.'.join(parts[:depth])}'; keys there: {there}."
            )
        content = content[key]
    return numbers(content, shape, path, keys)


def numbers(
    value: object, shape: tuple[int, ...] | None, path: Path, where: str
) -> NDArray[np.float64]:
    """Finite numbers of a shape; None: of any. Anything else is refused by file and key."""
    try:
        # YAML 1.1 takes 1e-05, without a dot, for a word; numpy takes the word for a number.
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if not np.isfinite(array).all() or shape not in (None, array.shape):
        shown = value.tolist() if isinstance(value, np.ndarray) else value
        raise RecordingError(
            f"{path}: '{where}' is {shown}, expected finite numbers"
            + (f" of shape {shape}." if shape else ".")
        )
    return array


def rotation_at(content: object, keys: str, path: Path) -> NDArray[np.float64]:
    """(4, 4) transform of a (3, 3) rotation at a dotted key; raises as :func:`numbers_at`."""
    T = np.eye(4)
    T[:3, :3] = numbers_at(content, keys, (3, 3), path)
    check_rotation(T[:3, :3], f"'{keys}'", path, _RESTORE)
    return T


def transform_at(content: object, keys: str, path: Path) -> NDArray[np.float64]:
    """(4, 4) rigid transform at a dotted key; raises as :func:`numbers_at`."""
    T = numbers_at(content, keys, (4, 4), path)
    check_rotation(T[:3, :3], f"'{keys}'", path, _RESTORE)
    if not np.array_equal(T[3], (0, 0, 0, 1)):
        raise RecordingError(
            f"{path}: the last row of '{keys}' is {T[3].tolist()}, expected [0, 0, 0, 1]."
        )
    return T


def check_rotation(rotation: NDArray[np.float64], name: str, path: Path, remedy: str) -> None:
    """Refuse a (3, 3) matrix that is no rotation, with file, matrix and remedy."""
    defect = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if defect > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise RotationError(
            f"{path}: {name} is not a rotation (R·Rᵀ is off the identity by {defect:.2g}, "
            f"det {np.linalg.det(rotation):.3f}). {remedy}"
        )


def is_camera_matrix(K: NDArray[np.float64]) -> bool:
    """Whether an array is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with focal lengths above 0."""
    return K.shape == (3, 3) and bool(K[0, 0] > 0 and K[1, 1] > 0 and K[2, 2] == 1)


def height_width(width_height: NDArray[np.float64]) -> tuple[int, int]:
    """(H, W) of the two numbers that calibration files have width first."""
    return round(float(width_height[1])), round(float(width_height[0]))


def read_calibration_file(path: Path) -> dict[str, NDArray[np.float64]]:
    """KITTI's ``key: numbers`` lines; 9 and 12 numbers are (3, 3) and (3, 4), dates left out."""
    source = "KITTI offers the calibration as an archive of its own; unpack it over the recordings."
    text = read_calibration_text(path, source)
    values: dict[str, NDArray[np.float64]] = {}
    for line in text.splitlines():
        key, _, text_after = line.partition(":")
        try:
            found = np.array([float(number) for number in text_after.split()])
        except ValueError:
            continue
        if found.size:
            values[key.strip()] = found.reshape(3, -1) if found.size in (9, 12) else found
    return values


def raw_calibration(date_folder: Path, camera: int) -> CameraCalibration:
    """Calibration of camera 0..3, rectified, of a KITTI raw date folder with its two files.

    Raises:
        RecordingError: a file or a key is missing or damaged.
    """
    path, lidar_path = date_folder / "calib_cam_to_cam.txt", date_folder / "calib_velo_to_cam.txt"
    cameras, lidar = read_calibration_file(path), read_calibration_file(lidar_path)
    T_cam0_lidar = rotation_at(lidar, "R", lidar_path)
    T_cam0_lidar[:3, 3] = numbers_at(lidar, "T", (3,), lidar_path)
    T_rect0_lidar = rotation_at(cameras, "R_rect_00", path) @ T_cam0_lidar
    size = None
    if f"S_rect_0{camera}" in cameras:
        size = height_width(numbers_at(cameras, f"S_rect_0{camera}", (2,), path))
    return _from_projection(cameras, f"P_rect_0{camera}", T_rect0_lidar, path, size)


def odometry_calibration(path: Path, camera: int) -> CameraCalibration:
    """Calibration of camera 0..3, rectified, by a sequence's ``calib.txt`` (P0..P3 and Tr).

    Raises:
        RecordingError: the file or a key is missing or damaged.
    """
    values = read_calibration_file(path)
    if "Tr" not in values:
        raise RecordingError(
            f"{path} has no key 'Tr' (LiDAR → camera 0); keys there: {', '.join(values)}. "
            "Use the calib.txt of data_odometry_calib.zip, which has it."
        )
    T_rect0_lidar = np.eye(4)
    T_rect0_lidar[:3] = numbers_at(values, "Tr", (3, 4), path)
    check_rotation(T_rect0_lidar[:3, :3], "'Tr'", path, _RESTORE)
    return _from_projection(values, f"P{camera}", T_rect0_lidar, path)


def _from_projection(
    values: Mapping[str, NDArray[np.float64]],
    key: str,  # of P_rect_0i
    T_rect0_lidar: NDArray[np.float64],  # (4, 4), LiDAR → rectified camera 0
    path: Path,
    size: tuple[int, int] | None = None,
) -> CameraCalibration:
    projection = numbers_at(values, key, (3, 4), path)
    K = projection[:, :3].copy()
    if not is_camera_matrix(K):
        raise RecordingError(
            f"{path}: '{key}' starts with {K.tolist()}, which is no camera matrix "
            f"[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]. {_RESTORE}"
        )
    T_cam_rect0 = np.eye(4)
    T_cam_rect0[:3, 3] = np.linalg.solve(K, projection[:, 3])
    return CameraCalibration(K, T_cam_rect0 @ T_rect0_lidar, size)


def event_camera_calibration(
    cam_to_cam: Path, cam_to_lidar: Path, side: str = "left"
) -> CameraCalibration:
    """Calibration of one rectified event camera of DSEC.

    DSEC calibrates the LiDAR against camRect1, the rectified left *frame* camera, and the cameras
    against each other: cam0 and cam3 are the event cameras left and right, cam1 and cam2 the frame
    cameras. ``T_XY`` takes points from camY to camX and ``R_rectX`` from camX to camRectX, hence

        T_camRect0_lidar = R_rect0 · T_10⁻¹ · R_rect1⁻¹ · T_lidar_camRect1⁻¹        (left)
        T_camRect3_lidar = R_rect3 · T_32 · T_21 · R_rect1⁻¹ · T_lidar_camRect1⁻¹   (right).

    Returns:
        K of camRect0 (right: camRect3) and the extrinsic from the LiDAR to that camera. A frame
        camera's K scaled to the event camera's size would stay in the frame camera, whose
        viewpoint is some 4 cm away (right: 9 cm).

    Raises:
        RecordingError: a file (the second may be the drive's) or a key is missing or damaged.
    """
    cameras, path = read_calibration_yaml(cam_to_cam, _SOURCE), cam_to_cam
    number = SIDES[side]
    camera = f"intrinsics.camRect{number}"
    fx, fy, cx, cy = numbers_at(cameras, f"{camera}.camera_matrix", (4,), path)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)
    if not is_camera_matrix(K):
        raise RecordingError(
            f"{path}: camRect{number}'s camera_matrix starts with fx = {fx}, fy = {fy}, "
            "expected [fx, fy, cx, cy] in pixels. Restore the file from DSEC's archive."
        )
    size = None
    if "resolution" in cameras["intrinsics"][f"camRect{number}"]:  # type: ignore[index]
        size = height_width(numbers_at(cameras, f"{camera}.resolution", (2,), path))
    T_rect1_cam1 = rotation_at(cameras, "extrinsics.R_rect1", path)
    T_rect_cam = rotation_at(cameras, f"extrinsics.R_rect{number}", path)
    if side == "left":
        T_cam_cam1 = np.linalg.inv(transform_at(cameras, "extrinsics.T_10", path))
    else:
        T_32 = transform_at(cameras, "extrinsics.T_32", path)
        T_cam_cam1 = T_32 @ transform_at(cameras, "extrinsics.T_21", path)
    lidar = read_calibration_yaml(cam_to_lidar, _SOURCE)
    T_lidar_rect1 = transform_at(lidar, "T_lidar_camRect1", cam_to_lidar)
    T_rect_rect1 = T_rect_cam @ T_cam_cam1 @ np.linalg.inv(T_rect1_cam1)
    return CameraCalibration(K, T_rect_rect1 @ np.linalg.inv(T_lidar_rect1), size)
