"""Resizing and cropping of images and events, with the camera matrix that goes with the result."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uncal.errors import ConfigurationError, FrameError
from uncal.events.stream import PixelMap


@dataclass(frozen=True)
class Fit:
    """How a sensor's image comes to the network's size: resized, then cropped.

    Attributes:
        source: (h, w) of the sensor's image, pixels.
        resized: (h, w) after resizing.
        top: rows cropped above.
        left: columns cropped on the left.
    """

    source: tuple[int, int]
    resized: tuple[int, int]
    top: int
    left: int

    @property
    def pixel_map(self) -> PixelMap:
        """The same for coordinates; a scale s maps column u to s·(u + ½) - ½ before the crop."""
        # Rounding to whole pixels makes the two scales differ by a hair; each is followed exactly.
        sy, sx = (after / before for after, before in zip(self.resized, self.source, strict=True))
        return PixelMap(
            sx=sx, ox=(sx - 1.0) / 2.0 - self.left, sy=sy, oy=(sy - 1.0) / 2.0 - self.top
        )

    def camera_matrix(self, K: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3, 3) camera matrix of the result, from that of the sensor's image, pixels."""
        to = self.pixel_map
        K = K.copy()
        K[0] *= to.sx
        K[1] *= to.sy
        K[0, 2] += to.ox
        K[1, 2] += to.oy
        return K


def fit(source: tuple[int, int], size: tuple[int, int]) -> Fit:
    """Scale (h, w), aspect kept, until (H, W) is covered; crop the rest evenly on both sides.

    Raises:
        ConfigurationError: ``size`` is not positive.

    >>> fit((375, 1242), (192, 640))
    Fit(source=(375, 1242), resized=(193, 640), top=0, left=0)
    """
    (h, w), (height, width) = source, size
    if height < 1 or width < 1:
        raise ConfigurationError(f"dataset.image_size={list(size)}: expected two positive numbers")
    scale = max(height / h, width / w)
    resized = max(height, round(h * scale)), max(width, round(w * scale))
    return Fit(source, resized, (resized[0] - height) // 2, (resized[1] - width) // 2)


def fit_focal(source: tuple[int, int], focal: float, wanted: float, size: tuple[int, int]) -> Fit:
    """Scale an image to a focal length, pixels, and crop the middle: a pixel shows what it should.

    Raises:
        FrameError: the scaled image is smaller than ``size``.

    >>> fit_focal((375, 1242), 721.5, 460.0, (232, 784))
    Fit(source=(375, 1242), resized=(239, 792), top=3, left=4)
    """
    scale = wanted / focal
    resized = round(source[0] * scale), round(source[1] * scale)
    if resized[0] < size[0] or resized[1] < size[1]:
        raise FrameError(
            f"the image of {source[0]}×{source[1]} px has {resized[0]}×{resized[1]} px at a focal "
            f"length of {wanted:.0f} px, fewer than the {size[0]}×{size[1]} that the first frame "
            "has; give dataset.image_size=[H, W] that all frames cover"
        )
    return Fit(source, resized, (resized[0] - size[0]) // 2, (resized[1] - size[1]) // 2)


def size_at_focal(source: tuple[int, int], focal: float, wanted: float) -> tuple[int, int]:
    """Largest (H, W), in multiples of 8, that an image of (h, w) covers at another focal length.

    >>> size_at_focal((375, 1242), 721.5, 460.0)
    (232, 792)
    """
    height, width = (round(side * wanted / focal) // 8 * 8 for side in source)
    return height, width


def resize_and_crop(
    image: NDArray[np.uint8], K: NDArray[np.float64], how: Fit, size: tuple[int, int]
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Bring an (h, w, 3) uint8 image and its (3, 3) camera matrix to the network's (H, W).

    >>> K = np.array([[100.0, 0, 49.5], [0, 100.0, 19.5], [0, 0, 1]])
    >>> how = fit((40, 100), (20, 40))
    >>> half, K_half = resize_and_crop(np.zeros((40, 100, 3), np.uint8), K, how, (20, 40))
    >>> half.shape, K_half[0].tolist(), K_half[1].tolist()
    ((20, 40, 3), [50.0, 0.0, 19.5], [0.0, 50.0, 9.5])
    """
    K = how.camera_matrix(K)
    if how.source == how.resized == size:
        return image, K
    (h, w), (height, width) = how.resized, size
    smaller = h * w < how.source[0] * how.source[1]
    method = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    resized = cv2.resize(image, (w, h), interpolation=method)
    cropped = resized[how.top : how.top + height, how.left : how.left + width]
    return np.ascontiguousarray(cropped, dtype=np.uint8), K
