"""Triangles in an Embree scene, which one a ray meets, and the light of sun, sky and clouds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh  # type: ignore[import-untyped]
from embreex.rtcore_scene import EmbreeScene  # type: ignore[import-untyped]
from numpy.typing import NDArray

from uncal.simulation.scene.meshes import Array, Mesh, Points
from uncal.simulation.scene.textures import SIZE, VARIANTS, Kind, TextureLibrary

SHADOW_OFFSET_M = 0.01
"""Shadow rays start this far above the surface, so that it does not shade itself."""

NOTHING = -1
"""Triangle number of a ray that meets nothing; the tables' last row, which is all zero, is its."""

Numbers = NDArray[np.int32]


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


class Scene:
    """A street that can be asked what a ray meets.

    Attributes:
        sky: the light.
        textures: the library that ``texture`` refers to.
        corners: (T, 3) float64 first corner of each triangle, world coordinates.
        normals: (T, 3) float64 outward unit normals.
        u_slope: (T, 3) float64 change of the texture coordinate u per metre in each direction.
        v_slope: (T, 3) float64 the same for v.
        uv: (T, 2) float64 texture coordinates of the first corners.
        texel_density: (T,) float64 texels per metre.
        texture: (T + 1,) int32 texture numbers.
        look: (T + 1, 8) float32 albedo where the texture's blend is 0, its change to where it is 1
            (3 + 3), share of the sky's light, share of the sun's.
        reflectance: (T + 1, 2) float32 at the LiDAR's wavelength, likewise.
    """

    def __init__(
        self, mesh: Mesh, sky: Sky, textures: TextureLibrary, reach: tuple[float, float]
    ) -> None:
        """Build the scene of a mesh, of triangles with a world x within ``reach``, metres."""
        every = np.concatenate(mesh.triangles)
        x = every[:, :, 0]
        keep = (x.max(1) > reach[0]) & (x.min(1) < reach[1])
        # Embree reads this buffer for as long as the scene lives.
        self._buffer = np.ascontiguousarray(every[keep], np.float32)
        triangles = self._buffer.astype(np.float64)
        uv = np.concatenate(mesh.uv)[keep].astype(np.float64)
        edges: Points = triangles[:, 1:] - triangles[:, :1]
        normals: Points = np.cross(edges[:, 0], edges[:, 1])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-12)
        slopes = _slopes(edges, uv[:, 1:] - uv[:, :1])
        colours = np.concatenate(mesh.colours)[keep]
        self.sky = sky
        self.textures = textures
        self.corners: Points = triangles[:, 0]
        self.normals: Points = normals
        self.u_slope, self.v_slope = slopes[:, 0], slopes[:, 1]
        self.uv: Points = uv[:, 0]
        self.texel_density = np.concatenate(mesh.texel_density)[keep].astype(np.float64) * SIZE
        self.texture = np.append(np.concatenate(mesh.texture)[keep], 0).astype(np.int32)
        # Even an overcast sky is brighter towards the sun: faces of one wall's corner differ.
        ambient = 0.55 + 0.3 * normals[:, 2] + 0.15 * normals @ sky.to_sun
        lit = (normals @ sky.to_sun).clip(0)
        change = colours[:, 1] - colours[:, 0]
        self.look: Array = _table(colours[:, 0], change, ambient[:, None], lit[:, None])
        self.reflectance: Array = _table(np.concatenate(mesh.reflectance)[keep])
        self._embree = EmbreeScene()
        self._mesh = TriangleMesh(self._embree, self._buffer)

    def __len__(self) -> int:
        """Number of triangles."""
        return len(self.corners)

    def cast(self, origins: Array, directions: Array) -> Numbers:
        """(N,) first triangle, or :data:`NOTHING`, of rays from (N, 3) along (N, 3) float32."""
        return np.asarray(self._embree.run(origins, directions, query="INTERSECT"), np.int32)

    def in_sun(self, points: Array, triangle: Numbers) -> Array:
        """(N,) 1 where nothing stands between (N, 3) points on triangles and the sun, else 0."""
        lit = np.zeros(len(points), np.float32)
        facing = np.flatnonzero(self.look[:, 7].take(triangle) > 0)
        lifted = points.take(facing, axis=0)
        lifted += SHADOW_OFFSET_M * self.normals.take(triangle[facing], axis=0)
        to_sun = np.empty_like(lifted)
        to_sun[:] = self.sky.to_sun
        lit[facing] = self._embree.run(lifted, to_sun, query="OCCLUDED") == NOTHING
        return lit


def _slopes(edges: Points, change: Points) -> Points:
    """(T, Q, 3) gradients in the triangle's plane of Q quantities known at its corners.

    g = a·e1 + b·e2 with g·e1 and g·e2 equal to the quantity's change along the two edges.
    """
    gram = edges @ edges.transpose(0, 2, 1)
    a, b, c = gram[:, 0, 0, None], gram[:, 0, 1, None], gram[:, 1, 1, None]
    determinant = (a * c - b * b).clip(1e-12)
    first = (c * change[:, 0] - b * change[:, 1]) / determinant
    second = (a * change[:, 1] - b * change[:, 0]) / determinant
    return np.asarray(first[..., None] * edges[:, :1] + second[..., None] * edges[:, 1:])


def _table(*columns: NDArray[np.floating]) -> Array:
    """Columns side by side, one row per triangle and one of zeros for :data:`NOTHING`."""
    rows = np.concatenate(columns, axis=1, dtype=np.float32)
    return np.concatenate([rows, np.zeros((1, rows.shape[1]), np.float32)])
