"""The surfaces of a scene as seen from one point: which, depth, texture, light, reflectance.

Along a ray p + t·d from a fixed point p, the depth of a triangle's plane and a texture coordinate
on it are t = n·(q - p) / n·d and u = u_q + g·(p - q) + t·g·d (q: a corner, g: the slope of u).
All that does not depend on d is worked out once per view and triangle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.rigid import Matrix
from uncal.simulation.scene.meshes import Array
from uncal.simulation.scene.triangle_scene import Numbers, Scene

OUTSIDE = -2
"""Triangle number around the grid; equal to none, so samples at the border get their own ray."""

Block = tuple[slice, slice]


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
        """Where rays meet the (N,) triangles that :meth:`Scene.cast` has named.

        Directions and, from the view's point to where each ray starts, shifts are (3, N) float32,
        component by component, which is what is fast here.
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

        L = albedo · (ambient sky light + visible sun · max(0, n·s)), all of unit scale; rays are
        (N,) metres wide and see (N,) shares of the sun, 0..1.
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


def samples(
    scene: Scene, T_world_cam: Matrix, rays: Array, n: int
) -> Iterator[tuple[Numbers, Array]]:
    """One of n × n samples of every pixel after the other, of a camera at a (4, 4) pose.

    The rays are (H·n, W·n, 3) float32 in the camera frame.

    Yields:
        (H·W,) triangles that the samples lie on, and (3, H·W) directions to them in the world.
    """
    directions = rays @ T_world_cam[:3, :3].T.astype(np.float32)
    triangle = visible(scene, T_world_cam[:3, 3].astype(np.float32), directions)
    for row in range(n):
        for column in range(n):
            each = (slice(row, None, n), slice(column, None, n))
            yield triangle[each].ravel(), directions[each].transpose(2, 0, 1).reshape(3, -1)


def visible(scene: Scene, position: Array, directions: Array) -> Numbers:
    """(H, W) first triangle, or NOTHING, on rays that are linear in row and column.

    A sample whose four neighbours lie on one triangle lies on that triangle too, because triangles
    are convex and project to convex shapes, and needs no ray. Only what is thinner than the gap
    between two samples and hides in it is missed: about one sample in 30,000 of a street.
    """
    height, width = directions.shape[:2]
    triangle = np.full((height + 2, width + 2), OUTSIDE, np.int32)
    cells = np.zeros(triangle.shape, np.int64)
    cells[1:-1, 1:-1] = np.arange(height * width).reshape(height, width)
    rays = directions.reshape(-1, 3)
    for block, neighbours in _passes(height, width):
        found = triangle[block]
        unknown = np.ones(found.shape, bool)
        if neighbours:
            first, second, third, fourth = (triangle[neighbour] for neighbour in neighbours)
            unknown = (first != second) | (first != third) | (first != fourth)
            found[:] = first
        chosen = rays.take(cells[block][unknown], axis=0)
        origins = np.empty_like(chosen)
        origins[:] = position
        found[unknown] = scene.cast(origins, chosen)
    return triangle[1:-1, 1:-1]


def _passes(height: int, width: int) -> Iterator[tuple[Block, list[Block]]]:
    """Every fourth sample; then those amid four of them; then the rest, amid four of both.

    Yields:
        The samples of a pass as a block of the padded grid, and the blocks of their neighbours;
        none in the first pass.
    """

    def block(row: int, column: int, down: int = 0, right: int = 0) -> Block:
        last_row, last_column = height + 1 + down, width + 1 + right
        return slice(row + down, last_row, 2), slice(column + right, last_column, 2)

    yield block(1, 1), []
    diagonal = [(-1, -1), (1, 1), (-1, 1), (1, -1)]
    yield block(2, 2), [block(2, 2, down, right) for down, right in diagonal]
    for row, column in ((1, 2), (2, 1)):
        straight = [(0, -1), (0, 1), (-1, 0), (1, 0)]
        yield block(row, column), [block(row, column, down, right) for down, right in straight]
