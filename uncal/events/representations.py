"""Tensors made of the events of a window, for a network to read.

Each representation draws straight into the network's image: the events' rectified coordinates go
through a :class:`PixelMap`, and what falls outside is left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uncal.events.stream import Events, PixelMap
from uncal.settings.group import SettingsGroup
from uncal.settings.rules import number

_ROUNDING = 1e-6
"""Relative differences that float32 may make up."""

CHUNK = 1 << 14
"""Events at a time: few enough that the intermediate arrays stay in a core's cache."""


class BorderedGrid:
    """Planes with a border that takes what falls outside of the image.

    Stray and non-finite coordinates land there rather than being searched for, which would cost
    more than drawing them.

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


@runtime_checkable
class EventRepresentation(Protocol):
    """What turns the events of a window into an image."""

    @property
    def channels(self) -> int:
        """C of the tensors."""
        ...

    def __call__(self, events: Events, size: tuple[int, int], pixel_map: PixelMap) -> Tensor:
        """Draw a window.

        Args:
            events: the window; events outside of its bounds are ignored.
            size: (H, W) of the result, pixels.
            pixel_map: from the events' coordinates to the result's.

        Returns:
            (C, H, W) float32, zero where nothing happened, never NaN.
        """
        ...


@dataclass(frozen=True)
class Histogram:
    """Events per pixel: channel 0 counts those that became darker, 1 those that became brighter.

    An event belongs to the pixel whose centre is nearest.

    Attributes:
        normalize: divide by the root mean square over the pixels with events; no events stay 0.

    >>> one = np.ones(1, np.float32)
    >>> events = Events(one, 0 * one, np.array([7]), np.array([True]), (0, 10), (2, 2))
    >>> Histogram(normalize=False)(events, (2, 2), PixelMap.identity()).tolist()
    [[[0.0, 0.0], [0.0, 0.0]], [[0.0, 1.0], [0.0, 0.0]]]
    """

    normalize: bool

    @property
    def channels(self) -> int:
        """Two: darker, brighter."""
        return 2

    def __call__(self, events: Events, size: tuple[int, int], pixel_map: PixelMap) -> Tensor:
        """Count; see :class:`EventRepresentation`."""
        counts = BorderedGrid(2, size, before=1, after=1)
        ones = torch.ones(CHUNK)
        for chunk in chunks(events):
            cells = nearest_cells(events, chunk, pixel_map, counts, size)
            counts.flat.scatter_add_(0, cells, ones[: len(cells)])
        image = counts.inside(2)
        return _divide_by_rms(image) if self.normalize else image


@dataclass(frozen=True)
class VoxelGrid(SettingsGroup):
    r"""Signed events over space and time, interpolated in all three directions.

    .. math::
        V(b, v, u) = \sum_i s_i \, k(b - b_i) \, k(v - v_i) \, k(u - u_i), \quad
        k(a) = \max(0, 1 - |a|), \quad b_i = (B - 1) \frac{t_i - t_0}{t_1 - t_0}

    with s = ±1 for brighter and darker and the window's bounds t0 and t1 (Zhu et al., "Unsupervised
    event-based learning of optical flow, depth, and egomotion", CVPR 2019, eq. 1-3; there t0 and t1
    are the first and last event). Each event inside the image weighs 1 in total.

    Attributes:
        bins: B, the number of channels; with 1, time is left out.
        normalize: to zero mean and unit variance over the cells that are not zero; those stay 0.

    >>> one = np.ones(1, np.float32)
    >>> events = Events(0.25 * one, 0 * one, np.array([5]), np.array([False]), (0, 10), (1, 2))
    >>> VoxelGrid(bins=2, normalize=False)(events, (1, 2), PixelMap.identity()).tolist()
    [[[-0.375, -0.125]], [[-0.375, -0.125]]]
    """

    key: ClassVar[str] = "model.inputs.events"
    bins: Annotated[int, number(1, 1000, whole=True)]
    normalize: bool

    @property
    def channels(self) -> int:
        """One per bin."""
        return self.bins

    def __call__(self, events: Events, size: tuple[int, int], pixel_map: PixelMap) -> Tensor:
        """Interpolate; see :class:`EventRepresentation`."""
        # Of the eight cells around an event, those beyond the image and the last bin exist, too.
        grid = BorderedGrid(self.bins + 1, size, before=1, after=2)
        in_plane = np.array([[0], [1], [grid.stride], [grid.stride + 1]])
        corners = np.stack([in_plane, in_plane + grid.plane])
        cells, weights = np.empty(8 * CHUNK, np.int64), np.empty(8 * CHUNK, np.float32)
        start, end = events.window
        for chunk in chunks(events):
            n = chunk.stop - chunk.start
            u = map_coordinates(events.x[chunk], pixel_map.sx, pixel_map.ox + 1.0, size[1] + 1.0)
            v = map_coordinates(events.y[chunk], pixel_map.sy, pixel_map.oy + 1.0, size[0] + 1.0)
            b = (events.t[chunk] - start).astype(np.float32)
            b *= np.float32((self.bins - 1) / (end - start))
            column, row, lower = np.floor(u), np.floor(v), np.floor(b)
            first = grid.cells(lower, row, column)
            np.add(first, corners, out=cells[: 8 * n].reshape(2, 4, n))
            in_time = _linear(b - lower) * (2.0 * events.p[chunk].astype(np.float32) - 1.0)
            in_space = _linear(v - row)[:, None] * _linear(u - column)
            np.multiply(
                in_time[:, None], in_space.reshape(4, n), out=weights[: 8 * n].reshape(2, 4, n)
            )
            grid.flat.scatter_add_(
                0, torch.from_numpy(cells[: 8 * n]), torch.from_numpy(weights[: 8 * n])
            )
        image = grid.inside(self.bins)
        return _standardize(image) if self.normalize else image


@dataclass(frozen=True)
class TimeSurface(SettingsGroup):
    r"""How recently each pixel last became darker (channel 0) and brighter (channel 1).

    .. math:: S(p, v, u) = \exp(-(t_1 - t_\text{last}(p, v, u)) / \tau)

    with the window's end t1, and 0 where there was no event (Lagorce et al., "HOTS: a hierarchy of
    event-based time-surfaces for pattern recognition", TPAMI 2017).

    Attributes:
        tau_us: τ, microseconds.

    >>> one = np.ones(1, np.float32)
    >>> events = Events(one, 0 * one, np.array([0]), np.array([True]), (0, 10), (1, 2))
    >>> TimeSurface(tau_us=10.0)(events, (1, 2), PixelMap.identity())[1]
    tensor([[0.0000, 0.3679]])
    """

    key: ClassVar[str] = "model.inputs.events"
    tau_us: Annotated[float, number(0, 1e9, above=True)]

    @property
    def channels(self) -> int:
        """Two: darker, brighter."""
        return 2

    def __call__(self, events: Events, size: tuple[int, int], pixel_map: PixelMap) -> Tensor:
        """Find the latest events; see :class:`EventRepresentation`."""
        # Minus infinity is the time of an event that never was: its exponential is zero.
        latest = BorderedGrid(2, size, before=1, after=1, value=-math.inf)
        end = events.window[1]
        for chunk in chunks(events):
            cells = nearest_cells(events, chunk, pixel_map, latest, size)
            age = torch.from_numpy((events.t[chunk] - end).astype(np.float32))
            latest.flat.scatter_reduce_(0, cells, age, "amax")
        return latest.inside(2).div_(self.tau_us).exp_()


def _linear(fraction: NDArray[np.float32]) -> NDArray[np.float32]:
    """(2, n) weights of the lower and the upper neighbour."""
    return np.stack([np.float32(1.0) - fraction, fraction])


def _divide_by_rms(image: Tensor) -> Tensor:
    """In place, root mean square 1 over the cells that are not zero."""
    mean_square = float(image.square().sum()) / max(1, int(np.count_nonzero(image.numpy())))
    return image.div_(math.sqrt(mean_square)) if mean_square > 0 else image


def _standardize(image: Tensor) -> Tensor:
    """In place, zero mean and unit variance over the cells that are not zero."""
    # The others add nothing to the sums, and picking the occupied ones out would cost the most;
    # numpy compares and masks several times faster than torch.
    cells = image.numpy().reshape(-1)
    occupied = cells != 0
    n = max(1, int(np.count_nonzero(occupied)))
    mean = float(cells.sum()) / n
    cells -= np.float32(mean)
    cells *= occupied
    deviation = math.sqrt(float(np.dot(cells, cells)) / n)
    # Equal cells differ from their mean by rounding alone, which must not be blown up.
    return image.div_(deviation) if deviation > _ROUNDING * abs(mean) else image
