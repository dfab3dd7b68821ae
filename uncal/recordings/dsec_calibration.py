"""DSEC's calibration files and the chain from the LiDAR to a rectified event camera.

DSEC calibrates the LiDAR against camRect1, the rectified left *frame* camera, and the cameras
against each other: cam0 and cam3 are the event cameras left and right, cam1 and cam2 the frame
cameras. ``T_XY`` takes points from camY to camX and ``R_rectX`` from camX to camRectX, hence

    T_camRect0_lidar = R_rect0 · T_10⁻¹ · R_rect1⁻¹ · T_lidar_camRect1⁻¹        (left)
    T_camRect3_lidar = R_rect3 · T_32 · T_21 · R_rect1⁻¹ · T_lidar_camRect1⁻¹   (right).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from uncal.errors import CalibrationMissing, RecordingError
from uncal.recordings.calibration_files import CameraCalibration, check_rotation

SIDES: dict[str, int] = {"left": 0, "right": 3}
"""Event camera → its number in ``cam_to_cam.yaml``."""

_RESTORE = "Restore the file from DSEC's archive."


def event_camera_calibration(
    cam_to_cam: Path, cam_to_lidar: Path, side: str = "left"
) -> CameraCalibration:
    """Calibration of one rectified event camera.

    Args:
        cam_to_cam: ``cam_to_cam.yaml`` of the sequence.
        cam_to_lidar: ``cam_to_lidar.yaml`` of the sequence or of its drive.
        side: a key of :data:`SIDES`.

    Returns:
        K of camRect0 (right: camRect3) and the extrinsic from the LiDAR to that camera. A frame
        camera's K scaled to the event camera's size would stay in the frame camera, whose
        viewpoint is some 4 cm away (right: 9 cm).

    Raises:
        RecordingError: a file or a key is missing or damaged.
    """
    cameras = _read(cam_to_cam)
    number = SIDES[side]
    fx, fy, cx, cy = _numbers(
        cameras, ("intrinsics", f"camRect{number}", "camera_matrix"), (4,), cam_to_cam
    )
    if not (fx > 0 and fy > 0):
        raise RecordingError(
            f"{cam_to_cam}: camRect{number}'s camera_matrix starts with fx = {fx}, fy = {fy}, "
            "expected [fx, fy, cx, cy] in pixels. Restore the file from DSEC's archive."
        )
    T_rect1_cam1 = _rectification(cameras, 1, cam_to_cam)
    T_rect_cam = _rectification(cameras, number, cam_to_cam)
    if side == "left":
        T_cam_cam1 = np.linalg.inv(_transform(cameras, ("extrinsics", "T_10"), cam_to_cam))
    else:
        T_32 = _transform(cameras, ("extrinsics", "T_32"), cam_to_cam)
        T_cam_cam1 = T_32 @ _transform(cameras, ("extrinsics", "T_21"), cam_to_cam)
    T_lidar_rect1 = _transform(_read(cam_to_lidar), ("T_lidar_camRect1",), cam_to_lidar)
    T_rect_rect1 = T_rect_cam @ T_cam_cam1 @ np.linalg.inv(T_rect1_cam1)
    return CameraCalibration(
        K=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64),
        T_cam_lidar=T_rect_rect1 @ np.linalg.inv(T_lidar_rect1),
        size=_resolution(cameras, number, cam_to_cam),
    )


def _read(path: Path) -> object:
    try:
        content: object = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationMissing(
            f"Cannot read the calibration file {path} ({error.strerror}). DSEC offers the "
            "calibration as an archive of its own; unpack it over the sequences."
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path} is no YAML file; copy it again ({error}).") from error
    return content


def _numbers(
    content: object, keys: tuple[str, ...], shape: tuple[int, ...], path: Path
) -> NDArray[np.float64]:
    for depth, key in enumerate(keys):
        if not isinstance(content, Mapping) or key not in content:
            there = ", ".join(map(str, content)) if isinstance(content, Mapping) else "none"
            raise RecordingError(
                f"{path} has no key '{'.'.join(keys[: depth + 1])}'; keys there: {there}."
            )
        content = content[key]
    try:
        # YAML 1.1 takes 1e-05, without a dot, for a word; numpy takes the word for a number.
        numbers = np.array(content, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        raise RecordingError(
            f"{path}: '{'.'.join(keys)}' is {content}, expected finite numbers of shape {shape}."
        )
    return numbers


def _resolution(cameras: object, number: int, path: Path) -> tuple[int, int] | None:
    """(H, W) of the rectified camera; the file has width first, or does not say."""
    keys = ("intrinsics", f"camRect{number}")
    node = cameras
    for key in keys:
        node = node.get(key) if isinstance(node, Mapping) else None
    if not isinstance(node, Mapping) or "resolution" not in node:
        return None
    width, height = _numbers(cameras, (*keys, "resolution"), (2,), path)
    return round(float(height)), round(float(width))


def _transform(content: object, keys: tuple[str, ...], path: Path) -> NDArray[np.float64]:
    T = _numbers(content, keys, (4, 4), path)
    check_rotation(T[:3, :3], f"'{'.'.join(keys)}'", path, _RESTORE)
    if not np.array_equal(T[3], (0, 0, 0, 1)):
        raise RecordingError(
            f"{path}: the last row of '{'.'.join(keys)}' is {T[3].tolist()}, expected [0, 0, 0, 1]."
        )
    return T


def _rectification(cameras: object, number: int, path: Path) -> NDArray[np.float64]:
    T = np.eye(4)
    T[:3, :3] = _numbers(cameras, ("extrinsics", f"R_rect{number}"), (3, 3), path)
    check_rotation(T[:3, :3], f"'extrinsics.R_rect{number}'", path, _RESTORE)
    return T
