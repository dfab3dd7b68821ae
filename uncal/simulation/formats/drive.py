"""A piece of a drive, and the street that can be seen from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from uncal.simulation.scene.buildings import add_buildings
from uncal.simulation.scene.furniture import add_cars, add_furniture
from uncal.simulation.scene.meshes import Mesh
from uncal.simulation.scene.street import Street, add_ground, draw_street
from uncal.simulation.scene.textures import TextureLibrary, build_library
from uncal.simulation.scene.trajectory import distance_along
from uncal.simulation.scene.triangle_scene import Scene, draw_sky
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.settings import SimulationSettings

BEHIND_M = 25.0
"""Length of street modelled behind a LiDAR that does not look back."""

SEEN_ABREAST_M = 40.0
"""Beyond those, what is kept of the model, so that no front is cut off and the end is closed."""


@dataclass(frozen=True)
class Piece:
    """Consecutive frames of one drive: the unit of work of one process."""

    rig: int
    drive: int  # within the rig
    first: int
    last: int  # one past the last frame


@lru_cache(maxsize=1)
def texture_library(seed: int) -> TextureLibrary:
    """The simulation's textures; one library for all drives, built once per process."""
    return build_library(generator(seed, Stream.TEXTURES))


def build_scene(settings: SimulationSettings, piece: Piece) -> tuple[Street, Scene]:
    """Build the whole drive's street, then keep what can be seen from the piece's frames."""
    limits = settings.scene
    rng = generator(settings.seed, Stream.STREET, piece.rig, piece.drive)
    behind = BEHIND_M if settings.lidar.azimuth_fov_deg <= 180 else settings.lidar.range_max_m
    driven = distance_along(settings, settings.frames_per_drive - 1)
    street = draw_street(limits, rng, -behind, driven + limits.view_m)
    sky = draw_sky(rng)
    mesh = Mesh()
    add_ground(mesh, street, rng)
    add_buildings(mesh, street, limits, rng)
    add_cars(mesh, street, limits, rng, (0.0, driven))
    add_furniture(mesh, street, limits, rng)
    first, last = (distance_along(settings, frame) for frame in (piece.first, piece.last - 1))
    reach = (first - behind - SEEN_ABREAST_M, last + limits.view_m + SEEN_ABREAST_M)
    return street, Scene(mesh, sky, texture_library(settings.seed), reach)
