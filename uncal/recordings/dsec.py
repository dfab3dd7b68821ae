"""DSEC (Gehrig et al., "DSEC: A Stereo Event Camera Dataset for Driving Scenarios", RA-L 2021).

A frame is a LiDAR scan and the events that lead up to it. See :mod:`uncal.recordings.dsec_layout`
for the files and the official splits.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from uncal.errors import RecordingError
from uncal.recordings.calibration_files import SIDES, CameraCalibration, event_camera_calibration
from uncal.recordings.dsec_events import inspect_events, read_rectify_map
from uncal.recordings.dsec_layout import REMEDY, SequenceFolder, drive_of, find_sequences
from uncal.recordings.dsec_pairing import SCAN_TIMES, EventWindow, PairedSequence, pair
from uncal.recordings.folder_listing import choose, one_of
from uncal.recordings.folder_recording import check_stride
from uncal.recordings.frame import Frame, FrameId
from uncal.recordings.lidar_bag import LidarBag
from uncal.recordings.scan_motion import SweepMotion
from uncal.settings.rules import number, require

log = logging.getLogger(__name__)

T = TypeVar("T")


class Dsec:
    """A folder of DSEC sequences; implements :class:`~uncal.recordings.frame.Recording`.

    A sequence is a drive in the sense of :class:`~uncal.recordings.frame.FrameId`, and a frame's
    number is that of its scan among those of the sequence. Sequences with one and the same
    calibration are a rig, named after the first drive under ``root`` that has it, whichever
    sequences are chosen.

    What cannot be used is left out, logged and listed in :attr:`skipped`: sequences without LiDAR
    or with damaged files, damaged scans, windows with too few events. A scan whose window would
    begin before the sequence's first event is no frame either, and no defect.

    Args:
        root: folder of the sequences and of ``data``.
        window_ms: length of the event window before each scan, milliseconds.
        min_events: a frame with fewer events is left out; a standing car sees next to nothing.
        sequences: names or shell patterns (``zurich_city_0*``); all if None.
        side: event camera, a key of :data:`~uncal.recordings.calibration_files.SIDES`.
        stride: keep every ``stride``-th scan of each sequence.
        scan_time: when the window ends, one of :data:`SCAN_TIMES`. DSEC does not say which moment
            of the sweep its stamps are. The field ``time`` of the points counts from the stamp, so
            ``end`` is right wherever that field is there, and is the stamp where it is not.
        untwist: estimate the vehicle's motion from neighbouring scans, of which DSEC has no record,
            so that what it does to the sweep is undone; see :mod:`uncal.recordings.scan_motion`.

    Raises:
        RecordingError: the root is missing or empty, or no sequence can be used.
        ConfigurationError: a setting is out of range, or a name matches no sequence.

    Attributes:
        frame_ids: sequence by sequence, in order of time.
        skipped: frame, sequence or bag → reason.
        scan_rates: drive (``zurich_city_04``) → scans per second (median), as measured.
        scan_gaps: drive → number of pauses longer than 1.5 median intervals.
    """

    def __init__(
        self,
        root: str | Path,
        window_ms: float,
        min_events: int,
        sequences: Sequence[str] | None = None,
        side: str = "left",
        stride: int = 1,
        scan_time: str = "end",
        untwist: bool = True,
    ) -> None:
        require("window_ms", window_ms, number(0.001, 60_000))
        require("min_events", min_events, number(0, 1e9, whole=True))
        one_of(side, list(SIDES), "side")
        one_of(scan_time, SCAN_TIMES, "scan_time")
        check_stride(stride)
        root = Path(root).expanduser()
        self.frame_ids: list[FrameId] = []
        self.skipped: dict[str, str] = {}
        self.scan_rates: dict[str, float] = {}
        self.scan_gaps: dict[str, int] = {}
        self._window = EventWindow(round(1000 * window_ms), min_events)
        self._stride = stride
        self._sequences: dict[tuple[str, str], PairedSequence] = {}
        self._bags: dict[str, LidarBag | RecordingError] = {}
        self._motions: dict[str, SweepMotion] = {}
        self._untwist = untwist
        self._maps: dict[bytes, NDArray[np.float32]] = {}

        folders = find_sequences(root)
        chosen = choose({name: [name] for name in folders}, sequences, "sequences")
        calibrations = {
            name: _attempt(event_camera_calibration, it.cam_to_cam, it.cam_to_lidar, side)
            for name, it in folders.items()
        }
        rigs = _name_rigs(calibrations)
        reasons: set[type[RecordingError]] = set()
        for name in chosen:
            try:
                self._add(folders[name], calibrations[name], rigs.get(name, ""), side, scan_time)
            except RecordingError as error:
                reasons.add(type(error))
                self.skipped[name] = str(error)
                log.warning("left out sequence %s: %s", name, error)
        if not self.frame_ids:
            # One reason for all keeps its class: calibration, rotation, nothing to pair.
            kinds = reasons if len(reasons) == 1 else {RecordingError}
            raise kinds.pop()(self._nothing_found(root, len(chosen)))

    def load(self, frame_id: FrameId) -> Frame:
        """Read one of :attr:`frame_ids`; non-finite points are dropped and counted; UNIX time.

        Raises:
            FrameError: the scan or the events cannot be read, or there are too few events.
            RecordingError: the recording has no such frame.
        """
        sequence = self._sequences.get((frame_id.rig, frame_id.drive))
        if sequence is None or not 0 <= frame_id.index < len(sequence):
            raise RecordingError(
                f"Frame {frame_id} is none of this recording; its sequences are "
                f"{', '.join('/'.join(known) for known in self._sequences)}."
            )
        return sequence.load(frame_id, self._window)

    def _add(
        self,
        folder: SequenceFolder,
        calibration: CameraCalibration | RecordingError,
        rig: str,
        side: str,
        scan_time: str,
    ) -> None:
        bag = self._bag(folder)
        calibration = _given(calibration)
        rectify_map = read_rectify_map(folder.of_camera(side, "rectify_map.h5"))
        _check_size(calibration, rectify_map, folder, side)
        # The sequences of one rig share theirs: 2.5 MB, in every worker.
        digest = hashlib.sha256(rectify_map.tobytes()).digest()
        rectify_map = self._maps.setdefault(digest, rectify_map)
        events = inspect_events(folder.of_camera(side, "events.h5"), rectify_map)
        sequence = pair(events, bag, calibration, scan_time, self._motion(folder, bag))
        frames, poor = sequence.sort_out(self._window, self._stride)
        self._sequences[rig, folder.name] = sequence
        self.frame_ids += [FrameId(rig, folder.name, index) for index in frames]
        self.skipped |= {str(FrameId(rig, folder.name, i)): reason for i, reason in poor.items()}
        sizes = (folder.name, len(frames), len(poor))
        log.info("sequence %s: %d frames, %d with too few events", *sizes)

    def _motion(self, folder: SequenceFolder, bag: LidarBag) -> SweepMotion | None:
        if not self._untwist:
            return None
        return self._motions.setdefault(
            drive_of(folder.name),
            SweepMotion(bag.points, bag.index.stamp_ns / 1e9),
        )

    def _bag(self, folder: SequenceFolder) -> LidarBag:
        """The bag of a sequence's drive, opened once; what is wrong with it is raised each time."""
        drive = drive_of(folder.name)
        if drive not in self._bags:
            self._bags[drive] = _attempt(self._open_bag, drive, folder.bag)
        return _given(self._bags[drive])

    def _open_bag(self, drive: str, path: Path) -> LidarBag:
        bag = LidarBag(path)
        index = bag.index
        self.scan_rates[drive], self.scan_gaps[drive] = index.rate, index.n_gaps
        log.info("drive %s: %d scans at %.2f Hz", drive, len(index), index.rate)
        if note := bag.intensity_note():
            log.warning("drive %s: %s", drive, note)
        if index.n_gaps:
            log.warning("drive %s: scans are missing in %d gaps", drive, index.n_gaps)
        if index.n_duplicates:
            log.warning("drive %s: %d scans left out, repeated", drive, index.n_duplicates)
        if index.n_damaged:
            reason = f"{index.n_damaged} scans cannot be read, the last one: {index.damage}"
            self.skipped[f"{drive}/{path.name}"] = reason
            log.warning("drive %s: %s", drive, reason)
        return bag

    def _nothing_found(self, root: Path, n_chosen: int) -> str:
        some = [f"{name}: {reason}" for name, reason in islice(self.skipped.items(), 5)]
        more = [f"and {len(self.skipped) - 5} more"] if len(self.skipped) > 5 else []
        intro = f"No usable frame in {n_chosen} sequence(s) of {root}:"
        return "\n  ".join([intro, *some, *more]) + f"\n{REMEDY.format(root=root)}"


