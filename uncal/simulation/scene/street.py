"""The street itself: its course, its cross section, its crossings, and the ground's triangles.

Street coordinates: s along the street, y to the left of its centre line, z up from the road.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uncal.simulation.scene.meshes import Mesh, Surfaces
from uncal.simulation.scene.palette import colours, surfaces
from uncal.simulation.scene.textures import Kind
from uncal.simulation.settings import SceneSettings

CELL_M = 8.0
"""Length of a ground quad; short enough to follow the bends."""

CROSSING_SPACING_M = 40.0
VERGE_M = 70.0
"""How far the ground reaches to both sides."""

MARKING_M = 0.15
KERB_STONE_M = 0.15


@dataclass(frozen=True)
class Street:
    """Course and cross section of one drive's street.

    Attributes:
        start: s where the model begins, metres.
        end: s where it ends.
        bend: amplitude (m), wavelength (m) and phase of the lateral course.
        slope: the same of the height.
        lane_m: width of each of the two lanes.
        parking_m: width of the parking strips, possibly 0.
        kerb_m: height of the pavement above the road.
        pavement_m: width of the pavements.
        crossings: (n, 2) start and end s of the crossings.
    """

    start: float
    end: float
    bend: tuple[float, float, float]
    slope: tuple[float, float, float]
    lane_m: float
    parking_m: float
    kerb_m: float
    pavement_m: float
    crossings: NDArray[np.float64]

    @property
    def kerb_y(self) -> float:
        """Distance of the kerbs from the centre line."""
        return self.lane_m + self.parking_m

    @property
    def front_y(self) -> float:
        """Distance of the pavements' outer edges from the centre line."""
        return self.kerb_y + self.pavement_m

    @property
    def length(self) -> float:
        """Metres of street."""
        return self.end - self.start

    def lateral(self, s: ArrayLike) -> NDArray[np.float64]:
        """World y of the centre line at s."""
        return _wave(s, *self.bend)

    def heading(self, s: ArrayLike) -> NDArray[np.float64]:
        """Direction of the centre line at s, radians from world x."""
        return _wave_angle(s, *self.bend)

    def height(self, s: ArrayLike) -> NDArray[np.float64]:
        """World z of the road at s."""
        return _wave(s, *self.slope)

    def incline(self, s: ArrayLike) -> NDArray[np.float64]:
        """Pitch of the road at s, radians, positive downhill (right-handed about y)."""
        return -_wave_angle(s, *self.slope)

    def world(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Street coordinates (..., 3) → world."""
        s = points[..., 0].astype(np.float64)
        return np.stack([s, points[..., 1] + self.lateral(s), points[..., 2] + self.height(s)], -1)

    def in_crossing(self, s: NDArray[np.float64], margin: ArrayLike) -> NDArray[np.bool_]:
        """Which of (n,) s lie in a crossing widened by ``margin``, metres."""
        low, high = self.crossings[:, 0], self.crossings[:, 1]
        reach = np.broadcast_to(margin, s.shape)[:, None]
        return np.asarray(((s[:, None] > low - reach) & (s[:, None] < high + reach)).any(1))


def _wave(s: ArrayLike, amplitude: float, wavelength: float, phase: float) -> NDArray[np.float64]:
    """A sine of s that is 0 at 0."""
    turns = 2 * np.pi * np.asarray(s, np.float64) / wavelength
    return np.asarray(amplitude * (np.sin(turns + phase) - np.sin(phase)))


def _wave_angle(
    s: ArrayLike, amplitude: float, wavelength: float, phase: float
) -> NDArray[np.float64]:
    """Angle of its tangent, radians."""
    rate = 2 * np.pi / wavelength
    return np.arctan(amplitude * rate * np.cos(rate * np.asarray(s, np.float64) + phase))


def draw_street(scene: SceneSettings, rng: np.random.Generator, start: float, end: float) -> Street:
    """Draw the course and cross section of a street from s = start to end."""

    def wave(largest_deg: float) -> tuple[float, float, float]:
        wavelength, phase = rng.uniform(150, 400), rng.uniform(0, 2 * np.pi)
        tangent = np.tan(np.deg2rad(largest_deg)) * rng.uniform(0, 1)
        return float(tangent * wavelength / (2 * np.pi)), float(wavelength), float(phase)

    slots = np.arange(start + CROSSING_SPACING_M / 2, end - 15, CROSSING_SPACING_M)
    slots = slots[rng.random(len(slots)) < scene.crossing_probability]
    centre = slots + rng.uniform(-8, 8, len(slots))
    half = rng.uniform(3.5, 7.5, len(slots))
    return Street(
        start=start,
        end=end,
        bend=wave(scene.bend_deg),
        slope=wave(scene.slope_deg),
        lane_m=float(rng.uniform(2.9, 3.8)),
        parking_m=float(rng.choice([0.0, 2.2])),
        kerb_m=float(rng.uniform(0.06, 0.18)),
        pavement_m=float(rng.uniform(1.6, 4.5)),
        crossings=np.stack([centre - half, centre + half], 1),
    )


def add_ground(mesh: Mesh, street: Street, rng: np.random.Generator) -> None:
    """Add road, markings, kerbs, pavements, verges and crossings."""
    fixed = np.arange(street.start, street.end + CELL_M, CELL_M)
    edges = np.unique(np.concatenate([fixed, street.crossings.ravel()]))
    cells = np.stack([edges[:-1], edges[1:]], 1)
    crossing = street.in_crossing(cells.mean(1), 0.0)
    plain, kerb = cells[~crossing], street.kerb_m
    asphalt, side, stone = _road_surface(rng), _pavement_surface(rng), _kerb_surface(rng)
    verge, line, dashes = _verge_surface(rng), _paint(rng, Kind.ROUGH), _paint(rng, Kind.DASHES)
    edge_line = street.lane_m - rng.uniform(0.1, 0.3) if rng.random() < 0.7 else None
    half = MARKING_M / 2
    _strip(mesh, street, cells, -half, half, 0.0, dashes if rng.random() < 0.8 else line)
    mouths = [np.repeat(ends[:, None], 2, axis=1) for ends in street.crossings.T]
    for sign in (-1, 1):
        begin = half
        if edge_line is not None:
            _strip(mesh, street, cells, sign * half, sign * edge_line, 0.0, asphalt)
            begin = edge_line + MARKING_M
            _strip(mesh, street, cells, sign * edge_line, sign * begin, 0.0, line)
        _strip(mesh, street, cells, sign * begin, sign * street.kerb_y, 0.0, asphalt)
        kerb_y, front_y, end_y = (sign * y for y in (street.kerb_y, street.front_y, VERGE_M))
        back_y = kerb_y + sign * KERB_STONE_M
        _strip(mesh, street, plain, kerb_y, back_y, kerb, stone)
        _strip(mesh, street, plain, back_y, front_y, kerb, side)
        _strip(mesh, street, plain, front_y, end_y, kerb, verge)
        _strip(mesh, street, cells[crossing], kerb_y, end_y, 0.0, asphalt)
        _wall(mesh, street, plain[:, ::sign], (kerb_y, kerb_y), kerb, stone)
        for ends, y in zip(mouths, ((kerb_y, end_y), (end_y, kerb_y)), strict=True):
            _wall(mesh, street, ends, y[::sign], kerb, stone)


def _strip(
    mesh: Mesh,
    street: Street,
    cells: NDArray[np.float64],
    y0: float,
    y1: float,
    z: float,
    surface: Surfaces,
) -> None:
    """Add a strip of ground between two lateral positions, facing up."""
    low, high = min(y0, y1), max(y0, y1)
    s0, s1 = cells.T
    corners = [(s0, low), (s1, low), (s1, high), (s0, high)]
    flat = [np.stack([s, np.full_like(s, y), np.full_like(s, z)], -1) for s, y in corners]
    extent = np.stack([s1 - s0, np.full_like(s0, high - low)], -1)
    each = surface[np.zeros(len(cells), int)]
    mesh.add(street.world(np.stack(flat, 1)[:, None]), extent[:, None], each)


def _wall(
    mesh: Mesh,
    street: Street,
    ends: NDArray[np.float64],
    y: tuple[float, ...],
    height: float,
    surface: Surfaces,
) -> None:
    """Add vertical faces up to ``height``; (n, 2) ``ends``: s left and right, seen from outside."""
    s = ends[:, [0, 1, 1, 0]]
    across = np.broadcast_to(np.array(y)[[0, 1, 1, 0]], s.shape)
    up = np.broadcast_to(np.array([0.0, 0.0, height, height]), s.shape)
    width = np.hypot(ends[:, 1] - ends[:, 0], y[1] - y[0])
    extent = np.stack([width, np.full_like(width, height)], -1)
    quads = street.world(np.stack([s, across, up], -1))
    mesh.add(quads[:, None], extent[:, None], surface[np.zeros(len(ends), int)])


def _road_surface(rng: np.random.Generator) -> Surfaces:
    kinds = (Kind.ROUGH, Kind.PATCHES)
    return surfaces(rng, 1, kinds, (CELL_M, 4.0), colours(rng, 1, (0.06, 0.3), (0.0, 0.1)))


def _pavement_surface(rng: np.random.Generator) -> Surfaces:
    kinds = (Kind.MASONRY, Kind.ROUGH, Kind.PATCHES)
    return surfaces(rng, 1, kinds, (4.0, 4.0), colours(rng, 1, (0.15, 0.6), (0.0, 0.25)))


def _verge_surface(rng: np.random.Generator) -> Surfaces:
    if rng.random() < 0.5:
        green = colours(rng, 1, (0.1, 0.35), (0.3, 0.7), (0.15, 0.35))
        return surfaces(rng, 1, Kind.LEAVES, (8.0, 8.0), green, reflectances=(0.55, 0.35))
    return surfaces(rng, 1, (Kind.ROUGH, Kind.MASONRY), 8.0, colours(rng, 1, (0.1, 0.5), (0, 0.3)))


def _kerb_surface(rng: np.random.Generator) -> Surfaces:
    return surfaces(rng, 1, Kind.ROUGH, 2.0, colours(rng, 1, (0.2, 0.8), (0.0, 0.1)))


def _paint(rng: np.random.Generator, kind: Kind) -> Surfaces:
    road, paint = colours(rng, 1, (0.08, 0.25), (0, 0.1)), colours(rng, 1, (0.6, 0.9), (0, 0.1))
    pair = (road, paint) if kind is Kind.DASHES else (paint, road)
    shine = (0.2, 0.8) if kind is Kind.DASHES else (0.8, 0.3)
    return surfaces(rng, 1, kind, (CELL_M, 4.0), *pair, reflectances=shine)
