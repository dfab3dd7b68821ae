"""Which laser of a spinning LiDAR measured each point of a sweep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_BACKWARD = np.radians(2.0)
"""A step against the direction of rotation by more than this starts a new ring."""

_BEAM_GAP = np.radians(0.25)
"""Elevations of neighbouring lasers differ by at least this where points come column by column."""


def rings(points: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Sort a sweep by laser, then along the direction of rotation.

    Sweeps are stored laser by laser (KITTI, the simulator) or column by column (a VLP-16's bag).
    In the first case a ring ends where the azimuth jumps back, or, if it never does because every
    ring is a full revolution, where it passes through straight ahead (KITTI's cut). In the second
    case lasers are told apart by their elevation.

    Args:
        points: (N, 3 or 4) x, y, z in metres, LiDAR frame, in the order of the file.

    Returns:
        (N,) order that sorts the points by ring and azimuth, and the (N,) ring of each point in
        that order: numbers from 0 upwards; neighbouring lasers have neighbouring numbers.
    """
    if len(points) < 2:
        index = np.arange(len(points))
        return index, np.zeros(len(points), np.intp)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    step = _wrapped(np.diff(azimuth))
    turning = np.abs(step) > 1e-5
    if not turning.any() or np.median(np.abs(step)) < 1e-4 or _interleaved(points):
        return _by_elevation(points, azimuth)
    forward = 1.0 if np.median(step[turning]) > 0 else -1.0
    start = step * forward < -_BACKWARD
    if start.sum() < 4:
        turned = azimuth * forward
        start = (turned[:-1] < 0) & (turned[1:] >= 0) & (np.abs(azimuth[1:]) < np.pi / 2)
        start |= (turned[:-1] < 0) & (turned[1:] >= 0) & (step * forward > 0)
    ring = np.concatenate([[0], np.cumsum(start)])
    index = np.arange(len(points))
    return (index, ring) if forward > 0 else (index[::-1].copy(), (ring[-1] - ring)[::-1].copy())


def _interleaved(points: NDArray[np.float32]) -> bool:
    """Whether most neighbours in the file come from different lasers."""
    elevation = _elevation(points)
    return bool(np.median(np.abs(np.diff(elevation))) > _BEAM_GAP)


def _by_elevation(
    points: NDArray[np.float32], azimuth: NDArray[np.float32]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    elevation = _elevation(points)
    order = np.argsort(elevation, kind="stable")
    ring = np.empty(len(points), np.intp)
    ring[order] = np.concatenate([[0], np.cumsum(np.diff(elevation[order]) > _BEAM_GAP)])
    order = np.lexsort((azimuth, ring))
    return order, ring[order]


def _elevation(points: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))


def _wrapped(angle: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
