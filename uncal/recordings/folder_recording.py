"""Recordings that are folders of images beside folders of scans."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import ConfigurationError, FrameError, NothingPaired, RecordingError
from uncal.recordings.calibration_files import CameraCalibration
from uncal.recordings.frame import Frame, FrameId
from uncal.recordings.scan_motion import SweepMotion
from uncal.recordings.sensor_files import read_image, read_scan, usual_size


@dataclass(frozen=True)
class DriveFolder:
    """Where one drive's files are, and how they are read.

    Attributes:
        rig: name of the rig; see :class:`~uncal.recordings.frame.FrameId`.
        drive: name of the drive.
        image_folder: holds ``images``.
        images: frame number → name of the file; a number in ``images`` or ``scans`` alone is
            reported as skipped.
        scan_folder: holds ``scans``.
        scans: frame number → name of the file.
        calibration: of the camera, as it is after ``undistort``.
        times: seconds of frame 0, 1, …; frames beyond the last one have no time.
        unpaired: name of a file without a partner, where files are not paired by number → reason.
        read_scan: gives (N, 4) points and how many were dropped.
        undistort: of images as they are read.
        recorded_twist: the LiDAR's motion at a frame, see :class:`~uncal.recordings.frame.Frame`.
        distorted: without ``recorded_twist``, the motion is to be found from the sweeps themselves.
    """

    rig: str
    drive: str
    image_folder: Path
    images: Mapping[int, str]
    scan_folder: Path
    scans: Mapping[int, str]
    calibration: CameraCalibration
    times: Callable[[], NDArray[np.float64]]
    unpaired: Mapping[str, str] = field(default_factory=dict)
    read_scan: Callable[[Path], tuple[NDArray[np.float32], int]] = read_scan
    undistort: Callable[[NDArray[np.uint8]], NDArray[np.uint8]] | None = None
    recorded_twist: Callable[[int], NDArray[np.float64]] | None = None
    distorted: bool = False

    def scan(self, index: int) -> NDArray[np.float32]:
        """The points of frame ``index``."""
        if index not in self.scans:
            raise FrameError(f"{self.scan_folder}: there is no scan {index}.")
        return self.read_scan(self.scan_folder / self.scans[index])[0]


class FolderRecording:
    """Frames of some drives; implements :class:`~uncal.recordings.frame.Recording`.

    Args:
        drives: the drives, in order.
        stride: keep every ``stride``-th frame number of each drive. Frames are counted before
            incomplete ones are left out, so that a missing file never shifts the others.

    Raises:
        ConfigurationError: ``stride`` is below 1.
        NothingPaired: no frame has both an image and a scan.

    Attributes:
        frame_ids: every frame with an image and a scan, drive by drive, in order of number.
        skipped: frames of which one file is missing → which.
    """

    def __init__(self, drives: Iterable[DriveFolder], stride: int) -> None:
        check_stride(stride)
        self.frame_ids: list[FrameId] = []
        self.skipped: dict[str, str] = {}
        self._drives = {(drive.rig, drive.drive): drive for drive in drives}
        self._times: dict[tuple[str, str], NDArray[np.float64]] = {}
        self._sizes: dict[tuple[str, str], tuple[int, int] | None] = {}
        self._motions: dict[tuple[str, str], SweepMotion] = {}
        for drive in self._drives.values():
            self._list_drive(drive, stride)
        if not self.frame_ids:
            raise NothingPaired(self._nothing_found())

    def load(self, frame_id: FrameId) -> Frame:
        """Read one of :attr:`frame_ids`; non-finite points are dropped and counted.

        Raises:
            FrameError: the image, the scan or the record of motion is missing, truncated or
                unreadable, or the image has another size than the calibration is for.
            RecordingError: the recording has no such frame.
        """
        key = (frame_id.rig, frame_id.drive)
        drive = self._drives.get(key)
        if drive is None or not (frame_id.index in drive.images and frame_id.index in drive.scans):
            raise RecordingError(
                f"Frame {frame_id} is none of this recording; its drives are "
                f"{', '.join('/'.join(known) for known in self._drives)}."
            )
        image_path, scan_path = self.paths(frame_id)
        points, n_dropped = drive.read_scan(scan_path)
        image = read_image(image_path)
        self._check_size(key, image_path, image.shape[:2])
        if key not in self._times:
            self._times[key] = drive.times()
        times = self._times[key]
        return Frame(
            id=frame_id,
            image=image if drive.undistort is None else drive.undistort(image),
            points=points,
            K=drive.calibration.K.copy(),
            T_cam_lidar=drive.calibration.T_cam_lidar.copy(),
            time=float(times[frame_id.index]) if frame_id.index < len(times) else float("nan"),
            n_dropped=n_dropped,
            twist=self._twist(key, frame_id.index),
        )

    def paths(self, frame_id: FrameId) -> tuple[Path, Path]:
        """Image and scan of one of :attr:`frame_ids`."""
        drive = self._drives[frame_id.rig, frame_id.drive]
        image, scan = drive.images[frame_id.index], drive.scans[frame_id.index]
        return drive.image_folder / image, drive.scan_folder / scan

    def calibration(self, frame_id: FrameId) -> CameraCalibration:
        """What the drive's files say of the camera of one of :attr:`frame_ids`."""
        return self._drives[frame_id.rig, frame_id.drive].calibration

    def _list_drive(self, drive: DriveFolder, stride: int) -> None:
        for index in islice(sorted({*drive.images, *drive.scans}), 0, None, stride):
            frame_id = FrameId(drive.rig, drive.drive, index)
            if index not in drive.scans:
                stem = Path(drive.images[index]).stem
                self.skipped[str(frame_id)] = f"scan missing: {drive.scan_folder / stem}.bin"
            elif index not in drive.images:
                stem = Path(drive.scans[index]).stem
                self.skipped[str(frame_id)] = f"image missing: {drive.image_folder / stem}.png"
            else:
                self.frame_ids.append(frame_id)
        self.skipped |= {f"{drive.rig}/{drive.drive}/{k}": v for k, v in drive.unpaired.items()}

    def _check_size(self, key: tuple[str, str], path: Path, found: tuple[int, ...]) -> None:
        """Refuse an image that the drive's camera matrix is not for, such as a crop."""
        drive = self._drives[key]
        if key not in self._sizes:
            self._sizes[key] = drive.calibration.size or usual_size(
                [drive.image_folder / drive.images[number] for number in sorted(drive.images)]
            )
        expected = self._sizes[key]
        if expected is not None and found != expected:
            said = (
                "its calibration (KITTI: S_rect) says"
                if drive.calibration.size
                else "most others have"
            )
            raise FrameError(
                f"{path}: {found[1]}×{found[0]} pixels, but {said} {expected[1]}×{expected[0]}: "
                "cropped or resized, its camera matrix does not hold. Restore the image, or adapt "
                "the calibration to it."
            )

    def _twist(self, key: tuple[str, str], index: int) -> NDArray[np.float64] | None:
        drive = self._drives[key]
        if drive.recorded_twist is not None:
            return drive.recorded_twist(index)
        if not drive.distorted:
            return None
        if key not in self._motions:
            self._motions[key] = SweepMotion(drive.scan, self._times[key])
        return self._motions[key].twist(index)

    def _nothing_found(self) -> str:
        lines = [f"No frame with an image and a scan in {len(self._drives)} drive(s). Looked in"]
        for drive in islice(self._drives.values(), 3):
            lines.append(f"{drive.image_folder} and {drive.scan_folder}")
        lines.append(
            f"{len(self.skipped)} incomplete frames" + (", among them" * bool(self.skipped))
        )
        lines += [f"{frame}: {reason}" for frame, reason in islice(self.skipped.items(), 3)]
        lines.append("Choose a camera that was recorded, or unpack the missing archive.")
        return "\n  ".join(lines)


def check_stride(stride: int) -> None:
    """Refuse a stride below 1 with a :class:`~uncal.errors.ConfigurationError`."""
    if stride < 1:
        raise ConfigurationError(f"stride is {stride}, expected at least 1 (every frame).")
