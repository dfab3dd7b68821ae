"""What keeps a job working in a process of its own, where a parallel launcher puts it."""

from __future__ import annotations

import multiprocessing
import pickle

from hydra.core.utils import JobReturn
from hydra.errors import CompactHydraException


def restore_start_method() -> None:
    """Let a job start processes as anywhere else; does nothing outside joblib's processes.

    Joblib's library loky makes itself the way in which its processes start others. Those that load
    data or simulate then end at once: ``ValueError: cannot find context for 'loky'``.
    """
    if multiprocessing.get_start_method(allow_none=True) == "loky":
        multiprocessing.set_start_method(None, force=True)  # the default


def make_portable(job_return: JobReturn, reason: str) -> None:
    """Replace an error that cannot travel from the job's process to the launcher's.

    One such error would make the launcher give up on the jobs still to come.
    """
    try:
        pickle.loads(pickle.dumps(job_return._return_value))
    except Exception:
        job_return.return_value = CompactHydraException(reason)
