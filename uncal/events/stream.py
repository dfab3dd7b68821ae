"""The events of one window, as every reader returns them."""

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
