"""The pinhole camera: rays, light, sensor."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from uncal.simulation.rigid import Matrix
from uncal.simulation.scene.meshes import Array
from uncal.simulation.scene.palette import LUMINANCE
from uncal.simulation.scene.triangle_scene import NOTHING, Numbers, Scene
from uncal.simulation.sensors.view import Meeting, View
from uncal.simulation.sensors.visibility import visible
from uncal.simulation.settings import CameraSettings

MEAN_LUMINANCE = 0.3
"""What the automatic exposure brings the picture's mean to, linear, full scale = 1."""

GAMMA = 2.2
_GAMMA_CURVE = (255 * np.linspace(0, 1, 1 << 14) ** (1 / GAMMA) + 0.5).astype(np.uint8)
"""8-bit value of linear light; a table, because a power per channel is slow."""


class Camera:
    """A camera of fixed intrinsics that photographs a scene from any pose.

    A point X in the camera frame falls on pixel (u, v) = (fx X/Z + cx, fy Y/Z + cy); integer
    coordinates are pixel centres. Anti-aliasing averages n × n rays spread evenly over each pixel.
    """

    def __init__(self, settings: CameraSettings, K: NDArray[np.float64]) -> None:
        """Prepare the rays."""
        self.settings = settings
        n = settings.supersampling
        step = (np.arange(n) + 0.5) / n - 0.5
        rows, columns = np.arange(settings.height), np.arange(settings.width)
        u = (columns[:, None] + step).ravel()
        v = (rows[:, None] + step).ravel()
        x, y = np.meshgrid((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1])
        # z = 1, so that t along a ray is depth.
        self._rays = np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)
        self._sample_width = np.float32(1 / (K[0, 0] * n))
        centre = n // 2
        radius2 = (x**2 + y**2)[centre::n, centre::n].ravel()
        fall = 1 - settings.vignetting * radius2 / radius2.max()
        self._vignette = fall.astype(np.float32)

    def photograph(
        self, scene: Scene, T_world_cam: Matrix, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        """An (H, W, 3) uint8 RGB picture from a (4, 4) pose; ``rng`` draws light and noise."""
        return self._develop(self._expose(scene, T_world_cam), rng)

    def _expose(self, scene: Scene, T_world_cam: Matrix) -> Array:
        """Mean radiance of each pixel, (3, H·W) linear RGB."""
        n = self.settings.supersampling
        directions = self._rays @ T_world_cam[:3, :3].T.astype(np.float32)
        triangle = visible(scene, T_world_cam[:3, 3].astype(np.float32), directions)
        exposure = _Exposure(scene, T_world_cam[:3, 3], self._sample_width, self.settings)
        for row in range(n):
            for column in range(n):
                each = (slice(row, None, n), slice(column, None, n))
                rays = directions[each].transpose(2, 0, 1).reshape(3, -1)
                exposure.add(triangle[each].ravel(), rays)
        exposure.light /= n * n
        return exposure.light

    def _develop(self, light: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Exposure, vignetting, noise, gamma, 8 bits; (3, H·W) linear → (H, W, 3)."""
        limits = self.settings
        mean = float((LUMINANCE @ light).clip(0, 1.5).mean())
        gain = limits.exposure * MEAN_LUMINANCE / max(mean, 1e-6)
        if limits.exposure_stops > 0:
            gain *= 2.0 ** (limits.exposure_stops * rng.uniform(-1, 1))
        light = light * (self._vignette * np.float32(gain))
        if limits.tint > 0:
            light *= (1 + limits.tint * rng.uniform(-1, 1, (3, 1))).astype(np.float32)
        if limits.blur_px > 0:
            light = self._blurred(light, limits.blur_px * rng.uniform(0, 1))
        noise = rng.standard_normal(light.shape, dtype=np.float32)
        # Photon noise grows with the root of the signal; the floor is the read-out's.
        light += limits.noise * np.sqrt(0.2 + light) * noise
        coded = _GAMMA_CURVE.take((light.clip(0, 1) * (len(_GAMMA_CURVE) - 1)).astype(np.int32))
        shape = (limits.height, limits.width, 3)
        return np.ascontiguousarray(coded.T).reshape(shape)

    def _blurred(self, light: Array, sigma: float) -> Array:
        """A lens out of focus: a Gaussian of that standard deviation in pixels."""
        if sigma < 0.1:
            return light
        image = np.ascontiguousarray(light.T).reshape(self.settings.height, self.settings.width, 3)
        blurred = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        return np.ascontiguousarray(blurred.reshape(-1, 3).T)


class _Exposure:
    """Light gathered by the pixels, one sample per pixel at a time.

    Whether the sun shines on a point is asked again only where a pixel's sample lies on another
    triangle than the one before: neighbours on one triangle nearly always share the answer.
    """

    def __init__(
        self,
        scene: Scene,
        position: NDArray[np.float64],
        sample_width: np.float32,
        settings: CameraSettings,
    ) -> None:
        """Open the shutter at a (3,) world position."""
        n_pixels = settings.height * settings.width
        self.light: Array = np.zeros((3, n_pixels), np.float32)
        self._view = View(scene, position)
        self._position = position.astype(np.float32)
        self._sample_width = sample_width
        self._settings = settings
        self._shadows = settings.shadows and bool(scene.sky.sun.any())
        self._triangle: Numbers = np.full(n_pixels, NOTHING, np.int32)
        self._in_sun: Array = np.ones(n_pixels, np.float32)

    def add(self, triangle: Numbers, directions: Array) -> None:
        """Add the light of one sample per pixel.

        Args:
            triangle: (N,) what the samples lie on.
            directions: (3, N) towards them, world coordinates.
        """
        scene = self._view.scene
        meeting = self._view.meet(triangle, directions)
        self._update_sun(meeting, directions)
        footprint = meeting.t * self._sample_width
        footprint /= np.sqrt(np.maximum(meeting.slant, np.float32(0.02)))
        seen = self._view.radiance(meeting, footprint, self._in_sun)
        clear = np.exp(meeting.t * np.float32(-1 / self._settings.haze_m))
        empty = np.flatnonzero(triangle == NOTHING)
        sky = scene.sky.radiance(scene.textures, directions.take(empty, axis=1))
        for channel, haze in enumerate(scene.sky.horizon):
            # Without a surface t is 0 and all is clear, so nothing is added but the sky.
            self.light[channel] += haze + (seen[channel] - haze) * clear
            self.light[channel, empty] += sky[channel]

    def _update_sun(self, meeting: Meeting, directions: Array) -> None:
        """Find out whether the sun shines where samples lie on another triangle than before."""
        if self._shadows:
            new = np.flatnonzero(
                (meeting.triangle != NOTHING) & (meeting.triangle != self._triangle)
            )
            points = (directions.take(new, axis=1) * meeting.t.take(new)).T + self._position
            self._in_sun[new] = self._view.scene.in_sun(points, meeting.triangle.take(new))
            self._triangle = meeting.triangle
