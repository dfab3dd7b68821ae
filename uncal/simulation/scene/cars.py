"""Cars and vans, parked along the kerbs and on the road."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.scene.meshes import Mesh, Points, Surfaces, rotate
from uncal.simulation.scene.palette import colours, surfaces
from uncal.simulation.scene.street import Street
from uncal.simulation.scene.textures import Kind
from uncal.simulation.settings import SceneSettings

PARKING_SLOT_M = 6.4
ROAD_SLOT_M = 12.0

CLEAR_M = 8.0
"""Free road before and behind the stretch that the vehicle itself drives."""


def add_cars(
    mesh: Mesh,
    street: Street,
    scene: SceneSettings,
    rng: np.random.Generator,
    driven: tuple[float, float],
) -> None:
    """Add parked cars and others on the road; nothing moves, and the driven lane is free."""
    parked, moving = _parked(street, scene, rng), _moving(street, scene, rng, driven)
    base, yaw = (np.concatenate(pair) for pair in zip(parked, moving, strict=True))
    _add_bodies(mesh, rng, base, yaw)


def _parked(
    street: Street, scene: SceneSettings, rng: np.random.Generator
) -> tuple[Points, Points]:
    """World positions and headings of parked cars; half on the pavement without parking strips."""
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
    """World positions and headings of cars in the lanes."""
    slots = np.arange(street.start + 5, street.end, ROAD_SLOT_M)
    s, lane = (grid.ravel() for grid in np.meshgrid(slots, [-1.0, 1.0]))
    s = s + rng.uniform(-2, 2, len(s))
    keep = rng.random(len(s)) < scene.moving_cars_per_100m * ROAD_SLOT_M / 200
    keep &= (lane > 0) | (s > driven[1] + CLEAR_M) | (s < driven[0] - CLEAR_M)
    s, lane = s[keep], lane[keep]
    y = lane * (street.lane_m / 2 + rng.uniform(-0.3, 0.4, len(s)))
    yaw = street.heading(s) + np.where(lane > 0, np.pi, 0.0)
    return street.world(np.stack([s, y, 0 * s], -1)), yaw


def _add_bodies(mesh: Mesh, rng: np.random.Generator, base: Points, yaw: Points) -> None:
    """Body, cabin or windscreen, wheels, lamps and plates of n cars; a fifth of them vans."""
    n = len(base)
    van = rng.random(n) < 0.2
    length = np.where(van, rng.uniform(4.8, 6.2, n), rng.uniform(3.5, 4.9, n))
    width = np.where(van, rng.uniform(1.9, 2.15, n), rng.uniform(1.6, 1.9, n))
    body = np.where(van, rng.uniform(1.5, 2.3, n), rng.uniform(0.5, 0.75, n))
    clearance = rng.uniform(0.18, 0.3, n)
    rear, lamps = 0.06 * length, clearance + 0.45 * np.minimum(body, 0.8)

    def part(
        forward: Points,
        left: Points | float,
        up: Points | float,
        size: tuple[Points | float, Points | float, Points | float],
        sides: Surfaces,
        ends: Surfaces | None = None,
        taper: Points | float = 1.0,
        of: NDArray[np.bool_] | None = None,
    ) -> None:
        """Add one box to every car, or to those of which ``of`` is true."""
        which = np.flatnonzero(np.ones(n) if of is None else of)
        offset = np.stack(np.broadcast_arrays(forward, left, up), -1)[which]
        extent = np.stack([np.broadcast_to(side, n) for side in size], -1)[which]
        slim = np.broadcast_to(taper, (n, 2))[which]
        at = base[which] + rotate(offset, yaw[which])
        top = None if ends is None else ends[which]
        mesh.add_boxes(at, extent, yaw[which], sides[which], rng, top, slim)

    paint = colours(rng, n, (0.02, 0.85), (0.0, 0.9))
    grey = rng.random(n) < 0.5
    paint[grey] = colours(rng, int(grey.sum()), (0.02, 0.85), (0.0, 0.05))
    enamel = surfaces(rng, n, Kind.PLAIN, 3.0, paint)
    glass = colours(rng, n, (0.01, 0.08), (0.0, 0.4))
    glazed = surfaces(rng, n, Kind.GLAZING, (2.2, 0.65), paint, glass, (None, 0.05), fit=True)
    rubber = surfaces(rng, n, Kind.PLAIN, 1.0, colours(rng, n, (0.01, 0.06), (0.0, 0.1)))
    red = surfaces(rng, n, Kind.PLAIN, 1.0, colours(rng, n, (0.3, 0.7), (0.8, 1.0), (0.0, 0.03)))
    white = colours(rng, n, (0.7, 0.95), (0.0, 0.1))
    lamp = surfaces(rng, n, Kind.PLAIN, 1.0, white, reflectances=(0.9, 0.9))

    part(0 * rear, 0.0, clearance, (length, width, body), enamel, taper=np.array([0.97, 0.93]))
    roof = np.stack([rng.uniform(0.55, 0.85, n), rng.uniform(0.8, 0.9, n)], -1)
    cabin = (length * rng.uniform(0.45, 0.7, n), 0.9 * width, rng.uniform(0.5, 0.65, n))
    part(-rear, 0.0, clearance + body, cabin, glazed, enamel, roof, of=~van)
    screen = (0.09 * length, 0.86 * width, 0.6)
    part(0.46 * length, 0.0, clearance + 0.5 * body, screen, glazed, of=van)
    for where in (-0.31, 0.31):
        part(where * length, 0.0, 0.0, (0.6, width + 0.03, 0.6), rubber)
    for across in (-0.36, 0.36):
        part(-0.5 * length, across * width, lamps, (0.06, 0.3, 0.16), red)
        part(0.49 * length, across * width, lamps, (0.06, 0.35, 0.14), lamp)
    part(-0.5 * length, 0.0, lamps, (0.04, 0.5, 0.12), lamp)
