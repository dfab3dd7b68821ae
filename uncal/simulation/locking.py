"""Keeps two processes from simulating into the same folder at once."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
from collections.abc import Iterator
from pathlib import Path

from uncal.simulation.manifest import LOCK_NAME

log = logging.getLogger(__name__)


@contextlib.contextmanager
def locked(root: Path) -> Iterator[None]:
    """Hold the folder's lock; wait, and say so, while another process holds it.

    The lock belongs to the open file, so the system drops it when its holder dies: there is no
    stale lock, whatever the file says. The file itself stays.

    Args:
        root: an existing folder.
    """
    with (root / LOCK_NAME).open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            holder = file.read().strip() or "unknown"
            log.info("waiting for process %s, which simulates into %s", holder, root)
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError as error:
            log.warning(
                "%s cannot be locked (%s): only one process may simulate there", root, error
            )
        file.seek(0)
        file.truncate()
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield
