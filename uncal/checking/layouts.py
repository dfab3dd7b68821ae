"""Which layout a folder has, and its drives, each opened by itself so that one hides no other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from uncal.checking.bags import BagRecording
from uncal.errors import RecordingError
from uncal.recordings import dsec_layout, kitti, kitti_odometry
from uncal.recordings.bag_stream import is_bag
from uncal.recordings.calibration_files import read_calibration_file
from uncal.recordings.dsec import Dsec
from uncal.recordings.folder_listing import RIG_FILE, layout_of
from uncal.recordings.frame import Recording
from uncal.recordings.kitti import KittiRaw
from uncal.recordings.kitti_odometry import KittiOdometry
from uncal.recordings.plain_calibration import read_rig
from uncal.recordings.plain_folder import STAMPS, PlainFolder, find_drives
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
        link: reads the (4, 4) transform LiDAR → another frame that the calibration file gives;
            None: that is the extrinsic itself.
        by_number: images and scans are paired by number, and not by time.
    """

    name: str
    open: Callable[[], Recording]
    stamps: Callable[[], Stamps] = field(default=dict)
    link: Callable[[], NDArray[np.float64]] | None = None
    by_number: bool = True


def find_layout(root: Path, camera: str | None) -> tuple[str, list[Drive]]:
    """Name of the layout of a folder, and its drives; camera None: the first, colour first.

    Raises:
        RecordingError: it is none of the layouts.
        ConfigurationError: the layout has no such camera.
    """
    if is_bag(root):
        return "bag", [Drive(root.name, partial(BagRecording, root, camera))]
    layout = layout_of(root, "recordings")
    if layout == "folder":
        return "plain folder", [_plain(root, folder, camera) for folder in find_drives(root)]
    if layout == "kitti":
        return "KITTI raw", [_raw(root, name, camera) for name in kitti.find_drives(root)]
    if layout == "kitti_odometry":
        names = kitti_odometry.find_sequences(root)
        return "KITTI odometry", [_odometry(root, name, camera) for name in names]
    folders = dsec_layout.find_sequences(root).values()
    return "DSEC", [_dsec(root, folder, camera) for folder in folders]


def _raw(root: Path, name: str, camera: str | None) -> Drive:
    folder = root / name[:10] / name
    chosen = camera or _first(folder, ("image_02", "image_03", "image_00", "image_01"))
    files = [folder / sensor / "timestamps.txt" for sensor in (chosen, "velodyne_points")]
    return Drive(
        name,
        partial(KittiRaw, root, chosen, drives=[name]),
        partial(_read_stamps, read_clock_times, files),
        partial(_velo_to_cam, root / name[:10] / "calib_velo_to_cam.txt"),
    )


def _odometry(root: Path, name: str, camera: str | None) -> Drive:
    folder = root / "sequences" / name
    chosen = camera or _first(folder, ("image_2", "image_3", "image_0", "image_1"))
    return Drive(
        name,
        partial(KittiOdometry, root, [name], chosen),
        partial(_read_stamps, read_second_times, [folder / "times.txt"]),
        partial(_Tr, folder / "calib.txt"),
    )


def _dsec(root: Path, folder: dsec_layout.SequenceFolder, side: str | None) -> Drive:
    wanted = (_DSEC_WINDOW_MS, _DSEC_MIN_EVENTS, [folder.name], side or "left")
    link = partial(_from_lidar_camera, folder.cam_to_lidar)
    return Drive(folder.name, partial(Dsec, root, *wanted), link=link)


def _plain(root: Path, folder: Path, camera: str | None) -> Drive:
    name = f"{folder.parent.name}/{folder.name}"
    stamps = partial(_read_stamps, read_second_times, sorted(folder.glob(f"*/{STAMPS}")))
    try:
        by_number = read_rig(folder.parent / RIG_FILE).tolerance_s is None
    except RecordingError:  # said when the drive is opened
        by_number = True
    read = partial(PlainFolder, root, camera, drives=[name])
    return Drive(name, read, stamps, by_number=by_number)


def _velo_to_cam(path: Path) -> NDArray[np.float64]:
    known = read_calibration_file(path)
    return np.vstack([np.column_stack([known["R"], known["T"]]), [0, 0, 0, 1]])


def _Tr(path: Path) -> NDArray[np.float64]:
    return np.vstack([read_calibration_file(path)["Tr"], [0, 0, 0, 1]])


def _from_lidar_camera(path: Path) -> NDArray[np.float64]:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    return np.asarray(np.linalg.inv(np.array(content["T_lidar_camRect1"], dtype=np.float64)))


def _first(folder: Path, cameras: tuple[str, ...]) -> str:
    return next((camera for camera in cameras if (folder / camera).is_dir()), cameras[0])


def _read_stamps(read: Callable[[Path], NDArray[np.float64]], paths: Sequence[Path]) -> Stamps:
    return {str(path): read(path) for path in paths if path.is_file()}
