"""How fast the LiDAR moves, from two of its sweeps: for recordings that do not say.

The vertical edges of a street (poles, corners, sides of cars) stand at the same places in
both sweeps, however the lasers are tilted. A search over forward motion and turn, refined by
iterated closest points, brings those of one sweep onto those of the other.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree  # type: ignore[import-untyped]

from uncal.edges.sweep import KIND, find_edges
from uncal.errors import FrameError
from uncal.recordings.motion import untwisted

FASTEST = 45.0
"""Metres per second: no vehicle is taken to be faster."""

_RANGE_M = 50.0
"""Edges beyond are too sparse to be told from one another."""

_BEHIND_MPS = 3.0
"""Vehicles drive backwards at most so fast."""

_TURN = np.radians(np.arange(-6.0, 6.1, 1.5))
_STEP_M = 0.4
_WIDTHS_M = (0.8, 0.4, 0.2, 0.1)
"""Distances at which two edges still count as one and the same, search first, then refinement."""

LONGEST_S = 1.0
"""Sweeps further apart show too little of the same."""

_MOMENT_S = 0.15
"""Over longer times the mean turn rate says little of the one at a sweep."""

_FEWEST = 40
"""Edges that a sweep needs."""

_SHARED = 0.35
"""Share of the edges that must lie on another one in the end."""


class SweepMotion:
    """The motion at each sweep of a drive, from it and the one before.

    Args:
        read: position of a sweep in the drive → (N, 4) float32, LiDAR frame, metres.
        times: (n,) seconds of all sweeps, ascending; NaN where unknown.
    """

    def __init__(
        self, read: Callable[[int], NDArray[np.float32]], times: NDArray[np.float64]
    ) -> None:
        self._read = read
        self._times = times
        self._edges: dict[int, NDArray[np.float32]] = {}

    def twist(self, position: int) -> NDArray[np.float64] | None:
        """Velocity and turn rate, as in :class:`~uncal.recordings.frame.Frame`.

        Args:
            position: of the sweep; the first one is compared with the second.

        Returns:
            (6,), or None where the two sweeps do not tell.
        """
        first = max(position - 1, 0)
        if first + 1 >= len(self._times):
            return None
        seconds = float(self._times[first + 1] - self._times[first])
        if not 0 < seconds <= LONGEST_S:
            return None
        try:
            edges = [self._vertical_edges(number) for number in (first, first + 1)]
        except FrameError:
            return None
        self._edges = {number: self._edges[number] for number in (first, first + 1)}
        return twist_between(edges[0], edges[1], seconds)

    def _vertical_edges(self, position: int) -> NDArray[np.float32]:
        if position not in self._edges:
            self._edges[position] = vertical_edges(self._read(position))
        return self._edges[position]


def twist_between(
    first: NDArray[np.float32], second: NDArray[np.float32], seconds: float
) -> NDArray[np.float64] | None:
    """Velocity and turn rate of the LiDAR between two sweeps.

    Args:
        first: (n, 3) :func:`vertical_edges` of one sweep; x is ahead.
        second: (m, 3) of the next one.
        seconds: from the first to the second.

    Returns:
        (6,) in the LiDAR frame, metres and radians per second: forward speed and, of sweeps at
        most :data:`_MOMENT_S` apart, the turn rate about the vertical. None: too few edges, or too
        few in common.
    """
    if min(len(first), len(second)) < _FEWEST:
        return None
    twist = np.zeros(6)
    # Both sweeps are distorted by the motion that is sought: a second time without that.
    for _ in range(2):
        still = [untwisted(edges, twist)[:, :2].astype(np.float64) for edges in (first, second)]
        found = _register(still[0], still[1], seconds)
        if found is None:
            return None
        angle, ahead = found
        twist[0] = ahead / seconds
        twist[5] = angle / seconds if seconds <= _MOMENT_S else 0.0
    return twist


def vertical_edges(sweep: NDArray[np.float32]) -> NDArray[np.float32]:
    """(m, 3) places of the depth edges between azimuths of one laser."""
    edges = find_edges(sweep)
    near = np.hypot(edges[:, 0], edges[:, 1]) < _RANGE_M
    return np.ascontiguousarray(edges[near & (edges[:, KIND] == 0), :3], np.float32)


def _register(
    first: NDArray[np.float64], second: NDArray[np.float64], seconds: float
) -> tuple[float, float] | None:
    """Turn (radians) and forward motion (metres) that bring ``second`` (m, 2) onto ``first``."""
    tree = cKDTree(first)
    ahead = np.arange(-_BEHIND_MPS * seconds, FASTEST * seconds, _STEP_M)
    turn, forward = (grid.ravel() for grid in np.meshgrid(_TURN, ahead, indexing="ij"))
    shift = np.stack([forward, 0 * forward], -1)
    moved = _turned(second, turn) + shift[:, None]
    distance, _ = tree.query(moved, distance_upper_bound=3 * _WIDTHS_M[0])
    score = np.exp(-0.5 * (distance / _WIDTHS_M[0]) ** 2).mean(1)
    best = int(score.argmax())
    angle, offset = float(turn[best]), shift[best]
    weight = np.zeros(len(second))
    for width in _WIDTHS_M:
        for _ in range(6):
            here = _turned(second, np.array([angle]))[0] + offset
            distance, nearest = tree.query(here)
            weight = np.exp(-0.5 * (distance / width) ** 2)
            if weight.sum() < 1:
                return None
            angle, offset = _rigid(second, first[nearest], weight)
    if weight.mean() < _SHARED or abs(offset[0]) > FASTEST * seconds:
        return None
    return angle, float(offset[0])


def _turned(points: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m, 2) turned by each of (k,) angles: (k, m, 2)."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = points.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], -1)


def _rigid(
    moving: NDArray[np.float64], fixed: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64]]:
    """Angle and offset that bring points onto others, least squares (Horn 1987, in the plane)."""
    weight = weight / weight.sum()
    a, b = moving - weight @ moving, fixed - weight @ fixed
    cross = (weight * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum()
    dot = (weight * (a * b).sum(1)).sum()
    angle = float(np.arctan2(cross, dot))
    return angle, weight @ fixed - _turned(weight[None] @ moving, np.array([angle]))[0, 0]
