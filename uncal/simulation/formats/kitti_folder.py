"""Simulated rigs in the layout of KITTI raw: a date folder each."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uncal.errors import RecordingError
from uncal.recordings.sensor_files import write_image
from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.rigid import Matrix, inverse
from uncal.simulation.scene.trajectory import drive_speed, vehicle_pose
from uncal.simulation.scene.triangle_scene import Scene
from uncal.simulation.seeding import Stream, generator
from uncal.simulation.sensors.camera import Camera
from uncal.simulation.sensors.lidar import Lidar
from uncal.simulation.sensors.mount_motion import lidar_motion, write_truth
from uncal.simulation.sensors.rig import Rig, draw_rig, rig_date
from uncal.simulation.settings import SimulationSettings
from uncal.system.disk import disk_trouble

SENSORS = {"image_02": ".png", "velodyne_points": ".bin"}

CALIB_TIME = "01-Jan-2041 00:00:00"

CAMERA_X_M = (0.0, -0.54, None, -0.48)
"""x of camera 0 → camera i, metres; None: the rig's own baseline (camera 2 carries the images)."""


def drive_name(date: str, drive: int) -> str:
    """Folder name of a drive.

    >>> drive_name("2041_01_01", 0)
    '2041_01_01_drive_0001_sync'
    """
    return f"{date}_drive_{drive + 1:04d}_sync"


