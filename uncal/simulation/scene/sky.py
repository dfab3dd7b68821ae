"""The light of one drive: sun, sky and clouds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uncal.simulation.scene.meshes import Array
from uncal.simulation.scene.textures import VARIANTS, Kind, TextureLibrary


@dataclass(frozen=True)
class Sky:
    """Light of one drive; linear RGB.

    Attributes:
        to_sun: (3,) unit vector towards the sun.
        sun: (3,) irradiance of a surface facing the sun; near zero on an overcast day.
        ambient: (3,) irradiance from the sky.
        horizon: (3,) radiance of the sky at the horizon, also the colour of haze.
        zenith: (3,) radiance overhead.
        clouds: texture number of the clouds.
    """

    to_sun: Array
    sun: Array
    ambient: Array
    horizon: Array
    zenith: Array
    clouds: int

    def radiance(self, textures: TextureLibrary, directions: Array) -> Array:
        """Radiance of the sky in (3, N) directions: a gradient with clouds, (3, N) linear RGB."""
        x, y, z = directions / np.sqrt((directions**2).sum(0))
        up = z.clip(0.02, 1)
        texture = np.full(len(up), self.clouds, np.int32)
        scale = np.float32(0.08) / up
        blend, grain = textures.sample(texture, x * scale, y * scale, np.ones_like(up))
        rise = np.sqrt(up)
        cloud = 1 + ((grain - 0.9) + 0.5 * blend).clip(0, 0.5) * np.minimum(4 * up, 1)
        glow = np.maximum(x * self.to_sun[0] + y * self.to_sun[1] + z * self.to_sun[2], 0) ** 32
        colour = np.empty((3, len(up)), np.float32)
        for channel in range(3):
            low, high = self.horizon[channel], self.zenith[channel]
            colour[channel] = (low + (high - low) * rise) * cloud + glow * self.sun[channel]
        return colour


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
