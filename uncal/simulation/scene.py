"""Triangles in an Embree scene, and what light and LiDAR beams find where they hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh  # type: ignore[import-untyped]
from embreex.rtcore_scene import EmbreeScene  # type: ignore[import-untyped]
from numpy.typing import NDArray

from uncal.simulation.meshes import Array, Mesh
from uncal.simulation.sky import Sky
from uncal.simulation.textures import SIZE, TextureLibrary

SHADOW_OFFSET_M = 0.01
"""Shadow rays start this far above the surface, so that it does not shade itself."""


@dataclass(frozen=True)
class Hits:
    """Where N rays met the scene.

    Attributes:
        triangle: (N,) int32 triangle number; -1 where the ray met nothing.
        t: (N,) float32 distance in units of the direction's length.
        u: (N,) float32 barycentric weight of the triangle's second corner.
        v: (N,) float32 barycentric weight of its third corner.
    """

    triangle: NDArray[np.int32]
    t: Array
    u: Array
    v: Array

    def __getitem__(self, block: tuple[slice, slice]) -> Hits:
        """The hits in a block of a grid of hits, as a list."""
        parts = (values[block].ravel() for values in (self.t, self.u, self.v))
        return Hits(self.triangle[block].ravel(), *parts)

    def take(self, index: NDArray[np.int64]) -> Hits:
        """Some of the hits."""
        return Hits(
            self.triangle.take(index), self.t.take(index), self.u.take(index), self.v.take(index)
        )


class Scene:
    """A street that can be asked what a ray meets."""

    def __init__(
        self, mesh: Mesh, sky: Sky, textures: TextureLibrary, reach: tuple[float, float]
    ) -> None:
        """Build the Embree scene.

        Args:
            mesh: all triangles, wound counter-clockwise as seen from outside.
            sky: the light, for what depends on the surfaces' orientation alone.
            textures: the library that the mesh's texture numbers refer to.
            reach: smallest and largest world x of the triangles to keep, metres.
        """
        triangles = np.concatenate(mesh.triangles)
        x = triangles[:, :, 0]
        keep = (x.max(1) > reach[0]) & (x.min(1) < reach[1])
        triangles = triangles[keep]
        edges = triangles[:, 1:] - triangles[:, :1]
        normals = np.cross(edges[:, 0], edges[:, 1])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-12)
        uv = np.concatenate(mesh.uv)[keep]
        colours = np.concatenate(mesh.colours)[keep]
        density = np.concatenate(mesh.texel_density)[keep] * SIZE
        self.sky = sky
        self.textures = textures
        self.normals: Array = normals.astype(np.float32)
        self._texture = np.concatenate(mesh.texture)[keep]
        self._reflectance = np.concatenate(mesh.reflectance)[keep]
        lit = (normals @ sky.to_sun).clip(0)
        # Even an overcast sky is brighter towards the sun: faces of one wall's corner differ.
        ambient = 0.55 + 0.3 * normals[:, 2] + 0.15 * normals @ sky.to_sun
        # One row per triangle: a hit then costs one gather of a cache line.
        self._look = np.column_stack([colours[:, 0], colours[:, 1] - colours[:, 0], ambient, lit])
        self._map = np.column_stack([uv[:, 0], uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0], density])
        self._look = np.ascontiguousarray(self._look, np.float32)
        self._map = np.ascontiguousarray(self._map, np.float32)
        self._embree = EmbreeScene()
        # Embree reads the buffer for as long as the scene lives.
        self._buffer = np.ascontiguousarray(triangles, np.float32)
        self._mesh = TriangleMesh(self._embree, self._buffer)

    def __len__(self) -> int:
        """Number of triangles."""
        return len(self._texture)

    def cast(self, origins: Array, directions: Array) -> Hits:
        """First hit of each ray.

        Args:
            origins: (N, 3) float32 world coordinates, metres.
            directions: (N, 3) float32, of any length.
        """
        found = self._embree.run(origins, directions, output=1)
        return Hits(found["primID"], found["tfar"], found["u"], found["v"])

    def in_sun(self, points: Array, triangle: NDArray[np.int32]) -> Array:
        """1 where nothing stands between a point on a triangle and the sun, else 0, (N,)."""
        lit = np.zeros(len(points), np.float32)
        facing = np.flatnonzero(self._look.take(triangle, axis=0)[:, 7] > 0)
        lifted = points.take(facing, axis=0)
        lifted += SHADOW_OFFSET_M * self.normals.take(triangle[facing], axis=0)
        to_sun = np.empty_like(lifted)
        to_sun[:] = self.sky.to_sun
        lit[facing] = self._embree.run(lifted, to_sun, query="OCCLUDED") < 0
        return lit

    def slant(self, hits: Hits, directions: Array) -> Array:
        """|n · d| of hits by rays of (N, 3) direction: the cosine of incidence times |d|."""
        normal = self.normals.take(hits.triangle, axis=0)
        product = directions[:, 0] * normal[:, 0]
        product += directions[:, 1] * normal[:, 1]
        product += directions[:, 2] * normal[:, 2]
        return np.asarray(np.abs(product))

    def texture_at(self, hits: Hits, footprint: Array) -> tuple[Array, Array]:
        """Blend and grain where rays hit (all must have hit).

        Args:
            hits: the hits.
            footprint: (N,) width of what one ray stands for, metres.
        """
        row = self._map.take(hits.triangle, axis=0)
        u = row[:, 0] + hits.u * row[:, 2] + hits.v * row[:, 4]
        v = row[:, 1] + hits.u * row[:, 3] + hits.v * row[:, 5]
        texture = self._texture.take(hits.triangle)
        return self.textures.sample(texture, u, v, footprint * row[:, 6])

    def radiance(self, hits: Hits, footprint: Array, in_sun: Array) -> Array:
        """Light leaving the surfaces (Lambert), (3, N) linear RGB.

        L = albedo · (ambient sky light + visible sun · max(0, n·s)), all of unit scale.

        Args:
            hits: N hits.
            footprint: (N,) width of what one ray stands for, metres.
            in_sun: (N,) share of the sun that is visible, 0..1.
        """
        blend, grain = self.texture_at(hits, footprint)
        row = self._look.take(hits.triangle, axis=0)
        ambient, direct = grain * row[:, 6], grain * row[:, 7] * in_sun
        colour = np.empty((3, len(grain)), np.float32)
        # Channel by channel: numpy is slow where the innermost axis has three elements.
        for channel, (sky, sun) in enumerate(zip(self.sky.ambient, self.sky.sun, strict=True)):
            albedo = row[:, channel] + row[:, 3 + channel] * blend
            np.multiply(albedo, ambient * sky + direct * sun, out=colour[channel])
        return colour

    def reflectance(self, hits: Hits, footprint: Array) -> Array:
        """Reflectance at the LiDAR's wavelength, (N,) in 0..1."""
        blend, grain = self.texture_at(hits, footprint)
        pair = self._reflectance.take(hits.triangle, axis=0)
        mixed = pair[:, 0] + (pair[:, 1] - pair[:, 0]) * blend
        return np.asarray((mixed * (0.5 + 0.5 * grain)).clip(0, 1), np.float32)
