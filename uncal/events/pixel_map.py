"""From the pixels of a sensor to those of the network's image."""

from __future__ import annotations

from dataclasses import dataclass


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
