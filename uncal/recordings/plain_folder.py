"""A rig of one's own, without a standard layout.

::

    <root>/rig.yaml                    cameras, LiDARs, extrinsics; see docs/own-rig.md
    <root>/<drive>/<camera>/*.png      or .jpg
    <root>/<drive>/<lidar>/*.bin       or .npy, .pcd, .ply, .las; see uncal.recordings.point_files
    <root>/<drive>/<sensor>/timestamps.txt    seconds, one a line in the order of the files' names

Several rigs lie side by side: ``<root>/<rig>/rig.yaml`` and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import ConfigurationError, FrameError, NothingPaired, RecordingError
from uncal.recordings.calibration_files import CameraCalibration
from uncal.recordings.folder_listing import choose, contents, subfolders
from uncal.recordings.frame import Frame, FrameId
from uncal.recordings.image_sizes import usual_size
from uncal.recordings.plain_calibration import FILE, Lens, Rig, read_rig
from uncal.recordings.point_files import READERS, read_point_file
from uncal.recordings.sensor_files import read_image, read_second_times

IMAGES: tuple[str, ...] = (".png", ".jpg", ".jpeg")

STAMPS = "timestamps.txt"


@dataclass(frozen=True)
class _Drive:
    """One drive seen by one camera and one LiDAR; ``pairs`` are image, scan, time."""

    lens: Lens
    scale: float
    brightest: float
    T_cam_lidar: NDArray[np.float64]
    size: tuple[int, int] | None
    pairs: dict[int, tuple[Path, Path, float]]


class PlainFolder:
    """A plain folder; implements :class:`~uncal.recordings.frame.Recording`.

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

    Attributes:
        frame_ids: every frame with an image and a scan, drive by drive.
        skipped: what lacks its other half → which.
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
        if stride < 1:
            raise ConfigurationError(f"stride is {stride}, expected at least 1 (every frame).")
        self.frame_ids: list[FrameId] = []
        self.skipped: dict[str, str] = {}
        self._drives: dict[tuple[str, str], _Drive] = {}
        found = find_drives(Path(root).expanduser())
        names = {f"{folder.parent}/{folder.name}": [f"{folder.parent.name}/{folder.name}",
                 folder.name] for folder in found}  # fmt: skip
        for path in choose(names, drives, "drives"):
            folder = Path(path)
            rig = read_rig(folder.parent / FILE)
            self._add(folder, rig, camera, lidar, stride)
        if not self.frame_ids:
            raise NothingPaired(self._nothing_found(found))

    def load(self, frame_id: FrameId) -> Frame:
        """Read one frame.

        Args:
            frame_id: one of :attr:`frame_ids`.

        Raises:
            FrameError: image or scan cannot be read, or the image has another size.
            RecordingError: the recording has no such frame.
        """
        drive = self._drives.get((frame_id.rig, frame_id.drive))
        if drive is None or frame_id.index not in drive.pairs:
            raise RecordingError(f"Frame {frame_id} is none of this recording.")
        image_path, scan_path, time = drive.pairs[frame_id.index]
        points, n_dropped = read_point_file(scan_path)
        points = points * np.array([drive.scale] * 3 + [1.0 / drive.brightest], np.float32)
        image = read_image(image_path)
        if drive.size is not None and image.shape[:2] != drive.size:
            raise FrameError(
                f"{image_path}: {image.shape[1]}×{image.shape[0]} pixels, but the calibration or "
                f"most others have {drive.size[1]}×{drive.size[0]}; restore the image."
            )
        return Frame(
            id=frame_id,
            image=drive.lens.undistort(image),
            points=points,
            K=drive.lens.K_undistorted.copy(),
            T_cam_lidar=drive.T_cam_lidar.copy(),
            time=time,
            n_dropped=n_dropped,
        )

    def paths(self, frame_id: FrameId) -> tuple[Path, Path]:
        """Image and scan of one of :attr:`frame_ids`."""
        return self._drives[frame_id.rig, frame_id.drive].pairs[frame_id.index][:2]

    def calibration(self, frame_id: FrameId) -> CameraCalibration:
        """What ``rig.yaml`` says of the camera of one of :attr:`frame_ids`."""
        drive = self._drives[frame_id.rig, frame_id.drive]
        return CameraCalibration(drive.lens.K, drive.T_cam_lidar, drive.lens.size)

    def _add(
        self, folder: Path, rig: Rig, camera: str | None, lidar: str | None, stride: int
    ) -> None:
        camera = _named(camera, list(rig.cameras), "camera")
        with_extrinsic = [name for name in rig.lidars if (camera, name) in rig.T_cam_lidar]
        lidar = _named(lidar, list(rig.lidars), "lidar", with_extrinsic)
        if (camera, lidar) not in rig.T_cam_lidar:
            raise RecordingError(
                f"{folder.parent / FILE}: no extrinsics.{camera}.{lidar}; add T_cam_lidar there."
            )
        images = list_files(folder / camera, IMAGES)
        scans = list_files(folder / lidar, tuple(READERS))
        pairs, alone = pair(images, scans, rig.tolerance_s)
        scale, brightest = rig.lidars[lidar]
        lens = rig.cameras[camera]
        size = lens.size or usual_size([path for path in images if path.suffix == ".png"])
        T = rig.T_cam_lidar[camera, lidar]
        drive = _Drive(lens, scale, brightest, T, size, dict(enumerate(pairs)))
        self._drives[rig.name, folder.name] = drive
        kept = islice(drive.pairs, 0, None, stride)
        self.frame_ids += [FrameId(rig.name, folder.name, index) for index in kept]
        self.skipped |= {f"{rig.name}/{folder.name}/{path.name}": why for path, why in alone}

    def _nothing_found(self, drives: Sequence[Path]) -> str:
        some = [f"{name}: {reason}" for name, reason in islice(self.skipped.items(), 3)]
        where = ", ".join(str(drive) for drive in drives[:3])
        return "\n  ".join([f"No frame with an image and a scan in {where}", *some])


