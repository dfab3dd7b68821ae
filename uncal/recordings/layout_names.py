"""Which of the known layouts a folder of recordings has, by its names alone."""

from __future__ import annotations

import re
from pathlib import Path

from uncal.errors import RecordingError

LAYOUTS: tuple[str, ...] = ("folder", "kitti", "kitti_odometry", "dsec")
"""Names, as ``dataset=`` has them."""

_RIG = "rig.yaml"
_DATE = re.compile(r"\d{4}_\d{2}_\d{2}")


def layout_of(root: Path, setting: str) -> str:
    """One of :data:`LAYOUTS`.

    Args:
        root: folder of the recordings.
        setting: name of the setting that gives it, for messages.

    Raises:
        RecordingError: no such folder, or none of the layouts.
    """
    if not root.is_dir():
        raise RecordingError(f"{setting}={root}: no such folder")
    if (root / _RIG).is_file() or any(root.glob(f"*/{_RIG}")):
        return "folder"
    names = [path.name for path in root.iterdir() if path.is_dir()]
    if any(_DATE.fullmatch(name) for name in names):
        return "kitti"
    if "sequences" in names:
        return "kitti_odometry"
    if "data" in names or any((root / name / "events").is_dir() for name in names):
        return "dsec"
    raise RecordingError(
        f"{setting}={root}: none of the known layouts: a plain folder ({_RIG}, docs/own-rig.md), "
        "KITTI raw (date folders such as 2011_09_26), KITTI odometry (sequences/) or DSEC "
        "(sequences with events/, and data/)"
    )
