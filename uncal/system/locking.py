"""Keeps two processes from doing the same work at once."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

log = logging.getLogger(__name__)


@contextlib.contextmanager
def locked(path: Path, work: str) -> Iterator[None]:
    """Hold a lock; wait, and say so, while another process holds it.

    The system drops the lock when its holder dies: there is no stale lock, whatever the file says.

    Args:
        path: the lock's file, in an existing folder.
        work: what its holder does, for messages, such as "simulates into data/demo".
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


def _holder(path: Path) -> str:
    try:
        return path.read_text().strip() or "unknown"
    except (OSError, ValueError):
        return "unknown"
