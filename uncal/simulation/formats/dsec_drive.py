"""A piece of a drive with an event camera: clocks, motion through each window, sweeps."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import RecordingError
from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.rigid import inverse
from uncal.simulation.scene.trajectory import pose_around, turn_rates, vehicle_pose
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.sensors.event_camera import EventCamera, SensorEvents
from uncal.simulation.sensors.event_optics import draw_optics
from uncal.simulation.sensors.lidar import Lidar
from uncal.simulation.sensors.luminance import LuminanceMeter
from uncal.simulation.sensors.mount_motion import lidar_motion
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import EventSettings, SimulationSettings
from uncal.system.disk import disk_trouble

FIRST_DAY = datetime.date(2001, 1, 1)
"""Long before DSEC was recorded; ROS 1 cannot name a time after 2038."""

FIRST_SEQUENCE_US = 8 * 3600 * 10**6
"""The first sequence of a drive begins at 08:00 UTC."""

SEQUENCE_GAP_US = 10 * 10**6
"""Between the sequences of a drive."""


def events_of(settings: SimulationSettings) -> EventSettings:
    """The settings of the event camera.

    Raises:
        ValueError: there is none.
    """
    if settings.events is None:
        raise ValueError("simulation.events is missing; an event camera needs it")
    return settings.events


def window_us(settings: SimulationSettings) -> int:
    """Length of the simulated window before each sweep, microseconds."""
    return round(1000 * events_of(settings).window_ms)


def sweep_times(settings: SimulationSettings, sequence: int) -> NDArray[np.int64]:
    """When the sweeps of a sequence are taken, (frames,) microseconds since midnight UTC."""
    interval = 1e6 * settings.vehicle.frame_interval_s
    length = round(settings.frames_per_drive * interval) + SEQUENCE_GAP_US
    frames = np.round(np.arange(settings.frames_per_drive) * interval).astype(np.int64)
    return FIRST_SEQUENCE_US + sequence * length + frames


def midnight_us(rig: int) -> int:
    """UNIX time of the midnight (UTC) that a rig's events count from, microseconds.

    >>> midnight_us(1) - midnight_us(0) == 86_400_000_000
    True
    """
    day = FIRST_DAY + datetime.timedelta(days=rig)
    return (day - datetime.date(1970, 1, 1)).days * 86_400 * 10**6


@dataclass(frozen=True)
class Recorded:
    """What a piece has recorded, frame after frame.

    Attributes:
        x: (n,) uint16 column of the events in the sensor, pixels.
        y: (n,) uint16 row.
        t: (n,) int64 microseconds since midnight UTC.
        p: (n,) bool, whether the pixel became brighter.
        points: (m, 4) float32 of all sweeps: x, y, z in metres and reflectance in 0..1.
        ring: (m,) uint16 beams, counted from the lowest.
        points_per_frame: (frames,) int64.
    """

    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    t: NDArray[np.int64]
    p: NDArray[np.bool_]
    points: NDArray[np.float32]
    ring: NDArray[np.uint16]
    points_per_frame: NDArray[np.int64]

    @classmethod
    def read(cls, path: Path) -> Recorded:
        """Read what :func:`write_part` has written."""
        with np.load(path) as file:
            return cls(**{name: file[name] for name in cls.__dataclass_fields__})


def record(settings: SimulationSettings, piece: Piece) -> Recorded:
    """Simulate the frames of a piece.

    The vehicle drives through the window at constant speed and turn rates; when the window ends,
    it is at the frame's pose and the LiDAR takes its sweep.

    Args:
        settings: the simulation's settings; must have ``events``.
        piece: which frames.
    """
    rig = draw_rig(settings, piece.rig)
    street, scene = build_scene(settings, piece)
    events = events_of(settings)
    size = (settings.camera.height, settings.camera.width)
    optics = draw_optics(settings, piece.rig, rig)
    rays = optics.rays(size, settings.camera.supersampling)
    meter = LuminanceMeter(scene, settings.camera, rays)
    pixels = generator(settings.seed, Stream.EVENT_PIXELS, piece.rig)
    camera, lidar = (
        EventCamera(events, size, pixels),
        Lidar(settings.lidar, rig.elevations, rig.range_bias),
    )
    T_vehicle_cam = rig.T_vehicle_lidar @ inverse(rig.T_cam_lidar)
    ends = sweep_times(settings, piece.drive)
    seen: list[SensorEvents] = []
    sweeps: list[tuple[NDArray[np.float32], NDArray[np.uint16]]] = []
    for frame in range(piece.first, piece.last):
        key = (piece.rig, piece.drive, frame)
        T_world_vehicle = vehicle_pose(settings, street, *key)
        rates = turn_rates(events, generator(settings.seed, Stream.MOTION, *key))
        end = int(ends[frame])
        times = np.linspace(end - window_us(settings), end, events.subframes + 1).astype(np.int64)
        light = np.stack(
            [
                meter.measure(
                    pose_around(settings, T_world_vehicle, rates, 1e-6 * float(time - end))
                    @ T_vehicle_cam
                )
                for time in times
            ]
        )
        seen.append(camera.watch(light, times, generator(settings.seed, Stream.EVENTS, *key)))
        lidar_rng = generator(settings.seed, Stream.LIDAR, *key)
        T_world_lidar = T_world_vehicle @ rig.T_vehicle_lidar
        sweeps.append(
            lidar.sweep_with_rings(
                scene,
                T_world_lidar @ lidar_motion(settings, *key),
                lidar_rng,
                velocity=settings.vehicle.speed_mps * T_world_lidar[:3, 0],
            )
        )
    return Recorded(
        x=np.concatenate([part.x for part in seen]),
        y=np.concatenate([part.y for part in seen]),
        t=np.concatenate([part.t for part in seen]),
        p=np.concatenate([part.p for part in seen]),
        points=np.concatenate([points for points, _ in sweeps]),
        ring=np.concatenate([ring for _, ring in sweeps]),
        points_per_frame=np.array([len(points) for points, _ in sweeps], np.int64),
    )


def write_part(settings: SimulationSettings, piece: Piece, path: Path) -> int:
    """Simulate the frames of a piece into one file, to be put together with the others.

    Args:
        settings: the simulation's settings; must have ``events``.
        piece: which frames.
        path: the ``.npz`` file; its folder must exist.

    Returns:
        Bytes written.

    Raises:
        RecordingError: the file could not be written.
    """
    recorded = record(settings, piece)
    try:
        np.savez(path, **{name: getattr(recorded, name) for name in recorded.__dataclass_fields__})
    except OSError as error:
        raise RecordingError(
            disk_trouble(error) or f"{path} could not be written ({error})"
        ) from error
    return path.stat().st_size
