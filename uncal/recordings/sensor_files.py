"""Reading single sensor files: images, Velodyne scans, timestamps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from uncal.errors import FrameError

_TO_RGB = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}
"""Channels as OpenCV reads them → what makes RGB of them."""

_POINT_BYTES = 16
"""x, y, z, reflectance as float32."""


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image.

    Returns:
        (H, W, 3) uint8 RGB. Grey is repeated over the three channels, transparency is left out,
        and of 16 bits the upper 8 are kept: full scale stays full scale. The pixels are those of
        the file; a rotation that its metadata ask for would not be the camera's.

    Raises:
        FrameError: the file is missing, empty, truncated, no image, or of another depth.
    """
    encoded = _read_bytes(path)
    image = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if encoded.size else None
    if image is None:
        raise FrameError(
            f"{path}: not a readable image ({encoded.size} bytes); "
            "truncated or damaged, copy it again."
        )
    if image.dtype == np.uint16:
        image = np.right_shift(image.astype(np.uint16), 8).astype(np.uint8)
    channels = 1 if image.ndim == 2 else image.shape[2]
    if image.dtype != np.uint8 or channels not in _TO_RGB:
        raise FrameError(
            f"{path}: {channels} channels of {image.dtype}, expected grey, RGB or RGBA of 8 or 16 "
            "bits a channel; convert it."
        )
    return cv2.cvtColor(image, _TO_RGB[channels]).astype(np.uint8, copy=False)


def write_image(path: Path, image: NDArray[np.uint8]) -> int:
    """Write (h, w, 3) RGB as a PNG into an existing folder; returns the bytes written.

    OpenCV's own writer reports success where a disk becomes full within the last block.

    Raises:
        OSError: the file could not be written.
    """
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))
    return path.write_bytes(encoded.tobytes())


def image_size(path: Path) -> tuple[int, int] | None:
    """(H, W) in pixels, as the header says; None for what is no image or cannot be read."""
    try:
        with Image.open(path) as image:
            return image.height, image.width
    except OSError:
        return None


def usual_size(paths: Sequence[Path]) -> tuple[int, int] | None:
    """(H, W) that most images of a drive have, of 25 spread evenly over it; None: none is readable.

    A pure function of the files, so that every loading process judges alike.
    """
    n = min(len(paths), 25)
    chosen = [paths[i * len(paths) // n] for i in range(n)]
    sizes = Counter(size for size in map(image_size, chosen) if size is not None)
    return min(sizes, key=lambda size: (-sizes[size], size)) if sizes else None


def read_scan(path: Path) -> tuple[NDArray[np.float32], int]:
    """Read a Velodyne scan and drop the points that are not finite.

    Returns:
        (N, 4) float32 x, y, z (metres, LiDAR frame) and reflectance, N ≥ 1, and how many points
        were dropped.

    Raises:
        FrameError: the file is missing, empty, truncated, or holds no finite point.
    """
    raw = _read_bytes(path)
    if raw.size == 0 or raw.size % _POINT_BYTES:
        raise FrameError(
            f"{path}: {raw.size} bytes, expected a positive multiple of {_POINT_BYTES} "
            "(float32 x, y, z, reflectance); empty or truncated, copy it again."
        )
    points = raw.view("<f4").astype(np.float32, copy=False).reshape(-1, 4)
    finite = np.isfinite(points).all(axis=1)
    n_dropped = int(points.shape[0] - np.count_nonzero(finite))
    if n_dropped == points.shape[0]:
        raise FrameError(
            f"{path}: none of its {n_dropped} points is finite, expected metres; "
            "damaged, copy it again."
        )
    return (points[finite] if n_dropped else points), n_dropped


def read_clock_times(path: Path) -> NDArray[np.float64]:
    """(lines,) seconds since 1970 of KITTI raw stamps ``2011-09-26 13:02:25.964389445``, or NaN."""
    return _read_times(path, _clock_seconds)


def read_second_times(path: Path) -> NDArray[np.float64]:
    """(lines,) seconds of KITTI odometry stamps, or NaN; a missing file holds no lines."""
    return _read_times(path, float)


def _clock_seconds(line: str) -> float:
    time = np.datetime64(line.strip(), "ns")
    return float("nan") if np.isnat(time) else float(time.astype(np.int64)) / 1e9


def _read_times(path: Path, parse: Callable[[str], float]) -> NDArray[np.float64]:
    def seconds(line: str) -> float:
        try:
            return parse(line)
        except ValueError:
            return float("nan")

    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    return np.array([seconds(line) for line in lines], dtype=np.float64)


def _read_bytes(path: Path) -> NDArray[np.uint8]:
    # np.fromfile, unlike bytes, gives an array that torch may wrap without a copy.
    try:
        return np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise FrameError(f"{path}: cannot be read ({error.strerror or error}).") from error
