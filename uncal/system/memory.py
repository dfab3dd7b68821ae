"""Keep freed memory in the process: large tensors otherwise cost a page fault per 4 KiB, each step.

glibc serves every block above 128 KiB to 32 MiB with a fresh ``mmap`` and gives it back when freed,
so that each training step touches all its pages anew; in virtual machines that can cost more than
the arithmetic. Blocks kept on the heap are reused as they are.
"""

from __future__ import annotations

import ctypes
import sys

from uncal.system.disk import chain_of

_SAID = ("out of memory", "can't allocate memory", "is killed by signal", "exited unexpectedly")
"""What torch says where it raises a plain RuntimeError; the last of a loading process."""

_M_TRIM_THRESHOLD = -1
_M_TOP_PAD = -2
_M_MMAP_MAX = -4


def keep_freed_memory() -> bool:
    """Tell glibc's allocator to reuse large blocks; does nothing elsewhere than on glibc.

    Call it once at the start of a process, before large tensors are made; it says whether the
    allocator took the settings. Peak memory is the same; memory freed at the peak stays.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except AttributeError:
        return False
    return all(
        mallopt(option, value) == 1
        for option, value in (
            (_M_MMAP_MAX, 0),
            (_M_TRIM_THRESHOLD, 2**31 - 1),
            (_M_TOP_PAD, 64 * 2**20),
        )
    )


def memory_trouble(error: BaseException) -> str | None:
    """What a user can do about an error for lack of memory; None for any other error.

    >>> memory_trouble(RuntimeError("CUDA error: out of memory"))[:30]
    'CUDA error: out of memory. Low'
    >>> memory_trouble(ValueError("x"))
    """
    for cause in chain_of(error):
        said = (str(cause).splitlines() or [""])[0]
        lacking = isinstance(cause, MemoryError) or type(cause).__name__ == "OutOfMemoryError"
        if lacking or (isinstance(cause, RuntimeError) and any(words in said for words in _SAID)):
            return (
                f"{(said or 'out of memory').rstrip('. ')}. Lower dataset.loader.batch_size (in "
                "training), dataset.loader.eval_batch_size and mcd.chunk (stochastic passes), "
                "dataset.loader.workers or dataset.image_size, or set dataset.loader.cache=false; "
                "the same command then goes on after the last finished epoch where the settings "
                "of the training are the same."
            )
    return None
