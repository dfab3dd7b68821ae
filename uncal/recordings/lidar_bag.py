"""The LiDAR scans of a ROS 1 bag, read one by one through ``rosbags``, which needs no ROS."""

from __future__ import annotations

import logging
import os
import struct
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from uncal.errors import FrameError, NothingPaired, RecordingError
from uncal.recordings.bag_messages import stamp_ns
from uncal.recordings.lidar_index import LidarIndex, cached_index
from uncal.recordings.motion import Spin
from uncal.recordings.point_cloud2 import (
    BYTE,
    brightest_of,
    has_intensity,
    read_points,
    sweep_end,
    sweep_spin,
)

if TYPE_CHECKING:
    from rosbags.typesys.stores.ros1_noetic import sensor_msgs__msg__PointCloud2 as PointCloud2

log = logging.getLogger(__name__)

TOPIC = "/velodyne_points"
"""DSEC's topic of decoded scans."""

_MESSAGE_TYPE = "sensor_msgs/msg/PointCloud2"

# What rosbags lets through when the bytes are not what they should be, its asserts among them.
_DAMAGE = (
    *(ReaderError, SerdeError, AssertionError, EOFError, LookupError),
    *(OSError, RuntimeError, ValueError, struct.error),
)


class LidarBag:
    """Random access to the scans of one ``.bag`` file.

    The bag is read once for its index. Afterwards a scan costs one chunk: rosbags finds it by its
    record time. The open file belongs to the process that opened it; pickling leaves it behind
    and a forked worker opens its own, since the two would share one file position.

    Raises:
        RecordingError: the bag is missing, truncated or without a readable scan.

    Attributes:
        path: the file.
        index: its scans; positions below count in it.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise NothingPaired(f"no LiDAR recording at {path}")
        self.path = path
        self.index: LidarIndex = cached_index(path, index_scans)
        self._opened: tuple[int, Reader] | None = None
        self._last: tuple[int, PointCloud2] | None = None
        self._brightest: float | None = None
        self._has_intensity = True

    def intensity_note(self) -> str:
        """What a reader must know of the points' reflectance; empty if it is as in DSEC."""
        brightest = self._full_scale()
        if not self._has_intensity:
            return "its points have no intensity: their reflectance is read as 0"
        if brightest != BYTE:
            return f"intensities beyond {BYTE:.0f}: read as 0 to {brightest:.0f}"
        return ""

    def _full_scale(self) -> float:
        """Of all scans as of the first, so that every loading process reads them alike."""
        if self._brightest is None:
            first = int(self.index.message_ns[0])
            self._brightest = BYTE
            try:
                for _, scan in _scans(self._reader(), start=first, stop=first + 1):
                    self._has_intensity = has_intensity(scan)
                    self._brightest = brightest_of(scan)
                    break
            except _DAMAGE as error:
                log.warning("%s: its first scan cannot be read (%s)", self.path, error)
        return self._brightest

    def read(self, position: int) -> tuple[NDArray[np.float32], int]:
        """One scan, by its position in :attr:`index`.

        Returns:
            (N, 4) float32 x, y, z (metres, LiDAR frame) and reflectance in 0..1, N ≥ 1, and how
            many points were dropped because they were not finite.

        Raises:
            FrameError: the scan cannot be read or holds no finite point.
        """
        with self._damage_named(position):
            points, n_dropped = read_points(self._scan(position), self._full_scale())
        if not len(points):
            raise FrameError(
                f"{self.path}: none of the {n_dropped} points of {self._named(position)} is finite."
            )
        return points, n_dropped

    def points(self, position: int) -> NDArray[np.float32]:
        """What :meth:`read` gives, without the count."""
        return self.read(position)[0]

    def spin(self, position: int) -> Spin | None:
        """When a scan was measured, after its stamp; None where its points do not say.

        Raises:
            FrameError: the scan cannot be read.
        """
        with self._damage_named(position):
            return sweep_spin(self._scan(position))

    @contextmanager
    def _damage_named(self, position: int) -> Iterator[None]:
        try:
            yield
        except _DAMAGE as error:
            raise FrameError(
                f"{self.path}: {self._named(position)} cannot be read ({error})."
            ) from error

    def _scan(self, position: int) -> PointCloud2:
        """The message; the last one is kept."""
        if self._last is None or self._last[0] != position:
            message_ns = int(self.index.message_ns[position])
            stamp = int(self.index.stamp_ns[position])
            for _, scan in _scans(self._reader(), start=message_ns, stop=message_ns + 1):
                if stamp_ns(scan) == stamp:
                    self._last = (position, scan)
                    break
            else:
                raise ValueError("the bag has changed since it was indexed")
        return self._last[1]

    def _named(self, position: int) -> str:
        return f"the scan stamped {int(self.index.stamp_ns[position]) / 1e9:.6f}"

    def _reader(self) -> Reader:
        if self._opened is None or self._opened[0] != os.getpid():
            reader = Reader(self.path)
            reader.open()
            weakref.finalize(self, reader.close)
            self._opened = (os.getpid(), reader)
        return self._opened[1]

    def __getstate__(self) -> dict[str, object]:
        """Everything but the open file and the last scan."""
        return {**self.__dict__, "_opened": None, "_last": None}


