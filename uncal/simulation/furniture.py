"""What stands on the street and its pavements: cars, poles, trees, people, clutter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.meshes import Array, Mesh, Surfaces, blobs, boxes, prisms, rotate
from uncal.simulation.palette import colours, surfaces
from uncal.simulation.settings import SceneSettings
from uncal.simulation.street import Street
from uncal.simulation.textures import Kind

PARKING_SLOT_M = 6.4
Points = NDArray[np.float64]


def add_furniture(
    mesh: Mesh,
    street: Street,
    scene: SceneSettings,
    rng: np.random.Generator,
    driven: tuple[float, float],
) -> None:
    """Add everything loose; nothing stands in the own lane where the vehicle drives.

    Args:
        mesh: receives the triangles.
        street: the street.
        scene: densities.
        rng: source of randomness.
        driven: first and last s of the vehicle's own path.
    """
    _add_cars(mesh, rng, *_parked(street, scene, rng))
    _add_cars(mesh, rng, *_moving(street, scene, rng, driven))
    _add_poles(mesh, street, scene, rng)
    _add_trees(mesh, street, scene, rng)
    _add_people(mesh, street, scene, rng)
    _add_clutter(mesh, street, scene, rng)


def _how_many(rng: np.random.Generator, street: Street, per_100m: float) -> int:
    return int(rng.poisson(per_100m * street.length / 100))


def _on_pavement(
    street: Street, rng: np.random.Generator, n: int, low: float, high: float
) -> tuple[Points, Points]:
    """World positions and headings of n objects on either pavement.

    ``low`` and ``high`` are fractions of the pavement's width, from the kerb outwards.
    """
    s = rng.uniform(street.start, street.end, n)
    s = s[~street.in_crossing(s, 0.5)]
    n = len(s)
    side = rng.choice([-1.0, 1.0], n)
    y = side * (street.kerb_y + 0.25 + rng.uniform(low, high, n) * (street.pavement_m - 0.4))
    return street.world(np.stack([s, y, np.full(n, street.kerb_m)], -1)), street.heading(s)


def _box(
    mesh: Mesh,
    base: Points,
    size: Points,
    yaw: Points,
    look: Surfaces,
    rng: np.random.Generator,
    taper: NDArray[np.float64] | float = 1.0,
    top: Surfaces | None = None,
) -> None:
    sides, side_extent, ends, end_extent = boxes(base, size, yaw, taper)
    mesh.add(sides, side_extent, look, rng)
    mesh.add(ends, end_extent, top or look, rng)


def _parked(
    street: Street, scene: SceneSettings, rng: np.random.Generator
) -> tuple[Points, Points]:
    slots = np.arange(street.start, street.end, PARKING_SLOT_M)
    share = scene.parked_cars_per_100m * PARKING_SLOT_M / 200
    s, side = (grid.ravel() for grid in np.meshgrid(slots, [-1.0, 1.0]))
    keep = (rng.random(len(s)) < share) & ~street.in_crossing(s, 4.0)
    s, side = s[keep] + rng.uniform(-0.5, 0.5, keep.sum()), side[keep]
    on_road = street.parking_m > 0
    y = side * (street.kerb_y + (-1.1 if on_road else 1.2))
    z = np.full(len(s), 0.0 if on_road else street.kerb_m)
    yaw = street.heading(s) + np.pi * (rng.random(len(s)) < 0.4)
    yaw = yaw + np.deg2rad(rng.normal(0, 2, len(s)))
    return street.world(np.stack([s, y, z], -1)), yaw


def _moving(
    street: Street, scene: SceneSettings, rng: np.random.Generator, driven: tuple[float, float]
) -> tuple[Points, Points]:
    slots = np.arange(street.start + 5, street.end, 12.0)
    s, lane = (grid.ravel() for grid in np.meshgrid(slots, [-1.0, 1.0]))
    keep = rng.random(len(s)) < scene.moving_cars_per_100m * 12.0 / 200
    keep &= (lane > 0) | (s > driven[1] + 8) | (s < driven[0] - 8)
    s, lane = s[keep] + rng.uniform(-2, 2, keep.sum()), lane[keep]
    y = lane * (street.lane_m / 2 + rng.uniform(-0.3, 0.4, len(s)))
    yaw = street.heading(s) + np.where(lane > 0, np.pi, 0.0)
    return street.world(np.stack([s, y, 0 * s], -1)), yaw


def _add_cars(mesh: Mesh, rng: np.random.Generator, base: Points, yaw: Points) -> None:
    """Cars and vans: body, cabin, wheels, lamps and plates."""
    n = len(base)
    van = rng.random(n) < 0.2
    length = np.where(van, rng.uniform(4.8, 6.2, n), rng.uniform(3.5, 4.9, n))
    width = np.where(van, rng.uniform(1.9, 2.15, n), rng.uniform(1.6, 1.9, n))
    clearance = rng.uniform(0.18, 0.3, n)
    body = np.where(van, rng.uniform(1.5, 2.3, n), rng.uniform(0.5, 0.75, n))
    paint = colours(rng, n, (0.02, 0.85), (0.0, 0.9))
    neutral = rng.random(n) < 0.5
    paint[neutral] = colours(rng, int(neutral.sum()), (0.02, 0.85), (0.0, 0.05))
    enamel = surfaces(rng, n, Kind.PLAIN, 3.0, paint)
    glass = colours(rng, n, (0.01, 0.08), (0.0, 0.4))
    glazed = surfaces(rng, n, Kind.GLAZING, (2.2, 0.65), paint, glass, (None, 0.05), fit=True)

    def part(offset: list[Points | float], size: list[Points | float]) -> tuple[Points, Points]:
        shift = np.stack([np.broadcast_to(o, n) for o in offset], -1)
        return base + rotate(shift, yaw), np.stack([np.broadcast_to(o, n) for o in size], -1)

    at, size = part([0.0, 0.0, clearance], [length, width, body])
    _box(mesh, at, size, yaw, enamel, rng, np.array([0.97, 0.93]))
    cabin = length * rng.uniform(0.45, 0.7, n)
    rear = -0.06 * length
    at, size = part([rear, 0.0, clearance + body], [cabin, 0.9 * width, rng.uniform(0.5, 0.65, n)])
    saloon = np.flatnonzero(~van)
    taper = np.stack([rng.uniform(0.55, 0.85, n), rng.uniform(0.8, 0.9, n)], -1)
    _box(
        mesh,
        at[saloon],
        size[saloon],
        yaw[saloon],
        glazed[saloon],
        rng,
        taper[saloon],
        enamel[saloon],
    )
    screen = np.flatnonzero(van)
    at, size = part([0.46 * length, 0.0, clearance + 0.5 * body], [0.09 * length, 0.86 * width, 0.6])
    _box(mesh, at[screen], size[screen], yaw[screen], glazed[screen], rng)
    rubber = surfaces(rng, n, Kind.PLAIN, 1.0, colours(rng, n, (0.01, 0.06), (0.0, 0.1)))
    for where in (-0.31, 0.31):
        at, size = part([where * length, 0.0, 0.0], [0.6, width + 0.03, 0.6])
        _box(mesh, at, size, yaw, rubber, rng)
    red = surfaces(rng, n, Kind.PLAIN, 1.0, colours(rng, n, (0.3, 0.7), (0.8, 1.0), (0.0, 0.03)))
    white = colours(rng, n, (0.7, 0.95), (0.0, 0.1))
    lamp = surfaces(rng, n, Kind.PLAIN, 1.0, white, reflectances=(0.9, 0.9))
    height = clearance + 0.45 * np.minimum(body, 0.8)
    for across in (-0.36, 0.36):
        at, size = part([-0.5 * length, across * width, height], [0.06, 0.3, 0.16])
        _box(mesh, at, size, yaw, red, rng)
        at, size = part([0.49 * length, across * width, height], [0.06, 0.35, 0.14])
        _box(mesh, at, size, yaw, lamp, rng)
    at, size = part([-0.5 * length, 0.0, height], [0.04, 0.5, 0.12])
    _box(mesh, at, size, yaw, lamp, rng)


def _add_poles(mesh: Mesh, street: Street, scene: SceneSettings, rng: np.random.Generator) -> None:
    """Lamp posts, signs and signals."""
    n = _how_many(rng, street, scene.poles_per_100m)
    base, yaw = _on_pavement(street, rng, n, 0.0, 0.25)
    n = len(base)
    radius = rng.uniform(0.035, 0.13, n)
    height = rng.uniform(2.2, 9.0, n)
    metal = surfaces(rng, n, Kind.PLAIN, 2.0, colours(rng, n, (0.03, 0.8), (0.0, 0.4)))
    lean = rng.normal(0, 0.02, (n, 2)) * height[:, None]
    mesh.add(*prisms(base, radius, height, lean, 6), metal, rng)
    top = base + np.concatenate([lean, height[:, None]], 1)

    board = np.flatnonzero(height < 5)
    k = len(board)
    size = np.stack([np.full(k, 0.06), rng.uniform(0.4, 1.4, k), rng.uniform(0.4, 1.2, k)], -1)
    bright = colours(rng, k, (0.6, 0.95), (0.0, 0.3))
    strong = colours(rng, k, (0.05, 0.6), (0.6, 1.0))
    sign = surfaces(rng, k, Kind.SIGN, (1.0, 1.0), bright, strong, (1.0, 0.8), fit=True)
    turned = yaw[board] + rng.normal(0, 0.4, k)
    _box(mesh, top[board] - [0.0, 0.0, 0.4], size, turned, sign, rng)

    arm = np.flatnonzero(height >= 5)
    k = len(arm)
    reach = rng.uniform(0.8, 2.5, k)
    inward = np.where(base[arm, 1] > street.lateral(base[arm, 0]), -1.0, 1.0)
    middle = top[arm] + np.stack([0 * reach, inward * reach / 2, 0 * reach - 0.1], -1)
    size = np.stack([np.full(k, 0.09), reach, np.full(k, 0.09)], -1)
    _box(mesh, middle, size, yaw[arm], metal[arm], rng)
    head = top[arm] + np.stack([0 * reach, inward * reach, 0 * reach - 0.2], -1)
    dark = surfaces(rng, k, (Kind.PLAIN, Kind.SIGN), 0.8, colours(rng, k, (0.02, 0.7)))
    _box(mesh, head, rng.uniform([0.3, 0.2, 0.12], [0.6, 0.6, 0.9], (k, 3)), yaw[arm], dark, rng)


def _add_trees(mesh: Mesh, street: Street, scene: SceneSettings, rng: np.random.Generator) -> None:
    """Trunks with crowns of a few dented ellipsoids."""
    n = _how_many(rng, street, scene.trees_per_100m)
    base, _ = _on_pavement(street, rng, n, 0.1, 0.8)
    n = len(base)
    trunk = rng.uniform(1.8, 4.0, n)
    bark = surfaces(
        rng, n, (Kind.ROUGH, Kind.LEAVES), 1.0, colours(rng, n, (0.05, 0.35), (0.1, 0.5), (0, 0.1))
    )
    lean = rng.normal(0, 0.06, (n, 2)) * trunk[:, None]
    mesh.add(*prisms(base, rng.uniform(0.07, 0.25, n), trunk + 0.5, lean, 6), bark, rng)
    crown = np.repeat(np.arange(n), 4)
    radius = rng.uniform(0.5, 1.5, n)[crown] * rng.uniform(0.6, 1.2, len(crown))
    centre = base[crown] + rng.normal(0, 0.6, (len(crown), 3)) * radius[:, None]
    centre[:, 2] = base[crown, 2] + trunk[crown] + radius * rng.uniform(0.4, 1.6, len(crown))
    stretch = rng.uniform(0.7, 1.3, (len(crown), 3))
    triangles, uv = blobs(centre, radius[:, None] * stretch, 0.14, rng)
    leaf = colours(rng, n, (0.06, 0.4), (0.3, 0.8), (0.1, 0.38))
    foliage = surfaces(rng, n, Kind.LEAVES, 2.0, leaf, reflectances=(0.6, 0.3))[crown]
    mesh.add_triangles(triangles, uv / 2.0, foliage)


def _add_people(mesh: Mesh, street: Street, scene: SceneSettings, rng: np.random.Generator) -> None:
    n = _how_many(rng, street, scene.pedestrians_per_100m)
    base, _ = _on_pavement(street, rng, n, 0.1, 0.95)
    n = len(base)
    yaw, scale = rng.uniform(0, 2 * np.pi, n), rng.uniform(0.75, 1.08, n)[:, None]
    for bottom, size, taper, value in (
        (0.0, (0.30, 0.34, 0.85), 1.1, (0.02, 0.4)),
        (0.85, (0.26, 0.48, 0.62), 0.85, (0.03, 0.85)),
    ):
        look = surfaces(rng, n, (Kind.PLAIN, Kind.SLATS), 0.8, colours(rng, n, value, (0.0, 0.9)))
        at = base + np.array([0.0, 0.0, bottom]) * scale
        _box(mesh, at, np.array(size) * scale, yaw, look, rng, taper)
    skin = surfaces(rng, n, Kind.PLAIN, 0.5, colours(rng, n, (0.1, 0.7), (0.2, 0.6), (0.02, 0.08)))
    centre = base + np.array([0.0, 0.0, 1.6]) * scale
    triangles, uv = blobs(centre, np.array([0.1, 0.09, 0.13]) * scale, 0.03, rng)
    mesh.add_triangles(triangles, uv, skin)


def _add_clutter(
    mesh: Mesh, street: Street, scene: SceneSettings, rng: np.random.Generator
) -> None:
    """Boxes and bins anywhere on the pavement; fences, walls and hedges at its outer edge."""
    n = _how_many(rng, street, 0.6 * scene.clutter_per_100m)
    base, yaw = _on_pavement(street, rng, n, 0.0, 1.0)
    n = len(base)
    size = rng.uniform([0.25, 0.25, 0.3], [1.2, 1.0, 1.7], (n, 3))
    paint, other = colours(rng, n, (0.02, 0.9), (0.0, 0.9)), colours(rng, n, (0.02, 0.9), (0, 0.9))
    kinds = (Kind.PLAIN, Kind.SIGN, Kind.SLATS, Kind.ROUGH, Kind.MASONRY)
    look = surfaces(rng, n, kinds, 1.0, paint, other)
    taper = rng.uniform(0.7, 1.0, (n, 2))
    _box(mesh, base, size, yaw + rng.uniform(-0.5, 0.5, n), look, rng, taper)

    n = _how_many(rng, street, 0.4 * scene.clutter_per_100m)
    base, yaw = _on_pavement(street, rng, n, 0.97, 1.0)
    n = len(base)
    _box(mesh, base, _long(rng, n), yaw, _barriers(rng, n), rng)


def _long(rng: np.random.Generator, n: int) -> Array:
    size = rng.uniform([2.0, 0.05, 0.5], [9.0, 0.6, 1.9], (n, 3))
    return size.astype(np.float32)


def _barriers(rng: np.random.Generator, n: int) -> Surfaces:
    green = colours(rng, n, (0.05, 0.3), (0.3, 0.8), (0.15, 0.38))
    hedge = surfaces(rng, n, Kind.LEAVES, 1.5, green, reflectances=(0.6, 0.3))
    dull, other = colours(rng, n, (0.05, 0.8), (0.0, 0.5)), colours(rng, n, (0.02, 0.5), (0.0, 0.5))
    fence = surfaces(rng, n, (Kind.SLATS, Kind.MASONRY), 2.0, dull, other)
    use_hedge = rng.random(n) < 0.4
    return Surfaces(
        np.where(use_hedge, hedge.texture, fence.texture),
        np.where(use_hedge[:, None], hedge.tile, fence.tile),
        np.where(use_hedge[:, None, None], hedge.colours, fence.colours),
        np.where(use_hedge[:, None], hedge.reflectance, fence.reflectance),
        hedge.fit,
    )
