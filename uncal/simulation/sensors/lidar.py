"""The spinning LiDAR: one sweep of a beam table through a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.rigid import Matrix
from uncal.simulation.scene.triangle_scene import NOTHING, Scene
from uncal.simulation.sensors.view import View
from uncal.simulation.settings import LidarSettings

BEAM_DIVERGENCE_RAD = 0.003
"""Footprint of a beam per metre of range; a typical figure for a spinning LiDAR."""

FULL_POWER_RANGE_M = 30.0
"""Range at which a perpendicular surface of reflectance DETECTABLE is lost half of the time."""

DETECTABLE = 0.012

REVOLUTION_S = 0.1
"""Time of one revolution."""


class Lidar:
    """A spinning LiDAR. It looks straight ahead at the moment that a sweep is taken for."""

    def __init__(
        self,
        settings: LidarSettings,
        elevations: NDArray[np.float64],  # (beams,) radians
        range_bias: NDArray[np.float64] | None = None,  # (beams,) metres measured too much
        gain: NDArray[np.float64] | None = None,  # (beams,) factor on the reflectance; None: 1
    ) -> None:
        self.settings = settings
        steps = max(round(settings.azimuth_fov_deg / settings.azimuth_step_deg), 1)
        azimuth = np.deg2rad((np.arange(steps) - (steps - 1) / 2) * settings.azimuth_step_deg)
        elevation, azimuth = np.meshgrid(elevations, azimuth, indexing="ij")
        if settings.stagger:
            # Lasers do not fire in columns; the golden ratio spreads their offsets evenly.
            share = (np.arange(len(elevations)) * 0.618034) % 1 - 0.5
            azimuth = azimuth + np.deg2rad(settings.azimuth_step_deg) * share[:, None]
        # Clockwise seen from above, as a Velodyne: azimuth falls as time goes on.
        self._delay = (-azimuth / (2 * np.pi) * REVOLUTION_S).ravel().astype(np.float32)
        bias = np.zeros(len(elevations)) if range_bias is None else range_bias
        self._bias = np.repeat(bias, steps).astype(np.float32)
        gain = np.ones(len(elevations)) if gain is None else gain
        self._gain = np.repeat(gain, steps).astype(np.float32)
        self._ring = np.repeat(np.arange(len(elevations), dtype=np.uint16), steps)
        flat = np.cos(elevation)
        rays = [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]
        self._rays = np.stack(rays, -1).reshape(-1, 3).astype(np.float32)

    def sweep(
        self,
        scene: Scene,
        T_world_lidar: Matrix,
        rng: np.random.Generator,
        velocity: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float32]:
        """Measure once around.

        The returned power is ρ cosθ / r² (Lambertian target, beam smaller than the target); a
        return is lost with the probability 1 / (1 + (power / threshold)²) and at random. The
        reported reflectance is compensated for range and, as in practice, hardly for incidence.
        With the (3,) velocity of the LiDAR in world coordinates, m/s, every return is reported from
        where the LiDAR then is, without compensation, as in KITTI raw; without, the whole sweep is
        taken from its (4, 4) pose.

        Returns:
            (N, 4) float32 x, y, z in metres in the LiDAR frame, and reflectance in 0..1.
        """
        return self.sweep_with_rings(scene, T_world_lidar, rng, velocity)[0]

    def sweep_with_rings(
        self,
        scene: Scene,
        T_world_lidar: Matrix,
        rng: np.random.Generator,
        velocity: NDArray[np.float64] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
        """What :meth:`sweep` gives, and the beam of each point, (N,), counted from the lowest."""
        limits = self.settings
        directions = self._rays @ T_world_lidar[:3, :3].T.astype(np.float32)
        origins = np.empty_like(directions)
        origins[:] = T_world_lidar[:3, 3]
        shift = None
        if velocity is not None and limits.motion_distortion:
            shift = self._delay[:, None] * velocity.astype(np.float32)
            origins += shift
            shift = np.ascontiguousarray(shift.T)
        triangle = scene.cast(origins, directions)
        # Drawn for every ray, so that one ray's fate does not shift the others' numbers.
        noise = rng.standard_normal((2, len(directions)), dtype=np.float32)
        fate = rng.random((2, len(directions)), dtype=np.float32)

        view = View(scene, T_world_lidar[:3, 3])
        meeting = view.meet(triangle, np.ascontiguousarray(directions.T), shift)
        cosine, t = meeting.slant, meeting.t
        reflectance = view.reflectance(meeting, t * np.float32(BEAM_DIVERGENCE_RAD))
        power = reflectance * cosine / np.maximum(t / FULL_POWER_RANGE_M, 0.2) ** 2
        lost = (fate[0] < limits.dropout) | (fate[1] * (1 + (power / DETECTABLE) ** 2) < 1)
        measured = t + limits.range_noise_m * noise[0] + self._bias
        keep = ~lost & (measured >= limits.range_min_m) & (measured <= limits.range_max_m)
        keep &= triangle != NOTHING

        shine = reflectance * (0.4 + 0.6 * cosine) * (1 + limits.reflectance_noise * noise[1])
        shine *= self._gain
        points = np.column_stack([self._rays * measured[:, None], shine.clip(0, 1)])
        return np.ascontiguousarray(points[keep], np.float32), self._ring[keep]
