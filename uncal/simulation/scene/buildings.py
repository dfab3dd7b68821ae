"""Rows of buildings along both sides of the street, and what stands out from their fronts."""

from __future__ import annotations

import numpy as np

from uncal.simulation.scene.meshes import Mesh, Points, Surfaces, rotate
from uncal.simulation.scene.palette import colours, surfaces
from uncal.simulation.scene.street import Street
from uncal.simulation.scene.textures import Kind
from uncal.simulation.settings import SceneSettings

DETAILS_PER_BUILDING = 7
"""Balconies, awnings, ledges, boxes: depth edges inside a front."""


def add_buildings(
    mesh: Mesh, street: Street, scene: SceneSettings, rng: np.random.Generator
) -> None:
    """Add the front rows, taller houses behind them and a closed end of the street."""
    _front_rows(mesh, street, scene, rng)
    _back_rows(mesh, street, scene, rng)
    _street_end(mesh, street, rng)


def _front_rows(mesh: Mesh, street: Street, scene: SceneSettings, rng: np.random.Generator) -> None:
    shape = (2, int(street.length / 6) + 2)
    width = rng.uniform(6, 22, shape)
    has_gap = rng.random(shape) < scene.building_gap_probability
    gap = np.where(has_gap, rng.uniform(1.5, 12, shape), 0.02)
    s = street.start + np.cumsum(width + gap, axis=1) - width / 2
    side = np.broadcast_to(np.array([[-1.0], [1.0]]), shape)
    s, side, width = s.ravel(), side.ravel(), width.ravel()
    keep = (s + width / 2 < street.end) & ~street.in_crossing(s, width / 2 + 1.5)
    n, s, side, width = int(keep.sum()), s[keep], side[keep], width[keep]
    depth = rng.uniform(8, 15, n)
    usual = 6 * rng.uniform(0, 1, 2)[(side > 0).astype(int)] ** 2
    setback = usual + np.where(rng.random(n) < 0.4, rng.uniform(0, 3, n), rng.uniform(0, 0.5, n))
    height = np.clip(scene.building_height_m * rng.lognormal(0, 0.45, n), 2.6, 60.0)
    ground_floor = np.minimum(rng.uniform(2.8, 4.5, n), height)
    y = side * (street.front_y + setback + depth / 2)
    base = street.world(np.stack([s, y, np.full(n, -2.0)], -1))
    yaw = street.heading(s) + np.deg2rad(rng.uniform(-2, 2, n))

    size = np.stack([width, depth, ground_floor + 2.0], -1)
    mesh.add_boxes(base, size, yaw, _walls(rng, n, Kind.SHOPFRONT), rng, _roofs(rng, n))
    upper = np.flatnonzero(height - ground_floor > 1.5)
    step = rng.uniform(-0.3, 0.4, (len(upper), 2))
    size = np.stack([width, depth, height - ground_floor], -1)[upper]
    size[:, :2] += step
    lifted = base[upper] + np.stack([0 * upper, 0 * upper, ground_floor[upper] + 2.0], -1)
    walls = _walls(rng, len(upper), Kind.FACADE)
    mesh.add_boxes(lifted, size, yaw[upper], walls, rng, _roofs(rng, len(upper)))

    pitched = rng.random(n) < 0.5
    roof = np.stack([width + 0.4, depth + 0.6, rng.uniform(1.5, 4, n)], -1)[pitched]
    taper = np.stack([rng.uniform(0.5, 1, n), rng.uniform(0.02, 0.3, n)], -1)[pitched]
    top = (base + np.stack([0 * s, 0 * s, height + 2.0], -1))[pitched]
    tiles = _roofs(rng, n)[pitched]
    mesh.add_boxes(top, roof, yaw[pitched], tiles, rng, taper=taper)
    _details(mesh, rng, base, yaw, width, depth, height, side)


