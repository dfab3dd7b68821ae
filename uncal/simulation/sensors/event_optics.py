"""The optics of DSEC's rig: distorted event camera, frame camera beside it, rectification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uncal.errors import ConfigurationError
from uncal.simulation.rigid import Matrix, inverse, pose_matrix
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.sensors.rig import Rig
from uncal.simulation.settings import SimulationSettings

RAW_FOCAL = 0.98
"""Focal length of the sensor by the rectified one: it sees a little more than is kept of it."""

FRAME_SCALE = 2
"""Resolution of the frame cameras by that of the event cameras; their images are not simulated."""

FRAME_BASELINE_M, STEREO_BASELINE_M = 0.045, 0.51
"""Event camera → frame camera beside it, left → right frame camera; about DSEC's."""


@dataclass(frozen=True)
class EventOptics:
    """What ``cam_to_cam.yaml`` and ``cam_to_lidar.yaml`` say of one rig, and the sensor's map.

    Cameras: 0 event left, 1 frame left, 2 frame right, 3 event right. T_XY maps camera Y → X.

    Attributes:
        K: (3, 3) of the event sensor before rectification, pixels.
        K_rect: (3, 3) of the rectified events: the rig's camera matrix.
        distortion: k1, k2, p1, p2 of the event sensor; only k1 differs from 0.
        R_rect: four (3, 3) rotations, camera → rectified camera.
        T_10: (4, 4) event left → frame left, m.
        T_21: (4, 4) frame left → frame right, m.
        T_32: (4, 4) frame right → event right, m.
        T_lidar_camRect1: (4, 4) rectified left frame camera → LiDAR, m.
    """

    K: NDArray[np.float64]
    K_rect: NDArray[np.float64]
    distortion: tuple[float, float, float, float]
    R_rect: tuple[NDArray[np.float64], ...]
    T_10: Matrix
    T_21: Matrix
    T_32: Matrix
    T_lidar_camRect1: Matrix

    def rectify(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 2) rectified pixels of (...) columns and rows of the sensor; integers are centres.

        A lens that bends rays so much that positions have none of their own is refused.
        """
        x, y = (u - self.K[0, 2]) / self.K[0, 0], (v - self.K[1, 2]) / self.K[1, 1]
        straight = _undistort(np.hypot(x, y), self.distortion[0])
        rays = np.stack([x * straight, y * straight, np.ones_like(x)], -1)
        pixels = rays @ (self.K_rect @ self.R_rect[0]).T
        return np.asarray(pixels[..., :2] / pixels[..., 2:])

    def rectify_map(self, size: tuple[int, int]) -> NDArray[np.float32]:
        """(H, W, 2) float32: at [y, x] the rectified x and y of the sensor's pixel."""
        v, u = np.mgrid[: size[0], : size[1]].astype(np.float64)
        return self.rectify(u, v).astype(np.float32)

    def rays(self, size: tuple[int, int], supersampling: int) -> NDArray[np.float32]:
        """(H·n, W·n, 3) float32 directions of n × n samples a pixel, rectified frame, z = 1."""
        rows, columns = (
            (np.arange(length * supersampling) + 0.5) / supersampling - 0.5 for length in size
        )
        v, u = np.meshgrid(rows, columns, indexing="ij")
        x = (self.rectify(u, v) - self.K_rect[:2, 2]) / self.K_rect[[0, 1], [0, 1]]
        return np.concatenate([x, np.ones((*u.shape, 1))], -1).astype(np.float32)


def draw_optics(settings: SimulationSettings, index: int, rig: Rig) -> EventOptics:
    """Draw what a rig with an event camera has beyond the camera and LiDAR of any rig.

    T_lidar_camRect1 is chosen so that a reader's composition
    T_lidar_camRect0 = T_lidar_camRect1 · R_rect1 · T_10 · R_rect0⁻¹ is the inverse of the rig's
    true extrinsic.
    """
    rng = generator(settings.seed, Stream.STEREO, index)
    rectifying = [_small_turn(rng, 0.7) for _ in range(4)]
    # Camera x is right: the next camera's frame has the last one's origin to its left.
    steps = (FRAME_BASELINE_M, STEREO_BASELINE_M, FRAME_BASELINE_M)
    T_10, T_21, T_32 = (_beside(rng, baseline) for baseline in steps)
    T_camRect1_camRect0 = rectifying[1] @ T_10 @ inverse(rectifying[0])
    K = rig.K.copy()
    K[[0, 1], [0, 1]] *= RAW_FOCAL
    K[:2, 2] += rng.uniform(-1, 1, 2)
    distortion = settings.events.distortion if settings.events else 0.0
    return EventOptics(
        K=K,
        K_rect=rig.K,
        distortion=(distortion, 0.0, 0.0, 0.0),
        R_rect=tuple(matrix[:3, :3] for matrix in rectifying),
        T_10=T_10,
        T_21=T_21,
        T_32=T_32,
        T_lidar_camRect1=inverse(rig.T_cam_lidar) @ inverse(T_camRect1_camRect0),
    )


def _small_turn(rng: np.random.Generator, largest_deg: float) -> Matrix:
    return pose_matrix((0.0, 0.0, 0.0), np.deg2rad(largest_deg) * rng.uniform(-1, 1, 3))


def _beside(rng: np.random.Generator, baseline_m: float) -> Matrix:
    shift = np.array([-baseline_m, 0.0, 0.0]) + rng.uniform(-0.005, 0.005, 3)
    return pose_matrix(shift, np.deg2rad(1.0) * rng.uniform(-1, 1, 3))


def _undistort(radius: NDArray[np.float64], k1: float) -> NDArray[np.float64]:
    """Factor from the distorted to the straight ray: solves r_distorted = r · (1 + k1·r²) for r."""
    straight = radius.copy()
    for _ in range(20):
        straight -= (straight * (1 + k1 * straight**2) - radius) / (1 + 3 * k1 * straight**2)
    if not np.allclose(straight * (1 + k1 * straight**2), radius, rtol=0, atol=1e-9) or (
        1 + 3 * k1 * straight.max() ** 2 <= 0
    ):
        raise ConfigurationError(
            f"simulation.events.distortion is {k1}; at the sensor's corners, {radius.max():.2f} "
            "focal lengths off the axis, it cannot be undone; bring it nearer to 0"
        )
    factor: NDArray[np.float64] = np.ones_like(radius)
    np.divide(straight, radius, out=factor, where=radius > 0)
    return factor
