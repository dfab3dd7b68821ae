"""A rig of one's own, without a standard layout.

::

    <root>/rig.yaml                    cameras, LiDARs, extrinsics; see docs/own-rig.md
    <root>/<drive>/<camera>/*.png      or .jpg
    <root>/<drive>/<lidar>/*.bin       or .npy, .pcd, .ply, .las; see uncal.recordings.point_files
    <root>/<drive>/<sensor>/timestamps.txt    seconds, one a line in the order of the files' names

Several rigs lie side by side: ``<root>/<rig>/rig.yaml`` and so on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import RecordingError
from uncal.recordings.calibration_files import CameraCalibration
from uncal.recordings.folder_listing import RIG_FILE, choose, contents, existing, one_of, subfolders
from uncal.recordings.folder_recording import DriveFolder, FolderRecording
from uncal.recordings.plain_calibration import read_rig
from uncal.recordings.point_files import READERS, read_point_file
from uncal.recordings.sensor_files import read_second_times

IMAGES: tuple[str, ...] = (".png", ".jpg", ".jpeg")

STAMPS = "timestamps.txt"


class PlainFolder(FolderRecording):
    """A plain folder; a frame's number is that of its pair.

    Images of a lens with distortion are undistorted when they are read, and the frame's K is that
    of the undistorted image.

    Args:
        root: folder with ``rig.yaml``, or of such folders.
        camera: name in ``rig.yaml``; None: the first.
        lidar: likewise; None: the first that has an extrinsic to the camera.
        drives: names or shell patterns of drives (or ``rig/drive``); all if None.
        stride: keep every ``stride``-th pair of each drive.

    Raises:
        RecordingError: calibration or frames are not there or wrong.
        ConfigurationError: an unknown name, a stride below 1.
    """

    def __init__(
        self,
        root: str | Path,
        camera: str | None = None,
        lidar: str | None = None,
        drives: Sequence[str] | None = None,
        stride: int = 1,
    ) -> None:
        """Read the calibration and list the drives; no image and no scan is opened."""
        found = find_drives(Path(root).expanduser())
        names = {str(path): [f"{path.parent.name}/{path.name}", path.name] for path in found}
        chosen = choose(names, drives, "drives")
        super().__init__((_drive(Path(folder), camera, lidar) for folder in chosen), stride)


def _drive(folder: Path, camera: str | None, lidar: str | None) -> DriveFolder:
    rig = read_rig(folder.parent / RIG_FILE)
    camera = one_of(camera or next(iter(rig.cameras)), list(rig.cameras), "camera")
    linked = [name for name in rig.lidars if (camera, name) in rig.T_cam_lidar]
    lidar = one_of(lidar or [*linked, *rig.lidars][0], list(rig.lidars), "lidar")
    if (camera, lidar) not in rig.T_cam_lidar:
        raise RecordingError(
            f"{folder.parent / RIG_FILE}: no extrinsics.{camera}.{lidar}; add T_cam_lidar there."
        )
    images = list_files(folder / camera, IMAGES)
    scans = list_files(folder / lidar, tuple(READERS))
    pairs, unpaired = pair(images, scans, rig.tolerance_s)
    scale, brightest = rig.lidars[lidar]
    lens = rig.cameras[camera]
    return DriveFolder(
        rig=rig.name,
        drive=folder.name,
        image_folder=folder / camera,
        images={number: image for number, (image, _) in enumerate(pairs)},
        scan_folder=folder / lidar,
        scans={number: scan for number, (_, scan) in enumerate(pairs)},
        calibration=CameraCalibration(
            lens.K_undistorted, rig.T_cam_lidar[camera, lidar], lens.size
        ),
        times=partial(np.array, [scans[scan] for _, scan in pairs]),
        unpaired=unpaired,
        read_scan=partial(_read_scaled, np.array([scale] * 3 + [1.0 / brightest], np.float32)),
        undistort=lens.undistort,
    )


def _read_scaled(factor: NDArray[np.float32], path: Path) -> tuple[NDArray[np.float32], int]:
    points, n_dropped = read_point_file(path)
    return points * factor, n_dropped


def find_drives(root: Path) -> list[Path]:
    """Drive folders: those beside a ``rig.yaml`` in ``root`` or in a folder of it.

    Raises:
        CalibrationMissing, RecordingError: there is none.
    """
    existing(root, "docs/own-rig.md describes the layout.")
    rigs = [root] if (root / RIG_FILE).is_file() else [root / name for name in subfolders(root)]
    rigs = [rig for rig in rigs if (rig / RIG_FILE).is_file()]
    drives = [rig / name for rig in rigs for name in subfolders(rig) if subfolders(rig / name)]
    if not drives:
        raise RecordingError(
            f"{root} holds no {RIG_FILE} with a folder per drive beside it; found "
            f"{contents(root)}. docs/own-rig.md describes the layout."
        )
    return drives


def list_files(folder: Path, suffixes: tuple[str, ...]) -> dict[str, float]:
    """Names of one sensor's files, in order → their time stamps in seconds, or NaN."""
    if not folder.is_dir():
        return {}
    names = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in suffixes)
    times = read_second_times(folder / STAMPS).tolist()
    return dict(zip(names, [*times, *[float("nan")] * len(names)], strict=False))


def pair(
    images: Mapping[str, float], scans: Mapping[str, float], tolerance_s: float | None
) -> tuple[list[tuple[str, str]], dict[str, str]]:
    """Pair images and scans.

    Args:
        images: file → seconds.
        scans: file → seconds.
        tolerance_s: each scan with the image nearest in time, no further away than this; None: the
            files of the same name.

    Returns:
        Image and scan of each pair, in order of the scans; and the files without a partner → why.
    """
    pairs: list[tuple[str, str]] = []
    alone: dict[str, str] = {}
    if tolerance_s is None:
        image_of = {Path(image).stem: image for image in images}
        scan_of = {Path(scan).stem: scan for scan in scans}
        pairs = [(image_of[Path(s).stem], s) for s in scans if Path(s).stem in image_of]
        alone = {s: f"image missing for {s}" for s in scans if Path(s).stem not in image_of}
        alone |= {i: f"scan missing for {i}" for i in images if Path(i).stem not in scan_of}
        return pairs, alone
    times, names = np.array(list(images.values())), list(images)
    for scan, time in scans.items():
        apart = np.abs(times - time)
        if not np.isfinite(apart).any():
            alone[scan] = f"no image or no time stamps for {scan}"
        elif (nearest := np.nanmin(apart)) <= tolerance_s:
            pairs.append((names[int(np.nanargmin(apart))], scan))
        else:
            alone[scan] = f"nearest image {1000 * nearest:.0f} ms from {scan}"
    return pairs, alone
