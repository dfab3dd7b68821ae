"""DSEC's two clocks: UNIX time in the LiDAR's bag, microseconds since UTC midnight in the events.

The events do not say which day it was, so the two can only be compared modulo a day. A sequence
that runs past midnight goes on counting.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DAY_US = 86_400_000_000
"""Microseconds of a day."""


def on_event_clock(
    time_ns: NDArray[np.int64],  # (n,) UNIX nanoseconds
    t_offset_us: int,
    first_us: int,
) -> NDArray[np.int64]:
    """Times of scans on the clock that a sequence's events count on.

    ``first + ((time - t_offset - first) mod day)``: whatever day the events were recorded on, a
    scan taken during them comes out between their first and their last time. A scan taken before
    them comes out almost a day later.

    Args:
        time_ns: (n,) UNIX times, nanoseconds; rounded down, so that no event after the scan enters.
        t_offset_us: the file's ``t_offset``, microseconds.
        first_us: time of the first event, microseconds, as in the file (without ``t_offset``).

    Returns:
        (n,) microseconds, in [first_us, first_us + one day), without ``t_offset``.

    >>> day, midnight = 19_000, 86_400
    >>> scan_ns = np.array([(day * midnight + 60) * 1_000_000_000 + 7_999])
    >>> on_event_clock(scan_ns, t_offset_us=59_000_000, first_us=0).tolist()
    [1000007]
    """
    return first_us + (time_ns // 1000 - t_offset_us - first_us) % DAY_US


def clock_time(time_us: int) -> str:
    """``HH:MM:SS`` in UTC, from microseconds since some UTC midnight, for a message.

    >>> clock_time(DAY_US + 3_661_000_000)
    '01:01:01'
    """
    seconds = time_us % DAY_US // 1_000_000
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
