"""DSEC's calibration files and the chain from the LiDAR to a rectified event camera.

DSEC calibrates the LiDAR against camRect1, the rectified left *frame* camera, and the cameras
against each other: cam0 and cam3 are the event cameras left and right, cam1 and cam2 the frame
cameras. ``T_XY`` takes points from camY to camX and ``R_rectX`` from camX to camRectX, hence

    T_camRect0_lidar = R_rect0 · T_10⁻¹ · R_rect1⁻¹ · T_lidar_camRect1⁻¹        (left)
    T_camRect3_lidar = R_rect3 · T_32 · T_21 · R_rect1⁻¹ · T_lidar_camRect1⁻¹   (right).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uncal.errors import RecordingError
from uncal.recordings.calibration_files import (
    CameraCalibration,
    height_width,
    is_camera_matrix,
    numbers_at,
    read_calibration_yaml,
    rotation_at,
    transform_at,
)

SIDES: dict[str, int] = {"left": 0, "right": 3}
"""Event camera → its number in ``cam_to_cam.yaml``."""

_SOURCE = "DSEC offers the calibration as an archive of its own; unpack it over the sequences."


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
