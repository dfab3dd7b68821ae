"""Which layout a folder has, and its drives, each opened by itself so that one hides no other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import RecordingError
from uncal.recordings import dsec_layout, kitti, kitti_odometry
from uncal.recordings.dsec import Dsec
from uncal.recordings.folder_listing import contents
from uncal.recordings.frame import Recording
from uncal.recordings.kitti import KittiRaw
from uncal.recordings.kitti_odometry import KittiOdometry
from uncal.recordings.sensor_files import read_clock_times, read_second_times

Stamps = Mapping[str, NDArray[np.float64]]
"""Name of a file of time stamps → seconds, line by line."""

_DSEC_WINDOW_MS = 50.0
_DSEC_MIN_EVENTS = 100


@dataclass(frozen=True)
class Drive:
    """A drive that may or may not be readable.

    Attributes:
        name: of the drive.
        open: reads its calibration and lists its frames.
        stamps: reads its time stamps.
    """

    name: str
    open: Callable[[], Recording]
    stamps: Callable[[], Stamps] = field(default=dict)


def find_layout(root: Path, camera: str | None) -> tuple[str, list[Drive]]:
    """Recognise a folder.

    Args:
        root: of the recordings.
        camera: which one; None: the first that was recorded, colour before grey.

    Returns:
        Name of the layout and its drives.

    Raises:
        RecordingError: it is none of the layouts.
        ConfigurationError: the layout has no such camera.
    """
    if not root.is_dir():
        raise RecordingError(f"{root} does not exist or is no folder; give a folder of recordings.")
    if (root / "sequences").is_dir():
        return "KITTI odometry", _odometry(root, camera)
    try:
        folders = dsec_layout.find_sequences(root)
        return "DSEC", [_dsec_drive(root, name, camera) for name in folders]
    except RecordingError:
        pass
    try:
        return "KITTI raw", _raw(root, camera)
    except RecordingError as error:
        raise RecordingError(
            f"{root} has none of the known layouts; found {contents(root)}. Expected one of\n"
            "  KITTI raw        <root>/2011_09_26/2011_09_26_drive_0001_sync/…\n"
            "  KITTI odometry   <root>/sequences/00/…\n"
            "  DSEC             <root>/zurich_city_04_a/events/… and <root>/data/zurich_city_04/…\n"
            f"As KITTI raw: {error}"
        ) from error


def _raw(root: Path, camera: str | None) -> list[Drive]:
    drives = []
    for name in kitti.find_drives(root):
        folder = root / name[:10] / name
        chosen = camera or _first(folder, ("image_02", "image_03", "image_00", "image_01"))
        drives.append(
            Drive(
                name,
                partial(KittiRaw, root, chosen, drives=[name]),
                partial(
                    _read_stamps,
                    read_clock_times,
                    {
                        chosen: folder / chosen / "timestamps.txt",
                        "velodyne_points": folder / "velodyne_points" / "timestamps.txt",
                    },
                ),
            )
        )
    return drives


def _odometry(root: Path, camera: str | None) -> list[Drive]:
    drives = []
    for name in kitti_odometry.find_sequences(root):
        folder = root / "sequences" / name
        chosen = camera or _first(folder, ("image_2", "image_3", "image_0", "image_1"))
        open_it = partial(KittiOdometry, root, [name], chosen)
        files = {"times": folder / "times.txt"}
        drives.append(Drive(name, open_it, partial(_read_stamps, read_second_times, files)))
    return drives


def _dsec_drive(root: Path, name: str, side: str | None) -> Drive:
    return Drive(
        name, partial(Dsec, root, _DSEC_WINDOW_MS, _DSEC_MIN_EVENTS, [name], side or "left")
    )


def _first(folder: Path, cameras: tuple[str, ...]) -> str:
    return next((camera for camera in cameras if (folder / camera).is_dir()), cameras[0])


def _read_stamps(read: Callable[[Path], NDArray[np.float64]], files: Mapping[str, Path]) -> Stamps:
    return {str(path): read(path) for path in files.values() if path.is_file()}