def _check_size(
    calibration: CameraCalibration,
    rectify_map: NDArray[np.float32],  # (H, W, 2)
    folder: SequenceFolder,
    side: str,
) -> None:
    found, expected = rectify_map.shape[:2], calibration.size
    if expected is not None and found != expected:
        raise RecordingError(
            f"{folder.of_camera(side, 'rectify_map.h5')} is for {found[1]}×{found[0]} pixels, but "
            f"{folder.cam_to_cam} has resolution {expected[1]}×{expected[0]}: they are of "
            "different recordings. Restore both from DSEC's archives."
        )


def _attempt(action: Callable[..., T], *args: object) -> T | RecordingError:
    """What an action gives, or why it fails."""
    try:
        return action(*args)
    except RecordingError as error:
        return error


def _given(found: T | RecordingError) -> T:
    if isinstance(found, RecordingError):
        raise found
    return found


def _name_rigs(
    calibrations: Mapping[str, CameraCalibration | RecordingError],
) -> dict[str, str]:
    """Sequence → rig."""
    names: dict[bytes, str] = {}
    rigs: dict[str, str] = {}
    for sequence, calibration in calibrations.items():
        if isinstance(calibration, RecordingError):
            continue
        numbers = calibration.K.tobytes() + calibration.T_cam_lidar.tobytes()
        if numbers not in names:
            drive = drive_of(sequence)
            # A drive of two calibrations: its second rig must not share the first one's name.
            names[numbers] = sequence if drive in names.values() else drive
        rigs[sequence] = names[numbers]
    return rigs
