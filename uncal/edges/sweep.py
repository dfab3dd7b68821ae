"""Depth and intensity edges of one sweep, each placed in the middle of the gap that it fell into.

A LiDAR samples directions. Between two neighbouring returns at different depths there is an edge of
the nearer object, somewhere in the gap; the nearer return itself lies on average half a step inside
the object. Taking it for the edge shifts all edges of an object inwards, by 0.7 px at an azimuth
step of 0.35° and a focal length of 230 px, which is common to the image and looks like a pose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uncal.edges.rings import rings

KINDS: tuple[str, ...] = (
    "depth across",
    "outline across",
    "intensity across",
    "depth along",
    "outline along",
    "intensity along",
)
"""Kinds of edges: across = between azimuths of one laser, along = between neighbouring lasers."""

N_ACROSS = 3
"""The first kinds are those across."""

COLUMNS: tuple[str, ...] = (
    *("x", "y", "z"),
    *("kind", "side", "strength", "gap"),
    *("reflectance", "contrast"),
)
"""Columns of an edge: position in metres in the LiDAR frame, in the middle of the gap; number of
its kind; side of the farther (darker) neighbour, +1 left or up, -1 right or down; strength, 0..1
(relative jump of inverse range, or of reflectance); width of the gap in radians; reflectance of the
nearer neighbour, and what the farther one has more."""

KIND, SIDE, STRENGTH, GAP, REFLECTANCE, CONTRAST = range(3, 9)
"""Numbers of the columns behind the position."""

_JUMP = 0.04
"""Relative jump of inverse range, beyond that of a smooth surface, that is an edge."""

_CONTRAST = 0.07
"""Jump of reflectance that is an edge."""

_NEIGHBOUR_STEPS = 2.5
"""Returns of one laser at most so many azimuth steps apart are neighbours."""

_OUTLINE_STEPS = 6.0
"""At least so many steps without a return are an outline against what returns nothing."""

_ROWS_ALONG = np.radians(2.5)
"""Lasers further apart than this say little about where an edge between them lies."""


def find_edges(points: NDArray[np.float32], most: int | None = None) -> NDArray[np.float32]:
    """Find the edges of a sweep.

    On any plane inverse range is a linear function of the direction's tangents, so that along a
    smooth surface its steps change slowly. A depth edge is a step that exceeds both of its
    neighbours' by a share of the inverse range itself.

    Args:
        points: (N, 4) float32 x, y, z in metres in the LiDAR frame, and reflectance in 0..1, of
            one sweep in the order of its file.
        most: keep at most so many, the strongest of each kind in proportion; None: all.

    Returns:
        (m, len(COLUMNS)) float32; see :data:`COLUMNS`.
    """
    if len(points) < 8:
        return np.empty((0, len(COLUMNS)), np.float32)
    order, ring = rings(points)
    sweep = _Sweep(points[order].astype(np.float32), ring)
    found = np.concatenate([_across(sweep), _along(sweep)])
    if most is not None and len(found) > most:
        found = _strongest(found, most)
    return np.ascontiguousarray(found, np.float32)


class _Sweep:
    """A sweep, sorted, in spherical coordinates."""

    def __init__(self, points: NDArray[np.float32], ring: NDArray[np.intp]) -> None:
        self.points, self.ring = points, ring
        xy = np.hypot(points[:, 0], points[:, 1])
        self.range = np.hypot(xy, points[:, 2]).clip(1e-3)
        self.azimuth = np.arctan2(points[:, 1], points[:, 0])
        self.elevation = np.arctan2(points[:, 2], xy)
        self.inverse = 1.0 / self.range
        self.reflectance = points[:, 3]
        gap = (np.diff(self.azimuth) + np.pi) % (2 * np.pi) - np.pi
        self.same = (np.diff(ring) == 0) & (gap > 0)
        self.gap = gap
        inside = gap[self.same]
        self.step = float(np.median(inside)) if len(inside) else 1e-2


def _across(s: _Sweep) -> NDArray[np.float32]:
    """Edges between consecutive returns of one laser."""
    near_enough = s.same & (s.gap < _NEIGHBOUR_STEPS * s.step)
    change = np.where(near_enough, np.abs(np.diff(s.inverse)), 0.0)
    around = np.maximum(np.append(0.0, change[:-1]), np.append(change[1:], 0.0))
    top = np.maximum(s.inverse[1:], s.inverse[:-1])
    jump = (change - np.minimum(around, change)) / top
    depth = near_enough & (jump > _JUMP)
    contrast = np.abs(np.diff(s.reflectance))
    beside = np.maximum(np.append(0.0, contrast[:-1]), np.append(contrast[1:], 0.0))
    intensity = near_enough & ~depth & (contrast > _CONTRAST) & (contrast >= beside)

    i = np.flatnonzero(depth)
    first_near = s.inverse[i] > s.inverse[i + 1]
    near, far = np.where(first_near, i, i + 1), np.where(first_near, i + 1, i)
    side = np.where(first_near, 1.0, -1.0)
    turn = side * s.gap[i] / 2
    found = [_edges(s, near, far, 0, side, jump[i], s.gap[i], s.azimuth[near] + turn)]

    i = np.flatnonzero(s.same & (s.gap > _OUTLINE_STEPS * s.step))
    for near, sign in ((i, 1.0), (i + 1, -1.0)):
        azimuth = s.azimuth[near] + sign * s.step / 2
        half = np.full(len(near), 0.5)
        step = np.full(len(near), s.step)
        found.append(_edges(s, near, near, 1, sign + 0 * half, half, step, azimuth))

    i = np.flatnonzero(intensity)
    brighter = s.reflectance[i] > s.reflectance[i + 1]
    near, far = np.where(brighter, i, i + 1), np.where(brighter, i + 1, i)
    side = np.where(brighter, 1.0, -1.0)
    middle = s.azimuth[i] + s.gap[i] / 2
    found.append(_edges(s, near, far, 2, side, contrast[i], s.gap[i], middle))
    return np.concatenate(found)


def _along(s: _Sweep) -> NDArray[np.float32]:
    """Edges between returns of neighbouring lasers at nearly the same azimuth."""
    column = np.round(s.azimuth / s.step).astype(np.intp)
    column -= column.min()
    table = np.full((int(s.ring.max()) + 1, int(column.max()) + 1), -1, np.intp)
    table[s.ring, column] = np.arange(len(s.ring))
    if len(table) < 3:
        return np.empty((0, len(COLUMNS)), np.float32)
    # The lower laser first, whichever way the file counts.
    means = [np.median(s.elevation[s.ring == r]) for r in (0, len(table) - 1)]
    if means[0] > means[1]:
        table = table[::-1]
    there = table >= 0
    inverse = np.where(there, s.inverse[table], 0.0)
    both = there[1:] & there[:-1]
    change = np.where(both, np.abs(np.diff(inverse, axis=0)), 0.0)
    padded = np.pad(change, ((1, 1), (0, 0)))
    around = np.maximum(padded[:-2], padded[2:])
    top = np.maximum(inverse[1:], inverse[:-1]).clip(1e-6)
    jump = (change - np.minimum(around, change)) / top
    lower, upper = table[:-1], table[1:]
    rise = np.where(both, s.elevation[upper] - s.elevation[lower], 0.0)
    usable = both & (rise > 0) & (rise < _ROWS_ALONG)
    depth = usable & (jump > 2 * _JUMP)
    contrast = np.where(both, np.abs(s.reflectance[upper] - s.reflectance[lower]), 0.0)
    intensity = usable & ~depth & (contrast > 1.5 * _CONTRAST)

    found = []
    a, b = lower[depth], upper[depth]
    low_near = s.inverse[a] > s.inverse[b]
    near, far = np.where(low_near, a, b), np.where(low_near, b, a)
    side = np.where(low_near, 1.0, -1.0)
    gap = rise[depth]
    lift = s.elevation[near] + side * gap / 2
    found.append(_edges(s, near, far, 3, side, jump[depth], gap, None, lift))

    # Tops against nothing: no return of the two lasers above.
    free = ~there
    above = np.ones_like(there)
    above[:-1] &= free[1:]
    above[:-2] &= free[2:]
    above[-1] = False
    i = table[there & above]
    laser_gap = float(np.median(rise[usable])) if usable.any() else s.step
    gap = np.full(len(i), laser_gap)
    found.append(
        _edges(s, i, i, 4, 1.0 + 0 * gap, 0.5 + 0 * gap, gap, None, s.elevation[i] + gap / 2)
    )

    a, b = lower[intensity], upper[intensity]
    low_bright = s.reflectance[a] > s.reflectance[b]
    near, far = np.where(low_bright, a, b), np.where(low_bright, b, a)
    side = np.where(low_bright, 1.0, -1.0)
    gap = rise[intensity]
    middle = (s.elevation[a] + s.elevation[b]) / 2
    found.append(_edges(s, near, far, 5, side, contrast[intensity], gap, None, middle))
    return np.concatenate(found)


def _edges(
    s: _Sweep,
    near: NDArray[np.intp],
    far: NDArray[np.intp],
    kind: int,
    side: NDArray[np.floating],
    strength: NDArray[np.floating],
    gap: NDArray[np.floating],
    azimuth: NDArray[np.floating] | None,
    elevation: NDArray[np.floating] | None = None,
) -> NDArray[np.float32]:
    """Rows of edges at the nearer returns' range and the given directions."""
    azimuth = s.azimuth[near] if azimuth is None else azimuth
    elevation = s.elevation[near] if elevation is None else elevation
    flat = s.range[near] * np.cos(elevation)
    rows = np.empty((len(near), len(COLUMNS)), np.float32)
    rows[:, 0] = flat * np.cos(azimuth)
    rows[:, 1] = flat * np.sin(azimuth)
    rows[:, 2] = s.range[near] * np.sin(elevation)
    rows[:, 3] = kind
    rows[:, 4] = side
    rows[:, 5] = np.clip(strength, 0.0, 1.0)
    rows[:, 6] = gap
    rows[:, 7] = s.reflectance[near]
    rows[:, 8] = s.reflectance[far] - s.reflectance[near]
    return rows


def _strongest(edges: NDArray[np.float32], most: int) -> NDArray[np.float32]:
    """The strongest of each kind, all kinds thinned alike; in the order found."""
    share = most / len(edges)
    kept = []
    for kind in range(len(KINDS)):
        index = np.flatnonzero(edges[:, 3] == kind)
        count = int(len(index) * share)
        best = np.argsort(-edges[index, 5], kind="stable")[:count]
        kept.append(index[best])
    return edges[np.sort(np.concatenate(kept))]
