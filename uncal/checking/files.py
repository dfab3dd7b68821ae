"""Faults that the form of the files gives away: sizes, endings, time stamps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.checking.finding import Finding
from uncal.checking.layouts import Stamps
from uncal.errors import CalibrationMissing, NothingPaired, RecordingError, RotationError
from uncal.recordings.folder_recording import FolderRecording
from uncal.recordings.frame import Recording
from uncal.recordings.sensor_files import image_size

_SHORT = 0.5
"""A scan of less than this share of the usual size is cut off or half of a revolution."""


_ERRORS: dict[type[RecordingError], tuple[str, str, str]] = {
    CalibrationMissing: (
        "calibration",
        "the calibration beside the recordings",
        "put the calibration files there, or correct their names",
    ),
    RotationError: (
        "rotation",
        "R·Rᵀ = I with determinant 1",
        "write the matrix with all its digits, row by row; do not scale it",
    ),
    NothingPaired: (
        "scans",
        "frames with an image (or events) and a scan each",
        "unpack the missing archive, or remove the drive",
    ),
}
"""What a reader raises → kind of fault, what was expected, the remedy."""


def of_error(drive: str, error: RecordingError) -> Finding:
    """A drive that could not be opened, because of what the reader said."""
    unreadable = ("truncated", "files that can be read", "copy the files again")
    kind, expected, remedy = _ERRORS.get(type(error), unreadable)
    if "UTC; the scans are from" in str(error):
        kind, expected = "clock", "scans from the time of the events"
        remedy = "put both sensors on one clock (t_offset, UTC)"
    elif "out of order" in str(error):
        kind, expected = "clock", "times that rise from event to event"
        remedy = "sort the events by time, all columns together"
    seen = " ".join(line.strip() for line in str(error).splitlines()[:2])
    return Finding(kind, drive, seen, expected, remedy)


def of_files(drive: str, recording: Recording) -> list[Finding]:
    """Incomplete frames, files that end too early, images of another size."""
    found = []
    if recording.skipped:
        n, first = len(recording.skipped), next(iter(recording.skipped.values()))
        found.append(
            Finding(
                "truncated" if "cannot be read" in first else "scans",
                drive,
                f"{n} of {n + len(recording.frame_ids)} frames incomplete; {first}",
                "an image (or events) and a scan for every frame",
                "copy what is missing; such frames are left out and counted",
                error=n > len(recording.frame_ids),
            )
        )
    if not isinstance(recording, FolderRecording):
        return found
    pairs = [recording.paths(frame) for frame in recording.frame_ids]
    images, scans = ([pair[side] for pair in pairs] for side in (0, 1))
    bad = [path for path in images if not _ends_well(path)] + _cut_scans(scans)
    if bad:
        found.append(
            Finding(
                "truncated",
                drive,
                f"{len(bad)} of {2 * len(pairs)} files truncated or empty, the first {bad[0]}",
                "whole images; scans of 16 bytes a point, about as long as the others",
                "copy these files again",
            )
        )
    declared = recording.calibration(recording.frame_ids[0]).size
    return [*found, *_sizes(drive, images, declared)]


def of_stamps(drive: str, stamps: Stamps, by_number: bool) -> list[Finding]:
    """Clocks that run backwards, or apart where images and scans are paired ``by_number``."""
    found = []
    for path, times in stamps.items():
        steps = np.diff(times)
        if (steps <= 0).any():
            where = int(np.flatnonzero(steps <= 0)[0])
            found.append(
                Finding(
                    "clock",
                    drive,
                    f"{path}: {int((steps <= 0).sum())} stamps are not later than the one before, "
                    f"the first in line {where + 2}",
                    "stamps that rise from line to line",
                    "sort frames and stamps by time, together",
                )
            )
    series = list(stamps.items())
    if by_number and len(series) == 2 and len(series[0][1]) == len(series[1][1]):
        (_, a), (path, b) = series
        interval = float(np.median(np.abs(np.diff(b)))) if len(b) > 1 else np.nan
        offset = float(np.median(a - b)) if len(b) else np.nan
        if abs(offset) > 0.5 * interval:
            found.append(
                Finding(
                    "clock",
                    drive,
                    f"images are stamped {1000 * offset:+.0f} ms from their scans ({path})",
                    f"less than half the interval of {1000 * interval:.0f} ms",
                    "pair each scan with the image nearest in time, on one clock",
                )
            )
    return found


def _ends_well(path: Path) -> bool:
    """Whether an image file is whole, by its last bytes."""
    try:
        with path.open("rb") as file:
            head = file.read(4)
            file.seek(max(0, path.stat().st_size - 64))
            tail = file.read()
    except OSError:
        return False
    ends = {b"\x89PNG": b"IEND\xaeB`\x82", b"\xff\xd8": b"\xff\xd9"}
    return bool(head) and all(end in tail for start, end in ends.items() if head.startswith(start))


def _cut_scans(scans: Sequence[Path]) -> list[Path]:
    """Scans that are empty, end within a point, or are much shorter than the others."""
    sizes = np.array([path.stat().st_size for path in scans])
    short = sizes < _SHORT * np.median(sizes)
    if scans and scans[0].suffix == ".bin":
        short |= (sizes == 0) | (sizes % 16 > 0)
    return [scans[int(i)] for i in np.flatnonzero(short)]


def _sizes(drive: str, images: Sequence[Path], declared: tuple[int, int] | None) -> list[Finding]:
    sizes = [image_size(path) for path in images]
    known: NDArray[np.int64] = np.array([size for size in sizes if size], dtype=np.int64)
    if not len(known):
        return []
    values, counts = np.unique(known, axis=0, return_counts=True)
    usual = values[counts.argmax()]
    expected = np.array(declared) if declared else usual
    odd = int((known != expected).any(1).sum())
    if not odd:
        return []
    height, width = (known[(known != expected).any(1)][0]).tolist()
    said = "the calibration is for" if declared else "most images have"
    return [
        Finding(
            "resolution",
            drive,
            f"{odd} of {len(known)} images have {width}×{height} pixels",
            f"{expected[1]}×{expected[0]}, which {said}",
            "restore the images, or scale fx, fy, cx, cy with them",
        )
    ]