@dataclass(frozen=True)
class KittiLayout:
    """KITTI raw: a date folder per rig; see :mod:`uncal.simulation.manifest`."""

    settings: SimulationSettings

    def folders(self, rig: int) -> list[str]:
        """The date folder."""
        return [rig_date(rig)]

    def drive_folder(self, rig: int, drive: int) -> Path:
        """Where a drive is, relative to the root."""
        return Path(rig_date(rig)) / drive_name(rig_date(rig), drive)

    def prepare(self, rig: int, partial: Path) -> None:
        """Create the date folder with everything but the frames."""
        folder = partial / rig_date(rig)
        folder.mkdir(parents=True)
        write_calibration(draw_rig(self.settings, rig), self.settings, folder)
        for drive in range(self.settings.drives_per_rig):
            name = partial / self.drive_folder(rig, drive)
            stamps = "".join(self._timestamps(rig, drive))
            # Of inertial data only velocities are simulated, and only where they distort the sweep.
            for sensor in (*SENSORS, "oxts"):
                (name / sensor / "data").mkdir(parents=True)
                (name / sensor / "timestamps.txt").write_text(stamps)
            write_truth(self.settings, rig, drive, name)

    def write(self, piece: Piece, partial: Path) -> None:
        """Simulate a piece's frames into the drive folder."""
        # Workers share the cores already; OpenCV's own threads would only get in their way.
        cv2.setNumThreads(1)
        settings, folder = self.settings, partial / self.drive_folder(piece.rig, piece.drive)
        rig = draw_rig(settings, piece.rig)
        street, scene = build_scene(settings, piece)
        camera = Camera(settings.camera, rig.K)
        lidar = Lidar(settings.lidar, rig.elevations, rig.range_bias, rig.gain)
        for frame in range(piece.first, piece.last):
            key = (piece.rig, piece.drive, frame)
            T_world_lidar = vehicle_pose(settings, street, *key) @ rig.T_vehicle_lidar
            light_rng = generator(settings.seed, Stream.CAMERA, *key)
            T_world_cam = T_world_lidar @ inverse(rig.T_cam_lidar)
            image = camera.photograph(scene, T_world_cam, light_rng)
            points, velocity = self.sweep(scene, lidar, T_world_lidar, key)
            picture = folder / "image_02" / "data" / f"{frame:010d}.png"
            try:
                write_image(picture, image)
                (folder / scan_file(frame)).write_bytes(points.tobytes())
                if settings.lidar.motion_distortion:
                    motion = folder / "oxts" / "data" / f"{frame:010d}.txt"
                    motion.write_text(_oxts_line(T_world_lidar[:3, :3].T @ velocity))
            except OSError as error:
                raise RecordingError(
                    disk_trouble(error) or f"{picture} or its scan could not be written ({error})"
                ) from error

    def sweep(
        self, scene: Scene, lidar: Lidar, T_world_lidar: Matrix, key: tuple[int, int, int]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """(N, 4) points of the frame ``key`` (rig, drive, frame), and the (3,) world velocity."""
        velocity = drive_speed(self.settings, *key[:2]) * T_world_lidar[:3, 0]
        rng = generator(self.settings.seed, Stream.LIDAR, *key)
        moved = T_world_lidar @ lidar_motion(self.settings, *key)
        return lidar.sweep(scene, moved, rng, velocity=velocity), velocity

    def finish(self, rig: int, partial: Path) -> None:
        """Nothing: every frame has files of its own."""

    def is_complete(self, rig: int, root: Path) -> bool:
        """Whether the date folder holds as many files as it should; contents are not read."""
        for drive in range(self.settings.drives_per_rig):
            for sensor, suffix in SENSORS.items():
                data = root / self.drive_folder(rig, drive) / sensor / "data"
                n = sum(f.suffix == suffix for f in data.iterdir()) if data.is_dir() else 0
                if n != self.settings.frames_per_drive:
                    return False
        return (root / rig_date(rig) / "calib_velo_to_cam.txt").is_file()

    def _timestamps(self, rig: int, drive: int) -> Iterator[str]:
        """KITTI's timestamp lines (nanoseconds); drives begin an hour apart, from 08:00 on."""
        begin = datetime.datetime.strptime(rig_date(rig), "%Y_%m_%d")
        begin += datetime.timedelta(hours=8 + drive)
        vehicle = self.settings.vehicle
        interval = vehicle.frame_interval_s
        if vehicle.speed_mps > 0:
            interval *= vehicle.speed_mps / drive_speed(self.settings, rig, drive)
        for frame in range(self.settings.frames_per_drive):
            time = begin + datetime.timedelta(seconds=frame * interval)
            yield f"{time:%Y-%m-%d %H:%M:%S.%f}000\n"


def scan_file(frame: int) -> Path:
    """Where a frame's scan is in its drive's folder."""
    return Path("velodyne_points") / "data" / f"{frame:010d}.bin"


def _oxts_line(velocity: NDArray[np.float64]) -> str:
    """The 30 numbers of an ``oxts`` file: (3,) velocity forward, leftward, upward, and zeros."""
    fields = np.zeros(30)
    fields[8:11] = velocity
    return " ".join(f"{value:.6g}" for value in fields) + "\n"


def _line(key: str, values: Iterable[float]) -> str:
    """``key: v v v`` with more digits than KITTI's, so that nothing is lost by rounding."""
    return f"{key}: {' '.join(f'{value:.12e}' for value in values)}\n"


def write_calibration(rig: Rig, settings: SimulationSettings, folder: Path) -> None:
    """Write ``calib_cam_to_cam.txt``, ``calib_velo_to_cam.txt`` and ``calib_imu_to_velo.txt``.

    The chain that a reader must follow, T_cam_lidar = T2 · R_rect_00 · T_velo_to_cam with
    T2[0, 3] = P_rect_02[0, 3] / P_rect_02[0, 0], gives the rig's true extrinsic. Only camera 2 is
    simulated; the other three cameras have plausible entries because readers look for them.
    """
    size = (float(settings.camera.width), float(settings.camera.height))
    head = f"calib_time: {CALIB_TIME}\n"
    text = head + _line("corner_dist", [0.1])
    for camera, x in enumerate(CAMERA_X_M):
        x_m = rig.baseline_m if x is None else x
        projection = np.hstack([rig.K, np.zeros((3, 1))])
        projection[0, 3] = rig.K[0, 0] * x_m
        text += _line(f"S_{camera:02d}", size)
        text += _line(f"K_{camera:02d}", rig.K.ravel())
        text += _line(f"D_{camera:02d}", np.zeros(5))
        text += _line(f"R_{camera:02d}", np.eye(3).ravel())
        text += _line(f"T_{camera:02d}", rig.R_rect.T @ [x_m, 0.0, 0.0])
        text += _line(f"S_rect_{camera:02d}", size)
        text += _line(f"R_rect_{camera:02d}", rig.R_rect.ravel())
        text += _line(f"P_rect_{camera:02d}", projection.ravel())
    (folder / "calib_cam_to_cam.txt").write_text(text)
    lidar = rig.T_cam0_lidar
    text = head + _line("R", lidar[:3, :3].ravel()) + _line("T", lidar[:3, 3])
    text += _line("delta_f", np.zeros(2)) + _line("delta_c", np.zeros(2))
    (folder / "calib_velo_to_cam.txt").write_text(text)
    text = head + _line("R", np.eye(3).ravel()) + _line("T", [-0.8, 0.3, -0.8])
    (folder / "calib_imu_to_velo.txt").write_text(text)
