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
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import RecordingError
from uncal.recordings.calibration_files import raw_calibration, read_calibration_file
from uncal.recordings.folder_listing import (
    DATE,
    choose,
    contents,
    existing,
    list_numbered,
    one_of,
    subfolders,
)
from uncal.recordings.folder_recording import DriveFolder, FolderRecording
from uncal.recordings.motion import read_oxts
from uncal.recordings.sensor_files import read_clock_times

CAMERAS: tuple[str, ...] = ("image_00", "image_01", "image_02", "image_03")
"""The camera folders of KITTI raw, in the order of their numbers in the calibration files."""

_DRIVE = re.compile(r"(\d{4}_\d{2}_\d{2})_drive_(\d+)_sync")

_REMEDY = """\
Expected the KITTI raw layout:
  {root}/2011_09_26/calib_cam_to_cam.txt and calib_velo_to_cam.txt
  {root}/2011_09_26/2011_09_26_drive_0001_sync/image_02/data/0000000000.png
  {root}/2011_09_26/2011_09_26_drive_0001_sync/velodyne_points/data/0000000000.bin
Get the synced+rectified drives and their calibration from \
https://www.cvlibs.net/datasets/kitti/raw_data.php, or write a simulated stand-in:
  python -m uncal.simulate root={root}"""


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
        number = CAMERAS.index(one_of(camera, CAMERAS, "camera"))
        root = existing(root, _REMEDY)
        folders = [root / name[:10] / name for name in choose(find_drives(root), drives, "drives")]
        dates = dict.fromkeys(folder.parent for folder in folders)
        calibrations = {date: raw_calibration(date, number) for date in dates}
        super().__init__(
            (
                DriveFolder(
                    rig=folder.parent.name,
                    drive=folder.name,
                    image_folder=folder / camera / "data",
                    images=list_numbered(folder / camera / "data", 10, ".png"),
                    scan_folder=folder / "velodyne_points" / "data",
                    scans=list_numbered(folder / "velodyne_points" / "data", 10, ".bin"),
                    calibration=calibrations[folder.parent],
                    times=partial(read_clock_times, folder / camera / "timestamps.txt"),
                    recorded_twist=_recorded_twist(folder) if untwist else None,
                    distorted=untwist,
                )
                for folder in folders
            ),
            stride,
        )


def _recorded_twist(drive: Path) -> Callable[[int], NDArray[np.float64]] | None:
    """What reads the OXTS files; None where a drive has none."""
    folder = drive / "oxts" / "data"
    if not list_numbered(folder, 10, ".txt"):
        return None
    path, R_lidar_imu = drive.parent / "calib_imu_to_velo.txt", np.eye(3)
    if path.is_file():
        R_lidar_imu = read_calibration_file(path)["R"]
    return partial(_read_twist, folder, R_lidar_imu)


def _read_twist(folder: Path, R_lidar_imu: NDArray[np.float64], index: int) -> NDArray[np.float64]:
    return read_oxts(folder / f"{index:010d}.txt", R_lidar_imu)


def find_drives(root: Path) -> dict[str, list[str]]:
    """Drive folders under ``root``, sorted → the names that a user may write for them."""
    names = subfolders(existing(root, _REMEDY))
    dates = [name for name in names if DATE.fullmatch(name)]
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
    inside, missing = root, "date folder such as 2011_09_26"
    if dates:
        inside, missing = root / dates[0], "drive folder such as 2011_09_26_drive_0001_sync"
    raise RecordingError(
        f"{inside} holds no {missing}; found {contents(inside)}. {_REMEDY.format(root=root)}"
    )
