"""One rig: camera, LiDAR and how they are mounted; another draw for every date folder."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.rigid import Matrix, inverse, pose_matrix
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.settings import LidarSettings, SimulationSettings

FIRST_DATE = datetime.date(2041, 1, 1)
"""Decades from any KITTI date, so that simulated folders are never mistaken for recorded ones."""

CAMERA_FROM_LIDAR_AXES = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""LiDAR x forward, y left, z up → camera x right, y down, z forward."""

NOMINAL_CAMERA_IN_LIDAR = (0.27, -0.06, -0.08)
"""Metres; about where KITTI's camera 2 sits: ahead of the LiDAR and a little below."""


@dataclass(frozen=True)
class Rig:
    """The true geometry of one rig.

    Attributes:
        date: name of its date folder, ``YYYY_MM_DD``.
        K: (3, 3) camera matrix of the image, pixels; integer coordinates are pixel centres.
        T_cam_lidar: (4, 4) true extrinsic, LiDAR → rectified camera 2.
        R_rect: (3, 3) rectifying rotation of camera 0, as in ``R_rect_00``.
        baseline_m: x of the translation camera 0 → camera 2 in the rectified frame.
        T_vehicle_lidar: (4, 4) LiDAR → vehicle (on the road, x forward, z up).
        elevations: (beams,) elevation of each beam, radians, ascending.
        range_bias: (beams,) metres that each laser measures too much.
        gain: (beams,) factor on the reflectance that each laser reports.
    """

    date: str
    K: NDArray[np.float64]
    T_cam_lidar: Matrix
    R_rect: NDArray[np.float64]
    baseline_m: float
    T_vehicle_lidar: Matrix
    elevations: NDArray[np.float64]
    range_bias: NDArray[np.float64]
    gain: NDArray[np.float64]

    @property
    def T_cam0_lidar(self) -> Matrix:
        """LiDAR → unrectified camera 0: R_rect_00⁻¹ · T2⁻¹ · T_cam_lidar, as KITTI stores it."""
        shift = np.eye(4)
        shift[0, 3] = -self.baseline_m
        rectify = np.eye(4)
        rectify[:3, :3] = self.R_rect
        return inverse(rectify) @ shift @ self.T_cam_lidar


def rig_date(index: int) -> str:
    """Folder name of a rig: consecutive calendar days.

    >>> rig_date(0), rig_date(31)
    ('2041_01_01', '2041_02_01')
    """
    return (FIRST_DATE + datetime.timedelta(days=index)).strftime("%Y_%m_%d")


def draw_rig(settings: SimulationSettings, index: int) -> Rig:
    """Draw the rig of one date folder."""
    rng = generator(settings.seed, Stream.RIG, index)
    vary, camera, lidar = settings.rig, settings.camera, settings.lidar
    rotation = np.deg2rad(vary.rotation_deg) * rng.uniform(-1, 1, 3)
    offset = 0.01 * vary.translation_cm * rng.uniform(-1, 1, 3)
    T_lidar_cam = pose_matrix(np.array(NOMINAL_CAMERA_IN_LIDAR) + offset, rotation)
    focal = camera.focal_px * (1 + 0.01 * vary.focal_percent * rng.uniform(-1, 1))
    centre = vary.principal_point_px * rng.uniform(-1, 1, 2)
    cx, cy = (camera.width - 1) / 2 + centre[0], (camera.height - 1) / 2 + centre[1]
    attitude = np.deg2rad(vary.lidar_attitude_deg) * rng.uniform(-1, 1, 3)
    height = vary.lidar_height_m + vary.lidar_height_variation_m * rng.uniform(-1, 1)
    low, high = np.deg2rad([lidar.elevation_min_deg, lidar.elevation_max_deg])
    jitter = np.deg2rad(lidar.beam_jitter_deg) * rng.standard_normal(lidar.beams)
    return Rig(
        date=rig_date(index),
        K=np.array([[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]]),
        T_cam_lidar=CAMERA_FROM_LIDAR_AXES @ inverse(T_lidar_cam),
        R_rect=pose_matrix((0, 0, 0), np.deg2rad(1.0) * rng.uniform(-1, 1, 3))[:3, :3],
        baseline_m=float(0.06 * rng.uniform(0.8, 1.2)),
        T_vehicle_lidar=pose_matrix((0.0, 0.0, float(height)), attitude),
        elevations=np.sort(_beam_table(lidar, low, high) + jitter),
        range_bias=lidar.range_bias_m * rng.uniform(-1, 1, lidar.beams),
        gain=np.exp(lidar.laser_gain * rng.uniform(-1, 1, lidar.beams)),
    )


def _beam_table(lidar: LidarSettings, low: float, high: float) -> NDArray[np.float64]:
    """(beams,) elevations in radians, ascending: evenly spread, or those of a HDL-64.

    A HDL-64 has two blocks of 32 lasers, the upper one a third of a degree apart, the lower one
    half a degree; fewer beams are taken evenly out of its table.
    """
    if not lidar.hdl64:
        return np.linspace(low, high, lidar.beams)
    lower, upper = np.linspace(-24.33, -8.83, 32), np.linspace(-8.33, 2.0, 32)
    table = np.deg2rad(np.concatenate([lower, upper]))
    return np.asarray(np.interp(np.linspace(0, 63, lidar.beams), np.arange(64), table))