def index_scans(path: Path) -> LidarIndex:
    """Read a bag from end to end and note its scans.

    Damage in the middle ends the reading; the scans before it are kept, the others counted.

    Raises:
        RecordingError: the bag is truncated, has no scans, or none that can be read.
    """
    reader = Reader(path)
    try:
        reader.open()
    except _DAMAGE as error:
        raise RecordingError(
            f"{path} is no complete ROS 1 bag ({error}); its index is at its end, so a part of it "
            "is of no use. Copy it again."
        ) from error
    rows: list[tuple[int, int, int, int]] = []
    reason = ""
    try:
        n_scans = sum(connection.msgcount for connection in _connections(reader))
        if n_scans == 0:
            topics = ", ".join(sorted({connection.topic for connection in reader.connections}))
            raise RecordingError(
                f"{path} has no {_MESSAGE_TYPE} on the topic {TOPIC}; its topics are "
                f"{topics or 'none'}."
            )
        try:
            for message_ns, scan in _scans(reader):
                try:
                    rows.append(_row(message_ns, scan))
                except ValueError as error:
                    reason = str(error)
        except _DAMAGE as error:
            reason = f"damaged after {len(rows)} scans: {error}"
    finally:
        with suppress(ReaderError):
            reader.close()
    if not rows:
        raise RecordingError(f"{path}: none of its {n_scans} scans can be read ({reason}).")
    return LidarIndex.from_scans(np.array(rows, dtype=np.int64), n_scans - len(rows), reason)


def _row(message_ns: int, scan: PointCloud2) -> tuple[int, int, int, int]:
    n_points = scan.height * scan.width
    if n_points == 0:
        raise ValueError("the point cloud is empty")
    # The times are float32: nanoseconds would be its rounding errors.
    stamp = stamp_ns(scan)
    return message_ns, stamp, stamp + 1000 * round(sweep_end(scan) * 1e6), n_points


def _connections(reader: Reader) -> list[Connection]:
    return [
        connection
        for connection in reader.connections
        if connection.topic == TOPIC and connection.msgtype == _MESSAGE_TYPE
    ]


def _scans(
    reader: Reader, start: int | None = None, stop: int | None = None
) -> Iterator[tuple[int, PointCloud2]]:
    """Record times and scans; ``start`` and ``stop`` are record times, nanoseconds."""
    for _, message_ns, raw in reader.messages(_connections(reader), start, stop):
        yield message_ns, cast("PointCloud2", _types().deserialize_ros1(raw, _MESSAGE_TYPE))


@cache
def _types() -> Typestore:
    # 0.2 s; only processes that read a scan pay it.
    return get_typestore(Stores.ROS1_NOETIC)
