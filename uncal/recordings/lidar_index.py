"""What is known of a bag's scans without opening it again: when each was taken, its points."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

log = logging.getLogger(__name__)

CACHE_NAME = ".uncal_index.npz"
"""The cached index, beside the bag; safe to delete."""

_VERSION = 1
_GAP = 1.5
"""A pause of more than this many median intervals is a gap: at least one scan is missing."""


@dataclass(frozen=True)
class LidarIndex:
    """The readable scans of one bag, in the order of their stamps.

    Attributes:
        message_ns: (n,) int64 time of the record in the bag, UNIX nanoseconds; finds the message.
        stamp_ns: (n,) int64 stamp of the header.
        end_ns: (n,) int64 time of the scan's last point.
        n_points: (n,) int64 points of the message, non-finite ones among them.
        n_duplicates: scans left out because another one carries the same stamp.
        n_damaged: scans left out because they could not be read.
        damage: why; empty if ``n_damaged`` is 0.
    """

    message_ns: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    end_ns: NDArray[np.int64]
    n_points: NDArray[np.int64]
    n_duplicates: int
    n_damaged: int
    damage: str

    def __len__(self) -> int:
        """Number of readable scans."""
        return len(self.stamp_ns)

    @property
    def rate(self) -> float:
        """Scans per second while the LiDAR runs: 1 / median interval; NaN below two scans."""
        return float(1e9 / np.median(np.diff(self.stamp_ns))) if len(self) > 1 else float("nan")

    @property
    def n_gaps(self) -> int:
        """Intervals of more than 1.5 times the median."""
        intervals = np.diff(self.stamp_ns)
        return int((intervals > _GAP * np.median(intervals)).sum()) if len(self) > 1 else 0

    @classmethod
    def from_scans(
        cls, scans: NDArray[np.int64], n_damaged: int = 0, damage: str = ""
    ) -> LidarIndex:
        """Sort (n, 4) scans (record time, stamp, end, points) by stamp; repeated ones are left out.

        >>> index = LidarIndex.from_scans(np.array([[5, 2, 3, 9], [4, 1, 2, 9], [6, 2, 3, 9]]))
        >>> index.stamp_ns.tolist(), index.message_ns.tolist(), index.n_duplicates
        ([1, 2], [4, 5], 1)
        """
        _, kept = np.unique(scans[:, 1], return_index=True)
        message, stamp, end, n_points = np.ascontiguousarray(scans[kept].T)
        return cls(message, stamp, end, n_points, len(scans) - len(kept), n_damaged, damage)


def cached_index(bag: Path, build: Callable[[Path], LidarIndex]) -> LidarIndex:
    """The index of a bag: the one kept beside it if it is of this very file, else a new one.

    A new one is kept for the next time where the folder can be written to.
    """
    cache, status = bag.with_name(CACHE_NAME), bag.stat()
    identity = np.array([_VERSION, status.st_size, status.st_mtime_ns], dtype=np.int64)
    try:
        with np.load(cache, allow_pickle=False) as kept:
            if np.array_equal(kept["identity"], identity):
                # The numbers and the text that stand alone come as arrays without a dimension.
                known = {name: kept[name] for name in LidarIndex.__dataclass_fields__}
                return LidarIndex(**{k: v if v.ndim else v.item() for k, v in known.items()})
    except FileNotFoundError:
        pass
    except Exception as error:  # whatever is wrong with a cache, the bag itself is still there
        log.warning("ignoring the damaged index %s: %s", cache, error)
    log.info("indexing %s (%.1f GB), once", bag, status.st_size / 1e9)
    index = build(bag)
    # Renamed when complete: several runs may share the recordings.
    draft = cache.with_name(f"{cache.stem}.{os.getpid()}.npz")
    try:
        np.savez(draft, identity=identity, **vars(index))
        draft.replace(cache)
    except OSError as error:
        log.info("the index of %s stays in memory only: %s", bag.parent, error)
        draft.unlink(missing_ok=True)
    return index
