"""Keeps two processes from doing the same work at once."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
from collections.abc import Iterator
from pathlib import Path

log = logging.getLogger(__name__)


@contextlib.contextmanager
def locked(path: Path, work: str) -> Iterator[None]:
    """Hold a lock; wait, and say so, while another process holds it.

    The lock belongs to the open file, so the system drops it when its holder dies: there is no
    stale lock, whatever the file says. The file itself stays.

    Args:
        path: the lock's file, in an existing folder.
        work: what its holder does, for messages, such as "simulates into data/demo".
    """
    with path.open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            holder = file.read().strip() or "unknown"
            log.info("waiting for process %s, which %s", holder, work)
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError as error:
            log.warning(
                "%s cannot be locked (%s): only one process may work there", path.parent, error
            )
        file.seek(0)
        file.truncate()
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield
