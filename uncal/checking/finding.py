"""What a check says: a fault, what was seen, what was expected, and the remedy."""

from __future__ import annotations

from dataclasses import dataclass

KINDS: dict[str, str] = {
    "inverted": "extrinsic inverted: camera → LiDAR where LiDAR → camera is expected",
    "axes": "axes swapped or of the other handedness",
    "camera frame": "points already in the camera's frame",
    "mirrored": "image mirrored",
    "millimetres": "millimetres (or centimetres) for metres",
    "degrees": "degrees for radians",
    "reflectance": "reflectances beyond 0 to 1",
    "resolution": "camera matrix of another resolution",
    "distortion": "lens distortion left in the image",
    "clock": "clock: images and scans not of the same moment, or reordered",
    "rotation": "a rotation that is none",
    "truncated": "truncated, empty or unreadable files",
    "scans": "drive without scans (or without images)",
    "calibration": "calibration missing",
    "unconfirmed": "edges of sweep and image do not support the extrinsic",
}
"""Fault → its description in the table."""


@dataclass(frozen=True)
class Finding:
    """One fault of one drive.

    Attributes:
        kind: a key of :data:`KINDS`.
        drive: name of the drive, or what else it is about.
        seen: what was found.
        expected: what would have been right.
        remedy: what to do.
        error: False for what only deserves a look; an error ends the command with status 1.
    """

    kind: str
    drive: str
    seen: str
    expected: str
    remedy: str
    error: bool = True


@dataclass(frozen=True)
class DriveReport:
    """What is known of one drive after its check.

    Attributes:
        drive: its name.
        n_frames: frames with image (or events) and scan.
        support: how far the declared extrinsic stands above itself turned by 2° to 5°, in standard
            deviations; NaN where edges were not compared. Right ones have about 4 to 12.
        findings: its faults.
        overlay: picture of the sweep on the image as declared (and as repaired); None if no frame
            could be read.
    """

    drive: str
    n_frames: int
    support: float
    findings: tuple[Finding, ...]
    overlay: str | None = None
