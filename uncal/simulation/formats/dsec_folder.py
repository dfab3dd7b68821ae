"""Simulated rigs in the layout of DSEC: every rig one drive, its drives that drive's sequences."""

from __future__ import annotations

import datetime
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uncal.errors import RecordingError
from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.formats.dsec_files import (
    DsecCamera,
    LidarScan,
    write_cam_to_cam,
    write_cam_to_lidar,
    write_events,
    write_lidar_bag,
    write_rectify_map,
)
from uncal.simulation.rigid import inverse
from uncal.simulation.scene.trajectory import pose_around, turn_rates, vehicle_pose
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.sensors.event_camera import EventCamera, LuminanceMeter, SensorEvents
from uncal.simulation.sensors.event_optics import FRAME_SCALE, EventOptics, draw_optics
from uncal.simulation.sensors.lidar import Lidar
from uncal.simulation.sensors.mount_motion import lidar_motion, write_truth
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.settings import EventSettings, SimulationSettings
from uncal.system.disk import disk_trouble

PARTS = "parts"
"""Folder for what the pieces record, until the rig is finished."""

LEAD_US = 10_000
"""A sequence's events begin this long before its first window and end this long after its last."""

FULL_INTENSITY = 255
"""What DSEC's LiDAR reports for a reflectance of 1."""

FIRST_DAY = datetime.date(2001, 1, 1)
"""Long before DSEC was recorded; ROS 1 cannot name a time after 2038."""

FIRST_SEQUENCE_US = 8 * 3600 * 10**6
"""The first sequence of a drive begins at 08:00 UTC."""

SEQUENCE_GAP_US = 10 * 10**6
"""Between the sequences of a drive."""


def events_of(settings: SimulationSettings) -> EventSettings:
    """The settings of the event camera; a ValueError where there is none."""
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


def record(settings: SimulationSettings, piece: Piece) -> dict[str, Any]:
    """Simulate the frames of a piece, with ``settings.events``, one after the other.

    The vehicle drives through the window at constant speed and turn rates; when the window ends,
    it is at the frame's pose and the LiDAR takes its sweep.

    Returns:
        Of the events x, y (uint16, pixels of the sensor), t (int64 microseconds since midnight UTC)
        and p (bool, whether the pixel became brighter), each (n,); of all sweeps points (m, 4)
        float32 x, y, z in metres and reflectance in 0..1, ring (m,) uint16 beams, counted from the
        lowest, and points_per_frame (frames,) int64.
    """
    rig = draw_rig(settings, piece.rig)
    street, scene = build_scene(settings, piece)
    events = events_of(settings)
    size = (settings.camera.height, settings.camera.width)
    optics = draw_optics(settings, piece.rig, rig)
    rays = optics.rays(size, settings.camera.supersampling)
    meter = LuminanceMeter(scene, settings.camera, rays)
    pixels = generator(settings.seed, Stream.EVENT_PIXELS, piece.rig)
    camera = EventCamera(events, size, pixels)
    lidar = Lidar(settings.lidar, rig.elevations, rig.range_bias)
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
        moments = (1e-6 * float(time - end) for time in times)
        poses = (pose_around(settings, T_world_vehicle, rates, moment) for moment in moments)
        light = np.stack([meter.measure(pose @ T_vehicle_cam) for pose in poses])
        seen.append(camera.watch(light, times, generator(settings.seed, Stream.EVENTS, *key)))
        lidar_rng = generator(settings.seed, Stream.LIDAR, *key)
        T_world_lidar = T_world_vehicle @ rig.T_vehicle_lidar
        velocity = settings.vehicle.speed_mps * T_world_lidar[:3, 0]
        moved = T_world_lidar @ lidar_motion(settings, *key)
        sweeps.append(lidar.sweep_with_rings(scene, moved, lidar_rng, velocity))
    return {
        **{name: np.concatenate([getattr(part, name) for part in seen]) for name in "xytp"},
        "points": np.concatenate([points for points, _ in sweeps]),
        "ring": np.concatenate([ring for _, ring in sweeps]),
        "points_per_frame": np.array([len(points) for points, _ in sweeps], np.int64),
    }


def recording_drive(rig: int) -> str:
    """Name of the drive of a rig: the folder of its LiDAR bag.

    >>> recording_drive(7), sequence_name(7, 0)
    ('sim_0007', 'sim_0007_a')
    """
    return f"sim_{rig:04d}"


def sequence_name(rig: int, sequence: int) -> str:
    """Name of a sequence: the drive's and a letter."""
    return f"{recording_drive(rig)}_{chr(ord('a') + sequence)}"


