"""Recordings that are folders of numbered images beside folders of numbered scans."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import ConfigurationError, FrameError, NothingPaired, RecordingError
from uncal.recordings.calibration_files import CameraCalibration
from uncal.recordings.folder_listing import list_indices
from uncal.recordings.frame import Frame, FrameId
from uncal.recordings.image_sizes import usual_size
from uncal.recordings.motion import read_oxts
from uncal.recordings.scan_motion import SweepMotion
from uncal.recordings.sensor_files import read_image, read_scan


@dataclass(frozen=True)
class DriveFolder:
    """Where one drive's files are.

    Attributes:
        rig: name of the rig; see :class:`~uncal.recordings.frame.FrameId`.
        drive: name of the drive.
        images: folder of the ``.png`` files.
        scans: folder of the ``.bin`` files.
        digits: length of the frame number in the file names.
        calibration: of the camera that took the images.
        times: file of timestamps, line by line those of frame 0, 1, ...
        read_times: its parser; frames beyond its last line have no time.
        motion: folder of one ``.txt`` a frame that says how the vehicle moves; None: not known.
        R_lidar_imu: (3, 3) rotation of what they are given in → LiDAR; None: none.
        distorted: without ``motion``, sweeps are distorted by a motion to be found from themselves.
    """

    rig: str
    drive: str
    images: Path
    scans: Path
    digits: int
    calibration: CameraCalibration
    times: Path
    read_times: Callable[[Path], NDArray[np.float64]]
    motion: Path | None = None
    R_lidar_imu: NDArray[np.float64] | None = None
    distorted: bool = False

    def image_path(self, index: int) -> Path:
        """The image of frame ``index``."""
        return self.images / f"{index:0{self.digits}d}.png"

    def scan_path(self, index: int) -> Path:
        """The scan of frame ``index``."""
        return self.scans / f"{index:0{self.digits}d}.bin"

    def scan(self, index: int) -> NDArray[np.float32]:
        """The points of frame ``index``."""
        return read_scan(self.scan_path(index))[0]

    def recorded_twist(self, index: int) -> NDArray[np.float64] | None:
        """How the LiDAR moves at frame ``index``, if that was recorded."""
        if self.motion is None:
            return None
        rotation = np.eye(3) if self.R_lidar_imu is None else self.R_lidar_imu
        return read_oxts(self.motion / f"{index:0{self.digits}d}.txt", rotation)


class FolderRecording:
    """Pairs images and scans by number; implements :class:`~uncal.recordings.frame.Recording`.

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
        """List the drives; no image and no scan is opened."""
        if stride < 1:
            raise ConfigurationError(f"stride is {stride}, expected at least 1 (every frame).")
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
        """Read one frame.

        Args:
            frame_id: one of :attr:`frame_ids`.

        Returns:
            The frame; non-finite points are dropped and counted.

        Raises:
            FrameError: the image, the scan or the record of motion is missing, truncated or
                unreadable, or the image has another size than the calibration is for.
            RecordingError: the recording has no such drive.
        """
        key = (frame_id.rig, frame_id.drive)
        if key not in self._drives:
            raise RecordingError(
                f"Frame {frame_id} is of no drive of this recording; its drives are "
                f"{', '.join('/'.join(known) for known in self._drives)}."
            )
        drive = self._drives[key]
        points, n_dropped = read_scan(drive.scan_path(frame_id.index))
        image = read_image(drive.image_path(frame_id.index))
        self._check_size(drive, image, frame_id.index)
        return Frame(
            id=frame_id,
            image=image,
            points=points,
            K=drive.calibration.K.copy(),
            T_cam_lidar=drive.calibration.T_cam_lidar.copy(),
            time=self._time(drive, frame_id.index),
            n_dropped=n_dropped,
            twist=self._twist(drive, frame_id.index),
        )

    def paths(self, frame_id: FrameId) -> tuple[Path, Path]:
        """Image and scan of one of :attr:`frame_ids`."""
        drive = self._drives[frame_id.rig, frame_id.drive]
        return drive.image_path(frame_id.index), drive.scan_path(frame_id.index)

    def calibration(self, frame_id: FrameId) -> CameraCalibration:
        """What the drive's files say of the camera of one of :attr:`frame_ids`."""
        return self._drives[frame_id.rig, frame_id.drive].calibration

    def _list_drive(self, drive: DriveFolder, stride: int) -> None:
        images = list_indices(drive.images, drive.digits, ".png")
        scans = list_indices(drive.scans, drive.digits, ".bin")
        for index in islice(sorted(images | scans), 0, None, stride):
            frame_id = FrameId(drive.rig, drive.drive, index)
            if index not in scans:
                self.skipped[str(frame_id)] = f"scan missing: {drive.scan_path(index)}"
            elif index not in images:
                self.skipped[str(frame_id)] = f"image missing: {drive.image_path(index)}"
            else:
                self.frame_ids.append(frame_id)

    def _check_size(self, drive: DriveFolder, image: NDArray[np.uint8], index: int) -> None:
        """Refuse an image that the drive's camera matrix is not for, such as a crop."""
        key = (drive.rig, drive.drive)
        if key not in self._sizes:
            numbers = sorted(list_indices(drive.images, drive.digits, ".png"))
            self._sizes[key] = drive.calibration.size or usual_size(
                [drive.image_path(number) for number in numbers]
            )
        expected, found = self._sizes[key], image.shape[:2]
        if expected is not None and found != expected:
            said = "its calibration (S_rect) says" if drive.calibration.size else "most others have"
            raise FrameError(
                f"{drive.image_path(index)}: {found[1]}×{found[0]} pixels, but {said} "
                f"{expected[1]}×{expected[0]}: cropped or resized, its camera matrix does not "
                "hold. Restore the image, or adapt the calibration to it."
            )

    def _twist(self, drive: DriveFolder, index: int) -> NDArray[np.float64] | None:
        if drive.motion is not None or not drive.distorted:
            return drive.recorded_twist(index)
        key = (drive.rig, drive.drive)
        if key not in self._motions:
            self._motions[key] = SweepMotion(drive.scan, self._times_of(drive))
        return self._motions[key].twist(index)

    def _times_of(self, drive: DriveFolder) -> NDArray[np.float64]:
        key = (drive.rig, drive.drive)
        if key not in self._times:
            self._times[key] = drive.read_times(drive.times)
        return self._times[key]

    def _time(self, drive: DriveFolder, index: int) -> float:
        times = self._times_of(drive)
        return float(times[index]) if index < times.size else float("nan")

    def _nothing_found(self) -> str:
        looked = [
            f"{drive.images} (.png) and {drive.scans} (.bin)"
            for drive in islice(self._drives.values(), 3)
        ]
        missing = [f"{frame}: {reason}" for frame, reason in islice(self.skipped.items(), 3)]
        return "\n  ".join(
            [
                f"No frame with an image and a scan in {len(self._drives)} drive(s). Looked in",
                *looked,
                f"{len(self.skipped)} incomplete frames" + (", among them" if missing else "."),
                *missing,
                "Choose a camera that was recorded, or unpack the missing archive.",
            ]
        )
