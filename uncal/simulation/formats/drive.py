"""One drive, or a piece of it: build the street, move the vehicle, write the frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2

from uncal.errors import RecordingError
from uncal.recordings.sensor_files import write_image
from uncal.simulation.formats.kitti_motion import oxts_line
from uncal.simulation.rigid import inverse
from uncal.simulation.scene.buildings import add_buildings
from uncal.simulation.scene.cars import add_cars
from uncal.simulation.scene.furniture import add_furniture
from uncal.simulation.scene.meshes import Mesh
from uncal.simulation.scene.sky import draw_sky
from uncal.simulation.scene.street import Street, add_ground, draw_street
from uncal.simulation.scene.textures import TextureLibrary, build_library
from uncal.simulation.scene.trajectory import distance_along, drive_speed, vehicle_pose
from uncal.simulation.scene.triangle_scene import Scene
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.sensors.camera import Camera
from uncal.simulation.sensors.lidar import Lidar
from uncal.simulation.sensors.mount_motion import lidar_motion
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import SimulationSettings
from uncal.system.disk import disk_trouble

BEHIND_M = 25.0
"""Length of street modelled behind a LiDAR that does not look back."""

SEEN_ABREAST_M = 40.0
"""Beyond those, what is kept of the model, so that no front is cut off and the end is closed."""


@dataclass(frozen=True)
class Piece:
    """Consecutive frames of one drive: the unit of work of one process.

    Attributes:
        rig: number of the rig.
        drive: number of the drive within the rig.
        first: first frame.
        last: one past the last frame.
    """

    rig: int
    drive: int
    first: int
    last: int


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


def write_frames(settings: SimulationSettings, piece: Piece, folder: Path) -> int:
    """Simulate the frames of a piece into a drive folder; returns the bytes written.

    Raises:
        RecordingError: a file could not be written.
    """
    # Workers share the cores already; OpenCV's own threads would only get in their way.
    cv2.setNumThreads(1)
    rig = draw_rig(settings, piece.rig)
    street, scene = build_scene(settings, piece)
    camera, lidar = (
        Camera(settings.camera, rig.K),
        Lidar(settings.lidar, rig.elevations, rig.range_bias, rig.gain),
    )
    T_lidar_cam = inverse(rig.T_cam_lidar)
    speed = drive_speed(settings, piece.rig, piece.drive)
    written = 0
    for frame in range(piece.first, piece.last):
        key = (piece.rig, piece.drive, frame)
        T_world_lidar = vehicle_pose(settings, street, *key) @ rig.T_vehicle_lidar
        velocity = speed * T_world_lidar[:3, 0]
        light_rng = generator(settings.seed, Stream.CAMERA, *key)
        image = camera.photograph(scene, T_world_lidar @ T_lidar_cam, light_rng)
        points = lidar.sweep(
            scene,
            T_world_lidar @ lidar_motion(settings, *key),
            generator(settings.seed, Stream.LIDAR, *key),
            velocity=velocity,
        )
        picture = folder / "image_02" / "data" / f"{frame:010d}.png"
        cloud = folder / "velodyne_points" / "data" / f"{frame:010d}.bin"
        motion = folder / "oxts" / "data" / f"{frame:010d}.txt"
        try:
            written += write_image(picture, image) + cloud.write_bytes(points.tobytes())
            if settings.lidar.motion_distortion:
                motion.write_text(oxts_line(T_world_lidar[:3, :3].T @ velocity))
        except OSError as error:
            raise RecordingError(
                disk_trouble(error) or f"{picture} or {cloud.name} could not be written ({error})"
            ) from error
    return written
