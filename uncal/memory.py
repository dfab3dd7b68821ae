"""Keep freed memory in the process: large tensors otherwise cost a page fault per 4 KiB, each step.

glibc serves every block above 128 KiB to 32 MiB with a fresh ``mmap`` and gives it back when freed,
so that each training step touches all its pages anew; in virtual machines that can cost more than
the arithmetic. Blocks kept on the heap are reused as they are.
"""

from __future__ import annotations

import ctypes
import sys

_M_TRIM_THRESHOLD = -1
_M_TOP_PAD = -2
_M_MMAP_MAX = -4


def keep_freed_memory() -> bool:
    """Tell glibc's allocator to reuse large blocks; does nothing elsewhere than on glibc.

    Call it once at the start of a process, before large tensors are made. Peak memory is the same;
    memory freed at the peak stays with the process.

    Returns:
        Whether the allocator took the settings.

    >>> isinstance(keep_freed_memory(), bool)
    True
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
