"""The pinhole camera: rays, light, sensor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.meshes import Array
from uncal.simulation.palette import LUMINANCE
from uncal.simulation.rigid import Matrix, inverse
from uncal.simulation.scene import Hits, Scene, Sky
from uncal.simulation.settings import CameraSettings
from uncal.simulation.textures import Kind, VARIANTS

MEAN_LUMINANCE = 0.24
"""What the automatic exposure brings the picture's mean to, linear, full scale = 1."""

GAMMA = 2.2

BATCH_RAYS = 8192
"""Rays traced and shaded at a time: their arrays stay in the processor's cache."""


class Camera:
    """A camera of fixed intrinsics that photographs a scene from any pose.

    A point X in the camera frame falls on pixel (u, v) = (fx X/Z + cx, fy Y/Z + cy); integer
    coordinates are pixel centres. Anti-aliasing averages n × n rays spread evenly over each pixel.

    Args:
        settings: size, supersampling and sensor.
        K: (3, 3) camera matrix, pixels.
    """

    def __init__(self, settings: CameraSettings, K: NDArray[np.float64]) -> None:
        self.settings = settings
        n = settings.supersampling
        step = (np.arange(n) + 0.5) / n - 0.5
        rows, columns = np.arange(settings.height), np.arange(settings.width)
        v, u, dv, du = np.meshgrid(rows, columns, step, step, indexing="ij")
        x, y = (u + du - K[0, 2]) / K[0, 0], (v + dv - K[1, 2]) / K[1, 1]
        # z = 1, so that a hit's t is its depth.
        self._rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3).astype(np.float32)
        self._sample_width = np.float32(1 / (K[0, 0] * n))
        radius2 = (x**2 + y**2).reshape(-1, n * n).mean(1)
        fall = 1 - settings.vignetting * radius2 / radius2.max()
        self._vignette = fall.astype(np.float32)[:, None]

    def photograph(
        self, scene: Scene, T_world_cam: Matrix, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        """Take a picture.

        Args:
            scene: the street.
            T_world_cam: (4, 4) pose of the camera.
            rng: draws the sensor noise.

        Returns:
            (H, W, 3) uint8 RGB.
        """
        return self._develop(self._expose(scene, T_world_cam), rng)

    def _expose(self, scene: Scene, T_world_cam: Matrix) -> Array:
        """Mean radiance of each pixel, (H·W, 3) linear RGB."""
        samples = self.settings.supersampling**2
        rotation = T_world_cam[:3, :3].T.astype(np.float32)
        position = T_world_cam[:3, 3].astype(np.float32)
        light = np.empty((len(self._rays) // samples, 3), np.float32)
        step = max(BATCH_RAYS // samples, 1)
        for first in range(0, len(light), step):
            rays = self._rays[first * samples : (first + step) * samples]
            colour = self._trace(scene, position, rays @ rotation)
            light[first : first + step] = colour.reshape(-1, samples, 3).mean(1)
        return light

    def _trace(self, scene: Scene, position: Array, directions: Array) -> Array:
        """Radiance arriving at ``position`` against each of (N, 3) directions, (N, 3)."""
        hits = scene.cast(np.broadcast_to(position, directions.shape).copy(), directions)
        met = hits.triangle >= 0
        where = np.flatnonzero(met)
        found = Hits(hits.triangle[where], hits.t[where], hits.u[where], hits.v[where])
        rays = directions[where]
        slant = np.abs(np.einsum("ij,ij->i", rays, scene.normals[found.triangle]))
        footprint = found.t * self._sample_width / np.sqrt(np.maximum(slant, 0.02))
        in_sun = np.ones(len(where), np.float32)
        if self.settings.shadows and scene.sky.sun.any():
            in_sun = scene.in_sun(position + rays * found.t[:, None], found.triangle)
        colour = np.empty_like(directions)
        clear = np.exp(found.t * np.float32(-1 / self.settings.haze_m))[:, None]
        seen = scene.radiance(found, footprint, in_sun)
        colour[where] = scene.sky.horizon + (seen - scene.sky.horizon) * clear
        empty = np.flatnonzero(~met)
        colour[empty] = sky_radiance(scene, directions[empty])
        return colour

    def _develop(self, light: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Exposure, vignetting, noise, gamma, 8 bits."""
        mean = float((light @ LUMINANCE).clip(0, 1.5).mean())
        light = light * (self.settings.exposure * MEAN_LUMINANCE / max(mean, 1e-6)) * self._vignette
        noise = rng.standard_normal(light.shape, dtype=np.float32)
        # Photon noise grows with the root of the signal; the floor is the read-out's.
        light += self.settings.noise * np.sqrt(0.2 + light) * noise
        coded = light.clip(0, 1) ** np.float32(1 / GAMMA)
        shape = (self.settings.height, self.settings.width, 3)
        return (coded * 255 + 0.5).astype(np.uint8).reshape(shape)


def sky_radiance(scene: Scene, directions: Array) -> Array:
    """Radiance of the sky in (N, 3) directions: a gradient with clouds, (N, 3) linear RGB."""
    sky: Sky = scene.sky
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True).clip(1e-9)
    up = unit[:, 2].clip(0.02, 1)
    texture = np.full(len(unit), sky.clouds, np.int32)
    scale = np.float32(0.08) / up
    small = np.ones(len(unit), np.float32)
    blend, grain = scene.textures.sample(texture, unit[:, 0] * scale, unit[:, 1] * scale, small)
    rise = np.sqrt(up)[:, None]
    colour = sky.horizon + (sky.zenith - sky.horizon) * rise
    cloud = ((grain - 0.9) * 2 + blend).clip(0, 1)[:, None] * np.minimum(4 * up, 1)[:, None]
    glow = np.maximum(unit @ sky.to_sun, 0) ** 32
    return np.asarray(colour * (1 + 0.5 * cloud) + glow[:, None] * sky.sun, np.float32)


def draw_sky(rng: np.random.Generator) -> Sky:
    """Draw the weather: sunny, hazy or overcast, sun anywhere between 15° and 65°."""
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(15, 65))
    flat = np.cos(elevation)
    to_sun = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    overcast = rng.random() < 0.3
    strength = 0.0 if overcast else rng.uniform(0.6, 2.0)
    warmth = rng.uniform(0, 0.25)
    blue = 0.02 if overcast else rng.uniform(0.1, 0.35)
    ambient = rng.uniform(0.5, 0.8) * np.array([1 - blue, 1 - 0.4 * blue, 1.0])
    level = rng.uniform(0.7, 1.3)
    return Sky(
        to_sun=to_sun.astype(np.float32),
        sun=(strength * np.array([1.0, 1 - 0.5 * warmth, 1 - warmth])).astype(np.float32),
        ambient=ambient.astype(np.float32),
        horizon=(level * np.array([1 - 0.5 * blue, 1 - 0.2 * blue, 1.0])).astype(np.float32),
        zenith=(level * 0.7 * np.array([1 - 2 * blue, 1 - blue, 1.0])).astype(np.float32),
        clouds=int(Kind.ROUGH * VARIANTS + rng.integers(VARIANTS)),
    )
