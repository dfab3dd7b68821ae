"""What a pinhole camera sees at each sample of a grid, with a ray only where it is needed.

On one plane 1/t is linear in image coordinates, and so are u/t and v/t (t: depth; u, v: barycentric
coordinates). A sample whose four neighbours lie on one triangle lies on that triangle too, because
triangles are convex and project to convex shapes, so its hit is the mean of two opposite
neighbours' in these quantities: exact, and cheaper than a ray. Only what is thinner than the
distance of two samples and hides between them is missed.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uncal.simulation.meshes import Array
from uncal.simulation.scene import Hits, Scene

OUTSIDE = -2
"""Triangle number around the grid; equal to none, so samples at the border get their own ray."""

Block = tuple[slice, slice]


def visible(scene: Scene, position: Array, directions: Array) -> Hits:
    """First hits of the rays of a regular grid.

    Args:
        scene: the street.
        position: (3,) float32 common origin, world coordinates.
        directions: (H, W, 3) float32, linear in row and column: all of depth 1 in the camera.

    Returns:
        Hits with (H, W) arrays.
    """
    height, width = directions.shape[:2]
    triangle = np.full((height + 2, width + 2), OUTSIDE, np.int32)
    linear = np.zeros((3, height + 2, width + 2), np.float32)
    numbers = np.arange(triangle.size).reshape(triangle.shape)
    rays = np.zeros((*triangle.shape, 3), np.float32)
    rays[1:-1, 1:-1] = directions
    for block, neighbours in _passes(height, width):
        unknown = numbers[block].ravel()
        if neighbours:
            around = [triangle[neighbour] for neighbour in neighbours]
            agree = around[0] == around[1]
            agree &= around[0] == around[2]
            agree &= around[0] == around[3]
            triangle[block] = around[0]
            for plane in linear:
                mean = plane[neighbours[0]] + plane[neighbours[1]]
                mean *= np.float32(0.5)
                plane[block] = mean
            unknown = unknown[~agree.ravel()]
        chosen = rays.reshape(-1, 3).take(unknown, axis=0)
        origins = np.empty_like(chosen)
        origins[:] = position
        hits = scene.cast(origins, chosen)
        inverse = np.where(hits.triangle >= 0, 1 / hits.t, np.float32(0))
        triangle.ravel()[unknown] = hits.triangle
        for plane, values in zip(
            linear, (inverse, hits.u * inverse, hits.v * inverse), strict=True
        ):
            plane.ravel()[unknown] = values
    inner = linear[:, 1:-1, 1:-1]
    t = 1 / np.maximum(inner[0], np.float32(1e-9))
    return Hits(triangle[1:-1, 1:-1], t, inner[1] * t, inner[2] * t)


def _passes(height: int, width: int) -> Iterator[tuple[Block, list[Block]]]:
    """Every fourth sample; then those amid four of them; then the rest, amid four of both.

    Yields:
        The samples of a pass as a block of the padded grid, and the blocks of their neighbours, the
        first two opposite each other; none in the first pass.
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
