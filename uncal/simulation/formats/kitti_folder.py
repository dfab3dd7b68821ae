"""Names, timestamps and completeness of a simulated date folder in the KITTI raw layout."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from uncal.simulation.formats.drive import Piece, write_frames
from uncal.simulation.formats.kitti_calibration import write_calibration
from uncal.simulation.scene.trajectory import drive_speed
from uncal.simulation.sensors.mount_motion import write_truth
from uncal.simulation.sensors.rig import draw_rig, rig_date
from uncal.simulation.settings import SimulationSettings

SENSORS = {"image_02": ".png", "velodyne_points": ".bin"}


def drive_name(date: str, drive: int) -> str:
    """Folder name of a drive.

    >>> drive_name("2041_01_01", 0)
    '2041_01_01_drive_0001_sync'
    """
    return f"{date}_drive_{drive + 1:04d}_sync"


def timestamps(date: str, rig: int, drive: int, settings: SimulationSettings) -> Iterator[str]:
    """KITTI's timestamp lines (nanoseconds); drives begin an hour apart, from 08:00 on."""
    begin = datetime.datetime.strptime(date, "%Y_%m_%d") + datetime.timedelta(hours=8 + drive)
    vehicle = settings.vehicle
    interval = vehicle.frame_interval_s
    if vehicle.speed_mps > 0:
        interval *= vehicle.speed_mps / drive_speed(settings, rig, drive)
    for frame in range(settings.frames_per_drive):
        time = begin + datetime.timedelta(seconds=frame * interval)
        yield f"{time:%Y-%m-%d %H:%M:%S.%f}000\n"


def prepare_date_folder(settings: SimulationSettings, index: int, folder: Path) -> None:
    """Create a date folder with everything but the frames.

    Args:
        settings: the simulation's settings.
        index: number of the rig.
        folder: must not exist yet; its name does not matter.
    """
    folder.mkdir(parents=True)
    rig = draw_rig(settings, index)
    write_calibration(rig, settings, folder)
    for drive in range(settings.drives_per_rig):
        name = folder / drive_name(rig.date, drive)
        stamps = "".join(timestamps(rig.date, index, drive, settings))
        # Of inertial data only velocities are simulated, and only where they distort the sweep.
        for sensor in (*SENSORS, "oxts"):
            (name / sensor / "data").mkdir(parents=True)
            (name / sensor / "timestamps.txt").write_text(stamps)
        write_truth(settings, index, drive, name)


def is_complete(settings: SimulationSettings, folder: Path, date: str) -> bool:
    """Whether a date folder holds as many files as it should; contents are not read."""
    for drive in range(settings.drives_per_rig):
        for sensor, suffix in SENSORS.items():
            data = folder / drive_name(date, drive) / sensor / "data"
            if not data.is_dir():
                return False
            if sum(f.suffix == suffix for f in data.iterdir()) != settings.frames_per_drive:
                return False
    return (folder / "calib_velo_to_cam.txt").is_file()


@dataclass(frozen=True)
class KittiLayout:
    """KITTI raw: a date folder per rig; see :class:`uncal.simulation.formats.layouts.Layout`.

    Attributes:
        settings: the simulation's settings.
    """

    settings: SimulationSettings

    def folders(self, rig: int) -> list[str]:
        """The date folder."""
        return [rig_date(rig)]

    def prepare(self, rig: int, partial: Path) -> None:
        """Create the date folder with everything but the frames."""
        prepare_date_folder(self.settings, rig, partial / rig_date(rig))

    def write(self, piece: Piece, partial: Path) -> int:
        """Simulate a piece's frames into the drive folder."""
        date = rig_date(piece.rig)
        return write_frames(self.settings, piece, partial / date / drive_name(date, piece.drive))

    def finish(self, rig: int, partial: Path) -> None:
        """Nothing: every frame has files of its own."""

    def is_complete(self, rig: int, root: Path) -> bool:
        """Whether the date folder holds as many files as it should; contents are not read."""
        return is_complete(self.settings, root / rig_date(rig), rig_date(rig))
