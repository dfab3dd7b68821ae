"""The LiDAR moves in its mount during a drive, while the calibration files stay as they were.

The scan is taken from the moved LiDAR. With P its pose in the frame of the LiDAR as it was mounted,
the true extrinsic is ``T_true = T_nominal · P``; whoever assumes T_nominal has the decalibration
``D = P⁻¹`` (:mod:`uncal.geometry.decalibration`: ``T_nominal = T_true · D``). An artificial
decalibration of the same size differs in what the LiDAR measures: here its rings move through the
scene.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import RecordingError
from uncal.simulation.rigid import Matrix, pose_matrix
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import SimulationSettings

TRUTH_NAME = "true_T_cam_lidar.txt"
"""In the folder of a drive: the true extrinsic of every frame, for evaluation alone."""


def lidar_motion(settings: SimulationSettings, rig: int, drive: int, frame: int) -> Matrix:
    """P (4, 4): moved LiDAR → LiDAR as mounted, at one frame; the identity without motion.

    Step and ramp grow linearly over ``ramp_frames``; on top, every DoF j vibrates as
    a sin(2π f t + φ_j), with φ_j drawn per drive. Within a sweep the LiDAR stands still.
    """
    motion = settings.motion
    if motion is None or frame < motion.first_frame:
        return np.eye(4)
    share = min((frame - motion.first_frame + 1) / motion.ramp_frames, 1.0)
    phase = generator(settings.seed, Stream.VIBRATION, rig, drive).uniform(0, 2 * np.pi, 6)
    time = frame * settings.vehicle.frame_interval_s
    wave = np.sin(2 * np.pi * motion.vibration_hz * time + phase)
    centimetres = share * np.array([motion.x_cm, motion.y_cm, motion.z_cm])
    degrees = share * np.array([motion.roll_deg, motion.pitch_deg, motion.yaw_deg])
    centimetres += motion.vibration_cm * wave[:3]
    degrees += motion.vibration_deg * wave[3:]
    return pose_matrix(0.01 * centimetres, np.deg2rad(degrees))


def write_truth(settings: SimulationSettings, rig: int, drive: int, folder: Path) -> None:
    """Write every frame's true extrinsic into a drive's folder; nothing without motion.

    One line a frame, the 12 numbers of the upper three rows of T_cam_lidar, row by row, as in
    KITTI's files of poses.
    """
    if settings.motion is None:
        return
    nominal = draw_rig(settings, rig).T_cam_lidar
    rows = [
        (nominal @ lidar_motion(settings, rig, drive, frame))[:3].ravel()
        for frame in range(settings.frames_per_drive)
    ]
    np.savetxt(folder / TRUTH_NAME, rows, fmt="%.12e")


def read_truth(folder: Path) -> NDArray[np.float64]:
    """(frames, 4, 4) T_cam_lidar that :func:`write_truth` has written.

    Raises:
        RecordingError: there is no such file, or it is damaged.
    """
    path = folder / TRUTH_NAME
    try:
        rows = np.loadtxt(path, ndmin=2)
        top = rows.reshape(len(rows), 3, 4)
    except (OSError, ValueError) as error:
        raise RecordingError(
            f"{path} cannot be read ({error}); the simulator writes it, 12 numbers a frame, for "
            "drives with simulation.motion"
        ) from error
    bottom = np.broadcast_to([[[0.0, 0.0, 0.0, 1.0]]], (len(rows), 1, 4))
    return np.concatenate([top, bottom], axis=1)
