"""Looking at recording folders without opening a file: the raw data set has 47,000 frames."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from uncal.errors import ConfigurationError


def list_indices(folder: Path, digits: int, suffix: str) -> set[int]:
    """The numbers of the files ``0000000007.png`` of a folder.

    Args:
        folder: the folder; a missing one holds no files.
        digits: length of the number in the file names; other names are ignored.
        suffix: of the file names, with its dot.

    Returns:
        The numbers.
    """
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries]
    except (FileNotFoundError, NotADirectoryError):
        return set()
    length = digits + len(suffix)
    return {
        int(name[:digits])
        for name in names
        if len(name) == length and name.endswith(suffix) and name[:digits].isdecimal()
    }


def subfolders(folder: Path) -> list[str]:
    """Names of the folders in a folder, links to folders among them, hidden ones not, sorted."""
    with os.scandir(folder) as entries:
        return sorted(e.name for e in entries if e.is_dir() and not e.name.startswith("."))


def contents(folder: Path, limit: int = 8) -> str:
    """The first few names in a folder, for an error message."""
    names = sorted(path.name for path in folder.iterdir())
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more if names else "nothing (an empty folder)"


def choose(
    available: Mapping[str, Sequence[str]],
    wanted: Sequence[str] | None,
    setting: str,
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