def _details(
    mesh: Mesh,
    rng: np.random.Generator,
    base: Points,
    yaw: Points,
    width: Points,
    depth: Points,
    height: Points,
    side: Points,
) -> None:
    """Boxes on the street fronts and on the roofs."""
    owner = np.repeat(np.arange(len(base)), DETAILS_PER_BUILDING)
    n = len(owner)
    on_roof = rng.random(n) < 0.25
    size = rng.uniform([0.4, 0.3, 0.12], [3.0, 1.4, 1.2], (n, 3))
    along = rng.uniform(-0.5, 0.5, n) * (width[owner] - size[:, 0])
    across = -side[owner] * (depth[owner] + size[:, 1]) / 2
    across = np.where(on_roof, rng.uniform(-0.4, 0.4, n) * depth[owner], across)
    up = 2.0 + rng.uniform(0.25, 0.95, n) * height[owner]
    up = np.where(on_roof, 2.0 + height[owner], up)
    size[:, 2] = np.where(on_roof, rng.uniform(0.5, 3.0, n), size[:, 2])
    offset = rotate(np.stack([along, across, up], -1), yaw[owner])
    paint = colours(rng, n, (0.04, 0.85), (0.0, 0.7))
    look = surfaces(rng, n, (Kind.PLAIN, Kind.SLATS, Kind.SIGN, Kind.ROUGH), 1.5, paint)
    mesh.add_boxes(base[owner] + offset, size, yaw[owner], look, rng)


def _back_rows(mesh: Mesh, street: Street, scene: SceneSettings, rng: np.random.Generator) -> None:
    n = 2 * max(int(street.length / 25), 1)
    s, side = rng.uniform(street.start, street.end, n), np.resize([-1.0, 1.0], n)
    size = rng.uniform([10, 10, 6], [25, 18, 12], (n, 3))
    size[:, 2] += scene.building_height_m * rng.uniform(0.5, 2.5, n)
    y = side * (street.front_y + 30 + rng.uniform(0, 12, n))
    base = street.world(np.stack([s, y, np.full(n, -2.0)], -1))
    yaw = street.heading(s) + np.deg2rad(rng.uniform(-10, 10, n))
    mesh.add_boxes(base, size, yaw, _walls(rng, n, Kind.FACADE), rng, _roofs(rng, n))


def _street_end(mesh: Mesh, street: Street, rng: np.random.Generator) -> None:
    """Houses and hills across the far ends, so that no street runs into the void."""
    n = 28
    outward = np.repeat([-1.0, 1.0], n // 2)
    y = np.tile(np.linspace(-65, 65, n // 2), 2) + rng.uniform(-4, 4, n)
    s = np.where(outward < 0, street.start, street.end) + outward * rng.uniform(12, 30, n)
    size = rng.uniform([8, 8, 5], [15, 14, 26], (n, 3))
    base = street.world(np.stack([s, y, np.full(n, -3.0)], -1))
    yaw = rng.uniform(-0.3, 0.3, n)
    mesh.add_boxes(base, size, yaw, _walls(rng, n, Kind.FACADE), rng, _roofs(rng, n))


def _walls(rng: np.random.Generator, n: int, openings: Kind) -> Surfaces:
    """Walls with windows or shop fronts, now and then blank masonry or render."""
    wall = colours(rng, n, (0.1, 0.85), (0.0, 0.55))
    warm = rng.random(n) < 0.6
    wall[warm] = colours(rng, int(warm.sum()), (0.15, 0.85), (0.05, 0.6), (0.0, 0.15))
    glass = colours(rng, n, (0.01, 0.12), (0.0, 0.5), (0.5, 0.65))
    tile = np.stack([rng.uniform(1.6, 4.5, n), rng.uniform(2.6, 3.6, n)], -1)
    if openings is Kind.SHOPFRONT:
        tile[:, 1] = 5.5
    windows = surfaces(rng, n, openings, tile, wall, glass, (None, 0.04), fit=True)
    blank = surfaces(rng, n, (Kind.MASONRY, Kind.ROUGH, Kind.SLATS), (3.0, 3.0), wall)
    return blank.where(rng.random(n) < 0.2, windows)


def _roofs(rng: np.random.Generator, n: int) -> Surfaces:
    tint = colours(rng, n, (0.06, 0.5), (0.0, 0.6), (0.0, 0.12))
    return surfaces(rng, n, (Kind.ROUGH, Kind.MASONRY), (2.0, 2.0), tint)
