"""The three calibration files of a KITTI raw date folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from uncal.simulation.sensors.rig import Rig
from uncal.simulation.settings import SimulationSettings

CALIB_TIME = "01-Jan-2041 00:00:00"

CAMERA_X_M = (0.0, -0.54, None, -0.48)
"""x of camera 0 → camera i, metres; None: the rig's own baseline (camera 2 carries the images)."""


def _line(key: str, values: Iterable[float]) -> str:
    """``key: v v v`` with more digits than KITTI's, so that nothing is lost by rounding."""
    return f"{key}: {' '.join(f'{value:.12e}' for value in values)}\n"


def write_calibration(rig: Rig, settings: SimulationSettings, folder: Path) -> None:
    """Write ``calib_cam_to_cam.txt``, ``calib_velo_to_cam.txt`` and ``calib_imu_to_velo.txt``.

    The chain that a reader must follow, T_cam_lidar = T2 · R_rect_00 · T_velo_to_cam with
    T2[0, 3] = P_rect_02[0, 3] / P_rect_02[0, 0], gives the rig's true extrinsic. Only camera 2 is
    simulated; the other three cameras have plausible entries because readers look for them.
    """
    size = (float(settings.camera.width), float(settings.camera.height))
    text = f"calib_time: {CALIB_TIME}\n" + _line("corner_dist", [0.1])
    for camera, x in enumerate(CAMERA_X_M):
        x_m = rig.baseline_m if x is None else x
        projection = np.hstack([rig.K, np.zeros((3, 1))])
        projection[0, 3] = rig.K[0, 0] * x_m
        text += _line(f"S_{camera:02d}", size)
        text += _line(f"K_{camera:02d}", rig.K.ravel())
        text += _line(f"D_{camera:02d}", np.zeros(5))
        text += _line(f"R_{camera:02d}", np.eye(3).ravel())
        text += _line(f"T_{camera:02d}", rig.R_rect.T @ [x_m, 0.0, 0.0])
        text += _line(f"S_rect_{camera:02d}", size)
        text += _line(f"R_rect_{camera:02d}", rig.R_rect.ravel())
        text += _line(f"P_rect_{camera:02d}", projection.ravel())
    (folder / "calib_cam_to_cam.txt").write_text(text)

    lidar = rig.T_cam0_lidar
    text = f"calib_time: {CALIB_TIME}\n"
    text += _line("R", lidar[:3, :3].ravel()) + _line("T", lidar[:3, 3])
    text += _line("delta_f", np.zeros(2)) + _line("delta_c", np.zeros(2))
    (folder / "calib_velo_to_cam.txt").write_text(text)

    text = f"calib_time: {CALIB_TIME}\n"
    text += _line("R", np.eye(3).ravel()) + _line("T", [-0.8, 0.3, -0.8])
    (folder / "calib_imu_to_velo.txt").write_text(text)