def find_drives(root: Path) -> list[Path]:
    """Drive folders: those beside a ``rig.yaml`` in ``root`` or in a folder of it.

    Raises:
        CalibrationMissing, RecordingError: there is none.
    """
    if not root.is_dir():
        raise RecordingError(f"The recordings folder {root} does not exist.")
    rigs = [root] if (root / FILE).is_file() else [root / name for name in subfolders(root)]
    rigs = [rig for rig in rigs if (rig / FILE).is_file()]
    drives = [rig / name for rig in rigs for name in subfolders(rig) if subfolders(rig / name)]
    if not drives:
        raise RecordingError(
            f"{root} holds no {FILE} with a folder per drive beside it; found {contents(root)}. "
            "docs/own-rig.md describes the layout."
        )
    return drives


def list_files(folder: Path, suffixes: tuple[str, ...]) -> dict[Path, float]:
    """Files of one sensor in the order of their names → their time stamps in seconds, or NaN."""
    if not folder.is_dir():
        return {}
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes)
    times = read_second_times(folder / STAMPS)
    return {
        path: float(times[i]) if i < len(times) else float("nan") for i, path in enumerate(paths)
    }


def pair(
    images: dict[Path, float], scans: dict[Path, float], tolerance_s: float | None
) -> tuple[list[tuple[Path, Path, float]], list[tuple[Path, str]]]:
    """Pair images and scans.

    Args:
        images: file → seconds.
        scans: file → seconds.
        tolerance_s: each scan with the image nearest in time, no further away than this; None: the
            files of the same name.

    Returns:
        Image, scan and time of the scan; and the files without a partner, with the reason.
    """
    if tolerance_s is None:
        by_name = {path.stem: path for path in images}
        stems = {path.stem for path in scans}
        pairs = [(by_name[s.stem], s, t) for s, t in scans.items() if s.stem in by_name]
        alone = [(s, f"image missing for {s}") for s in scans if s.stem not in by_name]
        alone += [(i, f"scan missing for {i}") for i in images if i.stem not in stems]
        return pairs, alone
    times = np.array(list(images.values()))
    paths, pairs, alone = list(images), [], []
    for scan, time in scans.items():
        apart = np.abs(times - time)
        if not len(apart) or not np.isfinite(apart).any():
            alone.append((scan, f"no image or no time stamps for {scan}"))
            continue
        nearest = int(np.nanargmin(apart))
        if apart[nearest] <= tolerance_s:
            pairs.append((paths[nearest], scan, time))
        else:
            alone.append((scan, f"nearest image {1000 * apart[nearest]:.0f} ms from {scan}"))
    return pairs, alone


def _named(
    name: str | None, known: Sequence[str], setting: str, usual: Sequence[str] | None = None
) -> str:
    if name is None:
        return (usual or known)[0]
    if name not in known:
        raise ConfigurationError(f"{setting} is '{name}', expected one of {', '.join(known)}.")
    return name
