"""Resizing and cropping of images, with the camera matrix that goes with the result."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from uncal.errors import ConfigurationError


def resize_and_crop(
    image: NDArray[np.uint8],
    K: NDArray[np.float64],
    size: tuple[int, int],
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Scale an image, aspect kept, until it covers ``size``; crop the rest evenly on both sides.

    Integer coordinates are pixel centres, so a scale s maps column u to s·(u + ½) - ½.

    Args:
        image: (h, w, 3) uint8.
        K: (3, 3) its camera matrix, pixels.
        size: (H, W) wanted, pixels.

    Returns:
        The (H, W, 3) image and its (3, 3) camera matrix.

    Raises:
        ConfigurationError: ``size`` is not positive.

    >>> K = np.array([[100.0, 0, 49.5], [0, 100.0, 19.5], [0, 0, 1]])
    >>> half, K_half = resize_and_crop(np.zeros((40, 100, 3), np.uint8), K, (20, 40))
    >>> half.shape, K_half[0].tolist(), K_half[1].tolist()
    ((20, 40, 3), [50.0, 0.0, 19.5], [0.0, 50.0, 9.5])
    """
    height, width = size
    if height < 1 or width < 1:
        raise ConfigurationError(f"dataset.image_size={list(size)}: expected two positive numbers")
    h, w = image.shape[:2]
    K = K.copy()
    if (h, w) == (height, width):
        return image, K
    scale = max(height / h, width / w)
    new_h, new_w = max(height, round(h * scale)), max(width, round(w * scale))
    # Rounding to whole pixels makes the two scales differ by a hair; K follows each exactly.
    sx, sy = new_w / w, new_h / h
    method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    resized = cv2.resize(image, (new_w, new_h), interpolation=method)
    top, left = (new_h - height) // 2, (new_w - width) // 2
    K[0] *= sx
    K[1] *= sy
    K[0, 2] += (sx - 1.0) / 2.0 - left
    K[1, 2] += (sy - 1.0) / 2.0 - top
    cropped = resized[top : top + height, left : left + width]
    return np.ascontiguousarray(cropped, dtype=np.uint8), K
