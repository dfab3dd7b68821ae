"""DSEC's ``events.h5`` and ``rectify_map.h5``: windows of events, never the whole file.

::

    events.h5        events/{x, y, t, p}    one entry per event, compressed (Blosc)
                     ms_to_idx              millisecond → first event at or after it
                     t_offset               microseconds, to be added to t
    rectify_map.h5   rectify_map            (H, W, 2): [y, x] → (x, y) of the rectified image
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py  # type: ignore[import-untyped]
import hdf5plugin  # noqa: F401  # registers Blosc with h5py
import numpy as np
from numpy.typing import NDArray

from uncal.errors import CalibrationMissing, FrameError, NothingPaired, RecordingError
from uncal.events.stream import Events

# What h5py raises on a truncated file, a missing dataset, a broken chunk, an odd type.
_DAMAGE = (OSError, LookupError, RuntimeError, TypeError, ValueError)

_COLUMNS = ("x", "y", "t", "p")


@dataclass(frozen=True)
class EventFile:
    """The events of one camera in one sequence; every file is opened anew for each window.

    An open HDF5 file must not cross a fork, and opening one costs less than a window's events.

    Attributes:
        path: the ``events.h5``.
        t_offset: microseconds from the file's times to the recording's clock.
        first_us: time of the first event, microseconds, without ``t_offset``.
        end_us: end of the span that ``ms_to_idx`` reaches, exclusive, without ``t_offset``.
        n_events: number of events.
        rectify_map: (H, W, 2) float32, [y, x] → (x, y) of the rectified image, pixels.
    """

    path: Path
    t_offset: int
    first_us: int
    end_us: int
    n_events: int
    rectify_map: NDArray[np.float32]

    def count_at_most(
        self, start_us: NDArray[np.int64], end_us: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """(n,) upper bounds of the events in windows, exclusive of their ends, by ``ms_to_idx``.

        Raises:
            RecordingError: the file cannot be read.
        """
        with _opened(self.path, RecordingError) as file:
            first_of_ms = np.append(file["ms_to_idx"][:].astype(np.int64), self.n_events)
        last = len(first_of_ms) - 1
        stop = first_of_ms[np.minimum(-(-end_us // 1000), last)]
        counts: NDArray[np.int64] = stop - first_of_ms[np.clip(start_us // 1000, 0, last)]
        return counts

    def read(self, start_us: int, end_us: int) -> Events:
        """The events from ``start_us`` to ``end_us``, exclusive (without ``t_offset``), rectified.

        Raises:
            FrameError: the file cannot be read, or contradicts itself in this window.
        """
        with _opened(self.path, FrameError) as file:
            first_of_ms, columns = file["ms_to_idx"], file["events"]
            first_ms, last_ms = max(start_us // 1000, 0), -(-end_us // 1000)
            first = int(first_of_ms[first_ms])
            last = int(first_of_ms[last_ms]) if last_ms < len(first_of_ms) else self.n_events
            t = columns["t"][first:last].astype(np.int64)
            if len(t) and (
                t[0] < 1000 * first_ms or t[-1] >= 1000 * last_ms or (np.diff(t) < 0).any()
            ):
                raise FrameError(
                    f"{self.path}: the events of the milliseconds {first_ms} to {last_ms} are not "
                    "in order, or ms_to_idx points elsewhere; damaged, copy it again."
                )
            begin, stop = np.searchsorted(t, (start_us, end_us))
            inside = slice(first + int(begin), first + int(stop))
            x = columns["x"][inside].astype(np.intp)
            y = columns["y"][inside].astype(np.intp)
            p = columns["p"][inside] > 0
        height, width = self.rectify_map.shape[:2]
        if len(x) and not (0 <= x.min() <= x.max() < width and 0 <= y.min() <= y.max() < height):
            raise FrameError(
                f"{self.path}: events at x {x.min()}..{x.max()}, y {y.min()}..{y.max()}, but the "
                f"rectification map is for {width}×{height} pixels."
            )
        rectified = self.rectify_map[y, x]
        return Events(
            x=np.ascontiguousarray(rectified[:, 0]),
            y=np.ascontiguousarray(rectified[:, 1]),
            t=t[begin:stop] + self.t_offset,
            p=p,
            window=(start_us + self.t_offset, end_us + self.t_offset),
            size=(height, width),
        )


def inspect_events(path: Path, rectify_map: NDArray[np.float32]) -> EventFile:
    """Look at where the events of an ``events.h5`` lie in time, without reading them.

    Raises:
        RecordingError: the file is missing, truncated or not of this layout.
    """
    if not path.is_file():
        raise NothingPaired(f"{path} is missing.")
    with _opened(path, RecordingError) as file:
        lengths = {name: file["events"][name].shape for name in _COLUMNS}
        first_of_ms = file["ms_to_idx"][:].astype(np.int64)
        n_events = int(lengths["t"][0])
        if len(set(lengths.values())) > 1 or n_events == 0:
            raise RecordingError(f"{path}: events/ holds {lengths}, expected one length above 0.")
        if not len(first_of_ms) or (np.diff(first_of_ms) < 0).any() or first_of_ms[-1] > n_events:
            raise RecordingError(
                f"{path}: ms_to_idx does not rise from 0 to the {n_events} events; damaged."
            )
        first_us, last_us = int(file["events"]["t"][0]), int(file["events"]["t"][n_events - 1])
        t_offset = int(file["t_offset"][()])
    if last_us < first_us:
        raise RecordingError(
            f"{path}: its last event is {(first_us - last_us) / 1e6:.3f} s earlier than its first "
            "one; the times are out of order."
        )
    # Up to there a window needs only the entries that ms_to_idx has.
    indexed_us = 1000 * len(first_of_ms)
    end_us = last_us + 1 if last_us < indexed_us else indexed_us - 1000
    return EventFile(path, t_offset, first_us, end_us, n_events, rectify_map)


def read_rectify_map(path: Path) -> NDArray[np.float32]:
    """(H, W, 2) float32 of a ``rectify_map.h5``: [y, x] → (x, y) of the rectified image, pixels.

    Raises:
        RecordingError: the file is missing, truncated or not of this layout.
    """
    if not path.is_file():
        raise CalibrationMissing(f"{path} is missing.")
    with _opened(path, RecordingError) as file:
        rectify_map = np.asarray(file["rectify_map"][()], dtype=np.float32)
    if rectify_map.ndim != 3 or rectify_map.shape[2] != 2 or not np.isfinite(rectify_map).all():
        raise RecordingError(
            f"{path}: rectify_map has the shape {rectify_map.shape}, expected finite (H, W, 2)."
        )
    return rectify_map


@contextmanager
def _opened(path: Path, error_class: type[FrameError | RecordingError]) -> Iterator[h5py.File]:
    """The file, open; what h5py raises in the ``with`` block becomes ``error_class``."""
    try:
        # Recordings are often on file systems where HDF5's locks are refused.
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except FileNotFoundError as error:
        raise error_class(f"{path} is missing.") from error
    except _DAMAGE as error:
        raise error_class(
            f"{path} cannot be read ({error}); truncated or damaged, copy it again."
        ) from error
