"""The grid that events are drawn into, and the cells that they fall in.

A grid carries a border while it is filled: stray and non-finite coordinates land there rather than
being searched for, which would cost more than drawing them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uncal.events.pixel_map import PixelMap
from uncal.events.stream import Events

CHUNK = 1 << 14
"""Events at a time: few enough that the intermediate arrays stay in a core's cache."""


class BorderedGrid:
    """Planes with a border that takes what falls outside of the image.

    Attributes:
        flat: all cells.
        stride: cells from one row to the next.
        plane: cells from one plane to the next.
    """

    def __init__(
        self, planes: int, size: tuple[int, int], before: int, after: int, value: float = 0.0
    ) -> None:
        self._size, self._before = size, before
        rows, self.stride = (extent + before + after for extent in size)
        self.plane = rows * self.stride
        self.flat = torch.full((planes * self.plane,), value)

    def cells(
        self, plane: NDArray[np.generic], row: NDArray[np.float32], column: NDArray[np.float32]
    ) -> NDArray[np.int64]:
        """(n,) numbers of cells, from planes and from rows and columns that count the border."""
        cells = plane.astype(np.int64)
        cells *= self.plane
        cells += row.astype(np.int64) * self.stride
        cells += column.astype(np.int64)
        return cells

    def inside(self, planes: int) -> Tensor:
        """(planes, H, W) the first planes without the border, contiguous."""
        (height, width), first = self._size, self._before
        grid = self.flat.view(-1, self.plane // self.stride, self.stride)
        return grid[:planes, first : first + height, first : first + width].contiguous()


def chunks(events: Events) -> Iterator[slice]:
    """The events within the window's bounds, some at a time."""
    first, last = np.searchsorted(events.t, events.window)
    for begin in range(first, last, CHUNK):
        yield slice(begin, min(begin + CHUNK, last))


def map_coordinates(
    values: NDArray[np.float32], scale: float, offset: float, largest: float
) -> NDArray[np.float32]:
    """Map coordinates of a bordered grid; NaN and what is beyond the border goes to its edge.

    >>> map_coordinates(np.array([1.5, -9, np.nan, 9], np.float32), 2.0, 1.0, 6.0).tolist()
    [4.0, 0.0, 0.0, 6.0]
    """
    mapped: NDArray[np.float32] = values * np.float32(scale)
    mapped += np.float32(offset)
    # Unlike clip, fmax takes the number where the other is NaN.
    np.fmax(mapped, np.float32(0.0), out=mapped)
    np.fmin(mapped, np.float32(largest), out=mapped)
    return mapped


def nearest_cells(
    events: Events, chunk: slice, pixel_map: PixelMap, grid: BorderedGrid, size: tuple[int, int]
) -> Tensor:
    """(n,) int64 cell of the plane of an event's polarity, in a grid with a border of 1."""
    height, width = size
    column = map_coordinates(events.x[chunk], pixel_map.sx, pixel_map.ox + 1.5, width + 1.0)
    row = map_coordinates(events.y[chunk], pixel_map.sy, pixel_map.oy + 1.5, height + 1.0)
    return torch.from_numpy(grid.cells(events.p[chunk], row, column))