@dataclass(frozen=True)
class DsecLayout:
    """DSEC: a folder per sequence, and one with the LiDAR of the drive they are part of.

    See :mod:`uncal.simulation.manifest`. Sequences of a drive share the rig; each is
    another street.
    """

    settings: SimulationSettings

    def folders(self, rig: int) -> list[str]:
        """The LiDAR's folder first: without a sequence, a reader does not look at it."""
        sequences = range(self.settings.drives_per_rig)
        return [f"data/{recording_drive(rig)}", *(sequence_name(rig, each) for each in sequences)]

    def prepare(self, rig: int, partial: Path) -> None:
        """Create the folder for the parts; all else can wait until processes are at work."""
        (partial / PARTS).mkdir(parents=True)

    def write(self, piece: Piece, partial: Path) -> None:
        """Simulate a piece's frames into a part, to be put together with the others."""
        path = _part(partial, piece.drive, piece.first)
        recorded = record(self.settings, piece)
        try:
            np.savez(path, **recorded)
        except OSError as error:
            raise RecordingError(
                disk_trouble(error) or f"{path} could not be written ({error})"
            ) from error

    def finish(self, rig: int, partial: Path) -> None:
        """Write the calibration, the events of every sequence, and the LiDAR bag of all."""
        optics = draw_optics(self.settings, rig, draw_rig(self.settings, rig))
        rectify_map = optics.rectify_map(self._size)
        lidar, *sequences = (partial / folder for folder in self.folders(rig))
        for sequence, folder in enumerate(sequences):
            for part in ("events/left", "calibration", "images"):
                (folder / part).mkdir(parents=True)
            self._write_events(partial, sequence, folder / "events/left/events.h5")
            write_rectify_map(folder / "events/left/rectify_map.h5", rectify_map)
            self._write_calibration(optics, folder / "calibration")
            # No pictures are simulated, but readers may look for their times.
            times = "".join(f"{time}\n" for time in sweep_times(self.settings, sequence))
            (folder / "images/timestamps.txt").write_text(times)
            write_truth(self.settings, rig, sequence, folder)
        lidar.mkdir(parents=True)
        write_lidar_bag(lidar / "lidar_imu.bag", self._scans(rig, partial))
        write_cam_to_lidar(lidar / "cam_to_lidar.yaml", optics.T_lidar_camRect1)
        shutil.rmtree(partial / PARTS)

    def is_complete(self, rig: int, root: Path) -> bool:
        """Whether every file of the rig is there; contents are not read."""
        lidar, *sequences = (root / folder for folder in self.folders(rig))
        wanted = [lidar / "lidar_imu.bag", lidar / "cam_to_lidar.yaml"]
        for folder in sequences:
            wanted += [folder / f"events/left/{name}.h5" for name in ("events", "rectify_map")]
            wanted += [
                folder / f"calibration/{name}.yaml" for name in ("cam_to_cam", "cam_to_lidar")
            ]
        return all(file.is_file() for file in wanted)

    @property
    def _size(self) -> tuple[int, int]:
        return self.settings.camera.height, self.settings.camera.width

    def _write_calibration(self, optics: EventOptics, folder: Path) -> None:
        cameras = []
        for number, rotation in enumerate(optics.R_rect):
            event = number in (0, 3)
            scale = 1 if event else FRAME_SCALE
            zoom = np.diag([scale, scale, 1.0])
            zoom[:2, 2] = (scale - 1) / 2
            cameras.append(
                DsecCamera(
                    K=zoom @ optics.K,
                    K_rect=zoom @ optics.K_rect,
                    R_rect=rotation,
                    size=(scale * self._size[0], scale * self._size[1]),
                    distortion=optics.distortion if event else (0.0, 0.0, 0.0, 0.0),
                )
            )
        steps = (optics.T_10, optics.T_21, optics.T_32)
        write_cam_to_cam(folder / "cam_to_cam.yaml", cameras, *steps)
        write_cam_to_lidar(folder / "cam_to_lidar.yaml", optics.T_lidar_camRect1)

    def _write_events(self, partial: Path, sequence: int, path: Path) -> None:
        ends = sweep_times(self.settings, sequence)
        begin, end = ends[0] - window_us(self.settings) - LEAD_US, ends[-1] + LEAD_US
        parts = [part for _, part in self._parts(partial, sequence)]
        # One event of pixel (0, 0) at either end: the span of a sequence is known by its events.
        x, y, p = (np.pad(np.concatenate([part[name] for part in parts]), 1) for name in "xyp")
        t = np.concatenate([[begin], *(part["t"] for part in parts), [end]])
        write_events(path, x, y, t - begin, p, int(begin))

    def _scans(self, rig: int, partial: Path) -> Iterator[LidarScan]:
        for sequence in range(self.settings.drives_per_rig):
            times = sweep_times(self.settings, sequence) + midnight_us(rig)
            for first, part in self._parts(partial, sequence):
                ends = np.cumsum(part["points_per_frame"])[:-1]
                sweeps = zip(*(np.split(part[k], ends) for k in ("points", "ring")), strict=True)
                for time, (points, ring) in zip(times[first:], sweeps, strict=False):
                    points[:, 3] *= FULL_INTENSITY
                    # The simulated sweep is taken at one moment.
                    moments = np.zeros(len(points), np.float32)
                    yield LidarScan(int(time) * 1000, points, ring, moments)

    def _parts(self, partial: Path, sequence: int) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
        """The parts of a sequence with their first frames, in order."""
        first = 0
        while first < self.settings.frames_per_drive:
            with np.load(_part(partial, sequence, first)) as file:
                part = dict(file)
            yield first, part
            first += len(part["points_per_frame"])


def _part(partial: Path, sequence: int, first: int) -> Path:
    return partial / PARTS / f"{sequence:02d}_{first:06d}.npz"
