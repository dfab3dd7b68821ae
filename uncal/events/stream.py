"""The events of one window, as every reader returns them, and the way to the network's pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Events:
    """A time window of an event camera, in the rectified image.

    Attributes:
        x: (n,) float32 column, pixels; integers are pixel centres. May lie outside the image.
        y: (n,) float32 row, pixels.
        t: (n,) int64 microseconds on the recording's clock, in order.
        p: (n,) bool, whether the pixel became brighter.
        window: first and last moment of the window, microseconds, [start, end).
        size: (H, W) of the sensor, pixels.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    t: NDArray[np.int64]
    p: NDArray[np.bool_]
    window: tuple[int, int]
    size: tuple[int, int]

    def __len__(self) -> int:
        """Number of events."""
        return len(self.t)


@dataclass(frozen=True)
class PixelMap:
    """A scale and shift per axis: what resizing and then cropping do to coordinates.

    u' = sx·u + ox and v' = sy·v + oy, where whole numbers are pixel centres. An image resized by s
    and cropped by c pixels thus has o = (s - 1) / 2 - c.

    Attributes:
        sx: pixels of the result per pixel of the sensor, along the columns.
        ox: column of the result that the sensor's column 0 comes to.
        sy: as sx, along the rows.
        oy: as ox, of row 0.

    >>> half = PixelMap(0.5, -0.25, 0.5, -0.25)
    >>> half.sx * 10.5 + half.ox
    5.0
    """

    sx: float
    ox: float
    sy: float
    oy: float

    @classmethod
    def identity(cls) -> PixelMap:
        """The map of an image that is neither resized nor cropped."""
        return cls(1.0, 0.0, 1.0, 0.0)
