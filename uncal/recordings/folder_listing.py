"""Looking at recording folders without opening a file: the raw data set has 47,000 frames."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from uncal.errors import ConfigurationError, RecordingError

LAYOUTS: tuple[str, ...] = ("folder", "kitti", "kitti_odometry", "dsec")
"""Names, as ``dataset=`` has them."""

RIG_FILE = "rig.yaml"
"""Of a plain folder; see docs/own-rig.md."""

DATE = re.compile(r"\d{4}_\d{2}_\d{2}")
"""A date folder of KITTI raw."""


def layout_of(root: Path, setting: str) -> str:
    """Which of :data:`LAYOUTS` a folder has, by names alone; ``setting`` gave it, for messages.

    Raises:
        RecordingError: no such folder, or none of the layouts.
    """
    if not root.is_dir():
        raise RecordingError(f"{setting}={root}: no such folder")
    if (root / RIG_FILE).is_file() or any(root.glob(f"*/{RIG_FILE}")):
        return "folder"
    names = [path.name for path in root.iterdir() if path.is_dir()]
    if any(DATE.fullmatch(name) for name in names):
        return "kitti"
    if "sequences" in names:
        return "kitti_odometry"
    if "data" in names or any((root / name / "events").is_dir() for name in names):
        return "dsec"
    raise RecordingError(
        f"{setting}={root}: none of the known layouts: a plain folder ({RIG_FILE}, "
        "docs/own-rig.md), KITTI raw (date folders such as 2011_09_26), KITTI odometry "
        f"(sequences/) or DSEC (sequences with events/, and data/); found {contents(root)}"
    )


def list_numbered(folder: Path, digits: int, suffix: str) -> dict[int, str]:
    """The files ``0000000007.png`` of a folder, number → name; a missing folder holds none."""
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries]
    except (FileNotFoundError, NotADirectoryError):
        return {}
    length = digits + len(suffix)
    return {
        int(name[:digits]): name
        for name in names
        if len(name) == length and name.endswith(suffix) and name[:digits].isdecimal()
    }


def subfolders(folder: Path) -> list[str]:
    """Names of the folders in a folder, links to folders among them, hidden ones not, sorted."""
    with os.scandir(folder) as entries:
        return sorted(e.name for e in entries if e.is_dir() and not e.name.startswith("."))


def existing(root: str | Path, remedy: str) -> Path:
    """The folder of recordings; where it is not, :class:`RecordingError` with a remedy."""
    root = Path(root).expanduser()
    if not root.is_dir():
        raise RecordingError(
            f"The recordings folder {root} does not exist. {remedy.format(root=root)}"
        )
    return root


def contents(folder: Path) -> str:
    """The first few names in a folder, for an error message."""
    names = sorted(path.name for path in folder.iterdir())
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return ", ".join(names[:8]) + more if names else "nothing (an empty folder)"


def choose(
    available: Mapping[str, Sequence[str]], wanted: Sequence[str] | None, setting: str
) -> list[str]:
    """Choose folders by name or shell pattern.

    Args:
        available: folder name → the names that a user may write for it, the shortest last.
        wanted: names or patterns; all folders if None.
        setting: the name of the setting, for messages.

    Returns:
        The chosen folder names in the order of ``available``, each once.

    Raises:
        ConfigurationError: a name matches nothing, or nothing is wanted.

    >>> choose({"2011_drive_01": ["2011_drive_01", "01"], "b": ["b"]}, ["0*"], "drives")
    ['2011_drive_01']
    """
    if wanted is None:
        return list(available)
    patterns = [wanted] if isinstance(wanted, str) else list(wanted)
    if not patterns:
        raise ConfigurationError(f"{setting} is an empty list; use null for all of them.")
    chosen: set[str] = set()
    for pattern in patterns:
        matches = {
            folder
            for folder, names in available.items()
            if any(fnmatchcase(name, pattern) for name in names)
        }
        if not matches:
            raise ConfigurationError(
                f"{setting} names '{pattern}', which matches nothing; "
                f"there are {', '.join(names[-1] for names in available.values())}."
            )
        chosen |= matches
    return [folder for folder in available if folder in chosen]


def one_of(name: str, known: Sequence[str], setting: str) -> str:
    """A name that must be one of those known; else a :class:`ConfigurationError` lists them."""
    if name not in known:
        raise ConfigurationError(f"{setting} is '{name}', expected one of {', '.join(known)}.")
    return name
