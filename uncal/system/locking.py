"""Keeps two processes from doing the same work at once."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

log = logging.getLogger(__name__)


@contextlib.contextmanager
def locked(path: Path, work: str) -> Iterator[None]:
    """Hold a lock; wait, and say so, while another process holds it.

    The system drops the lock when its holder dies: there is no stale lock, whatever the file says.
    ``work`` is what its holder does, for messages, such as "simulates into data/demo".
    """
    lock = FileLock(path)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        log.info("waiting for process %s, which %s", _holder(path), work)
        lock.acquire()
    except (OSError, NotImplementedError) as error:
        log.warning("%s cannot be locked (%s): only one process may work there", path.parent, error)
    try:
        # For messages alone; Windows lets nobody write to a locked file.
        with contextlib.suppress(OSError):
            path.write_text(f"{os.getpid()}\n")
        yield
    finally:
        lock.release()


_READ: dict[Path, FileLock] = {}
"""Held until this process ends; by the folders that it reads."""


def note_reading(folder: Path) -> None:
    """Let other processes of this machine know, until this one ends, that it reads a folder."""
    notes = _notes(folder)
    if notes in _READ:
        return
    lock = FileLock(notes / f"{os.getpid()}.lock")
    # Where nothing can be noted, all is as without notes.
    with contextlib.suppress(OSError, NotImplementedError, Timeout):
        notes.mkdir(parents=True, exist_ok=True)
        lock.acquire(blocking=False)
        _READ[notes] = lock


def other_readers(folder: Path) -> list[str]:
    """Process numbers of the others that read a folder now."""
    return [
        path.stem
        for path in sorted(_notes(folder).glob("*.lock"))
        if path.stem != str(os.getpid()) and _is_held(path)
    ]


def _is_held(path: Path) -> bool:
    try:
        with FileLock(path, blocking=False):
            pass
    except Timeout:
        return True
    except (OSError, NotImplementedError):
        return False
    with contextlib.suppress(OSError):
        path.unlink()
    return False


def _notes(folder: Path) -> Path:
    digest = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / "uncal-readers" / digest


def _holder(path: Path) -> str:
    try:
        return path.read_text().strip() or "unknown"
    except (OSError, ValueError):
        return "unknown"
