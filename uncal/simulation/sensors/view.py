"""The surfaces of a scene as seen from one point: depth, texture, light and reflectance along rays.

Along a ray p + t·d from a fixed point p, the depth of a triangle's plane and a texture coordinate
on it are t = n·(q - p) / n·d and u = u_q + g·(p - q) + t·g·d (q: a corner, g: the slope of u).
All that does not depend on d is worked out once per view and triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.scene.meshes import Array
from uncal.simulation.scene.triangle_scene import Numbers, Scene


@dataclass(frozen=True)
class Meeting:
    """Where N rays from one point meet the triangles that they are known to meet.

    Attributes:
        triangle: (N,) triangle numbers, or NOTHING.
        t: (N,) distances in units of the directions' length; 0 for NOTHING.
        slant: (N,) magnitude of n·d: cosine of incidence times the direction's length.
        u: (N,) texture coordinate.
        v: (N,) texture coordinate.
        texel_density: (N,) texels per metre.
    """

    triangle: Numbers
    t: Array
    slant: Array
    u: Array
    v: Array
    texel_density: Array

    def footprint(self, sample_width: np.float32) -> Array:
        """(N,) width of what one ray stands for, metres, of samples so wide at distance 1."""
        width = self.t * sample_width
        width /= np.sqrt(np.maximum(self.slant, np.float32(0.02)))
        return np.asarray(width, np.float32)


class View:
    """A scene seen from one point."""

    def __init__(self, scene: Scene, position: NDArray[np.float64]) -> None:
        """Work out what the rays from a (3,) position in the world share."""
        self.scene = scene
        away = position - scene.corners
        depth, u, v = (
            np.einsum("ij,ij->i", slope, away)
            for slope in (scene.normals, scene.u_slope, scene.v_slope)
        )
        self._table = np.zeros((len(scene) + 1, 13), np.float32)
        rows = self._table[:-1]
        rows[:, 0:3], rows[:, 3] = scene.normals, -depth
        rows[:, 4:7], rows[:, 7] = scene.u_slope, scene.uv[:, 0] + u
        rows[:, 8:11], rows[:, 11] = scene.v_slope, scene.uv[:, 1] + v
        rows[:, 12] = scene.texel_density

    def meet(self, triangle: Numbers, directions: Array, shift: Array | None = None) -> Meeting:
        """Where rays meet the triangles that :meth:`Scene.cast` has named.

        Args:
            triangle: (N,) triangle numbers.
            directions: (3, N) float32; component by component, which is what is fast here.
            shift: (3, N) from the view's point to where each ray starts; None: nowhere.
        """
        x, y, z = directions
        row = self._table.take(triangle, axis=0, mode="wrap")
        towards = x * row[:, 0] + y * row[:, 1] + z * row[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            if shift is None:
                t = row[:, 3] / towards
            else:
                ahead = shift[0] * row[:, 0] + shift[1] * row[:, 1] + shift[2] * row[:, 2]
                t = (row[:, 3] - ahead) / towards
        t[triangle < 0] = 0
        u = row[:, 7] + t * (x * row[:, 4] + y * row[:, 5] + z * row[:, 6])
        v = row[:, 11] + t * (x * row[:, 8] + y * row[:, 9] + z * row[:, 10])
        if shift is not None:
            u += shift[0] * row[:, 4] + shift[1] * row[:, 5] + shift[2] * row[:, 6]
            v += shift[0] * row[:, 8] + shift[1] * row[:, 9] + shift[2] * row[:, 10]
        return Meeting(triangle, t, np.abs(towards), u, v, row[:, 12])

    def texture_at(self, meeting: Meeting, footprint: Array) -> tuple[Array, Array]:
        """Blend and grain of the textures; (N,) ``footprint`` is the width of a ray, metres."""
        texture = self.scene.texture.take(meeting.triangle, mode="wrap")
        texels = footprint * meeting.texel_density
        return self.scene.textures.sample(texture, meeting.u, meeting.v, texels)

    def radiance(self, meeting: Meeting, footprint: Array, in_sun: Array) -> Array:
        """Light leaving the surfaces (Lambert), (3, N) linear RGB; 0 for NOTHING.

        L = albedo · (ambient sky light + visible sun · max(0, n·s)), all of unit scale.

        Args:
            meeting: the places.
            footprint: (N,) width of what one ray stands for, metres.
            in_sun: (N,) share of the sun that is visible, 0..1.
        """
        blend, grain = self.texture_at(meeting, footprint)
        row = self.scene.look.take(meeting.triangle, axis=0, mode="wrap")
        ambient, direct = grain * row[:, 6], grain * row[:, 7] * in_sun
        colour = np.empty((3, len(grain)), np.float32)
        sky = self.scene.sky
        # Channel by channel: numpy is slow where the innermost axis has three elements.
        for channel, (from_sky, from_sun) in enumerate(zip(sky.ambient, sky.sun, strict=True)):
            albedo = row[:, channel] + row[:, 3 + channel] * blend
            np.multiply(albedo, ambient * from_sky + direct * from_sun, out=colour[channel])
        return colour

    def reflectance(self, meeting: Meeting, footprint: Array) -> Array:
        """Reflectance at the LiDAR's wavelength, (N,) in 0..1."""
        blend, grain = self.texture_at(meeting, footprint)
        pair = self.scene.reflectance.take(meeting.triangle, axis=0, mode="wrap")
        mixed = pair[:, 0] + (pair[:, 1] - pair[:, 0]) * blend
        return np.asarray((mixed * (0.5 + 0.5 * grain)).clip(0, 1), np.float32)
