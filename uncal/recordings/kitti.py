"""The KITTI raw layout (Geiger et al., "Vision meets Robotics", IJRR 2013), synced and rectified.

::

    <root>/2011_09_26/calib_cam_to_cam.txt, calib_velo_to_cam.txt
    <root>/2011_09_26/2011_09_26_drive_0001_sync/
        image_02/data/0000000000.png             image_00, 01 grey; image_02, 03 colour
        image_02/timestamps.txt                  optional
        velodyne_points/data/0000000000.bin      float32 x, y, z, reflectance
        oxts/data/0000000000.txt                 optional: velocities, to undo the sweep's motion
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import ConfigurationError, RecordingError
from uncal.recordings.calibration_files import raw_calibration, read_calibration_file
from uncal.recordings.folder_listing import choose, contents, list_indices, subfolders
from uncal.recordings.folder_recording import DriveFolder, FolderRecording
from uncal.recordings.sensor_files import read_clock_times

CAMERAS: tuple[str, ...] = ("image_00", "image_01", "image_02", "image_03")
"""The camera folders of KITTI raw, in the order of their numbers in the calibration files."""

_DATE = re.compile(r"\d{4}_\d{2}_\d{2}")
_DRIVE = re.compile(r"(\d{4}_\d{2}_\d{2})_drive_(\d+)_sync")


class KittiRaw(FolderRecording):
    """A folder of KITTI raw drives. A date folder is a rig, a ``_sync`` folder a drive.

    Args:
        root: folder of the date folders.
        camera: one of :data:`CAMERAS`.
        stride: keep every ``stride``-th frame of each drive.
        drives: which drives, all if None: folder names (``2011_09_26_drive_0001_sync``), short
            names (``2011_09_26/0001``) or shell patterns of either (``2011_09_26/*``).
        untwist: read the vehicle's motion where a drive has ``oxts``, so that what it does to the
            sweep is undone; see :mod:`uncal.recordings.motion`. A drive without them that has time
            stamps: estimate it from neighbouring sweeps (:mod:`uncal.recordings.scan_motion`).

    Raises:
        RecordingError: the root, the drives, the frames or the calibration are not there.
        ConfigurationError: an unknown camera, a stride below 1, a name that matches no drive.
    """

    def __init__(
        self,
        root: str | Path,
        camera: str = "image_02",
        stride: int = 1,
        drives: Sequence[str] | None = None,
        untwist: bool = True,
    ) -> None:
        """Find the drives and read their calibration; no frame is opened."""
        if camera not in CAMERAS:
            raise ConfigurationError(f"camera is '{camera}', expected one of {', '.join(CAMERAS)}.")
        root = Path(root).expanduser()
        chosen = choose(find_drives(root), drives, "drives")
        number = CAMERAS.index(camera)
        calibrations = {
            date: raw_calibration(root / date, number) for date in dict.fromkeys(map(_date, chosen))
        }
        rotations = {date: _imu_rotation(root / date) for date in calibrations}
        super().__init__(
            (
                DriveFolder(
                    rig=_date(drive),
                    drive=drive,
                    images=root / _date(drive) / drive / camera / "data",
                    scans=root / _date(drive) / drive / "velodyne_points" / "data",
                    digits=10,
                    calibration=calibrations[_date(drive)],
                    times=root / _date(drive) / drive / camera / "timestamps.txt",
                    read_times=read_clock_times,
                    motion=_motion(root / _date(drive) / drive) if untwist else None,
                    R_lidar_imu=rotations[_date(drive)],
                    distorted=untwist,
                )
                for drive in chosen
            ),
            stride,
        )


def _motion(drive: Path) -> Path | None:
    """Folder of the OXTS files; None where a drive has none."""
    folder = drive / "oxts" / "data"
    return folder if list_indices(folder, 10, ".txt") else None


def _imu_rotation(date_folder: Path) -> NDArray[np.float64] | None:
    """(3, 3) IMU → LiDAR; None where the date folder does not say."""
    path = date_folder / "calib_imu_to_velo.txt"
    return read_calibration_file(path)["R"].reshape(3, 3) if path.is_file() else None


def _date(drive: str) -> str:
    return drive[: len("2011_09_26")]


def find_drives(root: Path) -> dict[str, list[str]]:
    """Drive folders under ``root``, sorted → the names that a user may write for them."""
    if not root.is_dir():
        raise RecordingError(f"The recordings folder {root} does not exist. {_remedy(root)}")
    names = subfolders(root)
    dates = [name for name in names if _DATE.fullmatch(name)]
    drives: dict[str, list[str]] = {}
    for date in dates:
        for name in subfolders(root / date):
            match = _DRIVE.fullmatch(name)
            if match and match[1] == date:
                drives[name] = [name, f"{date}/{name}", f"{date}/{match[2]}"]
    if drives:
        return drives
    if any(_DRIVE.fullmatch(name) for name in names):
        raise RecordingError(f"{root} is itself a date folder: give its parent, {root.parent}.")
    if dates:
        inside, missing = root / dates[0], "drive folder such as 2011_09_26_drive_0001_sync"
    else:
        inside, missing = root, "date folder such as 2011_09_26"
    raise RecordingError(f"{inside} holds no {missing}; found {contents(inside)}. {_remedy(root)}")


def _remedy(root: Path) -> str:
    return (
        "Expected the KITTI raw layout:\n"
        f"  {root}/2011_09_26/calib_cam_to_cam.txt and calib_velo_to_cam.txt\n"
        f"  {root}/2011_09_26/2011_09_26_drive_0001_sync/image_02/data/0000000000.png\n"
        f"  {root}/2011_09_26/2011_09_26_drive_0001_sync/velodyne_points/data/0000000000.bin\n"
        "Get the synced+rectified drives and their calibration from "
        "https://www.cvlibs.net/datasets/kitti/raw_data.php, or write a simulated stand-in:\n"
        f"  python -m uncal.simulate root={root}"
    )
