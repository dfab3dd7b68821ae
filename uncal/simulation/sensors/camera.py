"""The pinhole camera: rays, light, sensor."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from uncal.simulation.rigid import Matrix
from uncal.simulation.scene.meshes import Array
from uncal.simulation.scene.palette import LUMINANCE
from uncal.simulation.scene.triangle_scene import NOTHING, Numbers, Scene
from uncal.simulation.sensors.view import View, samples
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
        """Mean radiance of each pixel, (3, H·W) linear RGB.

        Whether the sun shines on a point is asked again only where a pixel's sample lies on another
        triangle than the one before: neighbours on one triangle nearly always share the answer.
        """
        limits, position = self.settings, T_world_cam[:3, 3]
        n_pixels = limits.height * limits.width
        light: Array = np.zeros((3, n_pixels), np.float32)
        in_sun: Array = np.ones(n_pixels, np.float32)
        last: Numbers = np.full(n_pixels, NOTHING, np.int32)
        view = View(scene, position)
        for triangle, rays in samples(scene, T_world_cam, self._rays, limits.supersampling):
            meeting = view.meet(triangle, rays)
            if limits.shadows and scene.sky.sun.any():
                new = np.flatnonzero((triangle != NOTHING) & (triangle != last))
                points = (rays.take(new, axis=1) * meeting.t.take(new)).T
                points += position.astype(np.float32)
                in_sun[new] = scene.in_sun(points, triangle.take(new))
                last = triangle
            seen = view.radiance(meeting, meeting.footprint(self._sample_width), in_sun)
            clear = np.exp(meeting.t * np.float32(-1 / limits.haze_m))
            empty = np.flatnonzero(triangle == NOTHING)
            sky = scene.sky.radiance(scene.textures, rays.take(empty, axis=1))
            for channel, haze in enumerate(scene.sky.horizon):
                # Without a surface t is 0 and all is clear, so nothing is added but the sky.
                light[channel] += haze + (seen[channel] - haze) * clear
                light[channel, empty] += sky[channel]
        light /= limits.supersampling**2
        return light

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
