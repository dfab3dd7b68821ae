"""ROS's ``sensor_msgs/PointCloud2``: points laid out as the message says, read without ROS.

A message names its fields with offsets and types, so that drivers differ in order, padding and
precision; see http://docs.ros.org/en/noetic/api/sensor_msgs/html/msg/PointCloud2.html. A message
that is shorter than it says is a ValueError everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uncal.recordings.motion import Spin

if TYPE_CHECKING:  # ROS 2's has the same members
    from rosbags.typesys.stores.ros1_noetic import sensor_msgs__msg__PointCloud2 as PointCloud2

_FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""PointField.datatype → numpy type, without its byte order."""

BYTE = 255.0
"""Velodyne's calibrated reflectivity is one byte; its drivers publish it in whatever type."""

WORD = 65535.0
"""Other makers' intensities have 16 bits."""

_LONGEST_SWEEP_S = 1.0
"""Velodynes turn at 5 to 20 Hz; a larger ``time`` is an absolute time or not in seconds."""

_FEWEST_TIMES = 100
"""Points with a time that tell how fast the LiDAR turns."""


def read_points(message: PointCloud2, brightest: float = BYTE) -> tuple[NDArray[np.float32], int]:
    """Points of a message; those that are not finite are dropped.

    Args:
        message: with the fields x, y, z (metres) and perhaps intensity, in any order and type.
        brightest: intensity that stands for a reflectance of 1; see :func:`brightest_of`.

    Returns:
        (N, 4) float32 x, y, z and reflectance in 0..1, and how many points were dropped. Without
        the field intensity the reflectance is 0.

    Raises:
        ValueError: a field is missing.
    """
    names = ("x", "y", "z", "intensity") if has_intensity(message) else ("x", "y", "z")
    columns = _columns(message, names)
    points = np.zeros((len(columns[0]), 4), dtype=np.float32)
    for number, column in enumerate(columns):
        points[:, number] = column
    points[:, 3] /= brightest
    finite = np.isfinite(points).all(axis=1)
    n_dropped = int(len(points) - np.count_nonzero(finite))
    return (points[finite] if n_dropped else points), n_dropped


def has_intensity(message: PointCloud2) -> bool:
    """Whether the points say how bright they are."""
    return any(field.name == "intensity" for field in message.fields)


def brightest_of(message: PointCloud2) -> float:
    """:data:`BYTE` or :data:`WORD`: which intensity is a reflectance of 1, by one message."""
    if not has_intensity(message):
        return BYTE
    (column,) = _columns(message, ("intensity",))
    values = column.astype(np.float64)
    values = values[np.isfinite(values)]
    return WORD if values.size and float(values.max()) > BYTE else BYTE


def sweep_end(message: PointCloud2) -> float:
    """When the last point was measured, in seconds after the stamp of the message.

    The field ``time`` counts from the stamp, whatever that is: Velodyne's ROS driver stamps the
    last packet by default (times up to 0) and the first one on request (times from 0 on). The
    largest one is the end of the sweep either way.

    Returns:
        Seconds; 0 where the message has no such field or it does not hold seconds in a sweep.
    """
    if not any(field.name == "time" for field in message.fields):
        return 0.0
    (times,) = _columns(message, ("time",))
    times = times[np.isfinite(times)]
    if times.dtype.kind != "f" or times.size == 0:
        return 0.0
    last = float(times.max())
    return last if abs(last) < _LONGEST_SWEEP_S else 0.0


def sweep_spin(message: PointCloud2) -> Spin | None:
    """When a sweep was measured, from its points' times, after the stamp of the message.

    Returns:
        ``ahead_s`` counts from the stamp. None where there are no times, or they do not fall with
        the azimuth as a Velodyne's do.
    """
    if not any(field.name == "time" for field in message.fields):
        return None
    x, y, times = (column.astype(np.float64) for column in _columns(message, ("x", "y", "time")))
    azimuth = np.arctan2(y, x)
    # Ahead only: behind, a sweep begins and ends.
    kept = np.isfinite(times) & (np.abs(azimuth) < np.pi / 4)
    if np.count_nonzero(kept) < _FEWEST_TIMES or np.ptp(times[kept]) == 0:
        return None
    slope, ahead = np.polyfit(-azimuth[kept] / (2 * np.pi), times[kept], 1)
    left = times[kept] - ahead + slope * azimuth[kept] / (2 * np.pi)
    usual = 0.02 < slope < 0.4 and np.median(np.abs(left)) < 0.02 * slope
    return Spin(float(slope), float(ahead)) if usual else None


def _columns(message: PointCloud2, names: Sequence[str]) -> list[NDArray[np.generic]]:
    """One flat array of ``height · width`` values per name, without a copy where possible."""
    fields = {field.name: field for field in message.fields}
    if absent := [name for name in names if name not in fields]:
        raise ValueError(
            f"the point cloud has no field {', '.join(absent)}; it has {', '.join(fields)}"
        )
    shape = (message.height, message.width)
    if 0 in shape:
        return [np.empty(0, dtype=np.float32) for _ in names]
    order = ">" if message.is_bigendian else "<"
    # One row needs no row_step, and some publishers leave it 0 for many rows too.
    dense = message.width * message.point_step
    row_step = message.row_step if message.height > 1 and message.row_step else dense
    needed = (message.height - 1) * row_step + dense
    data = np.asarray(message.data, dtype=np.uint8)
    if data.size < needed or row_step < dense:
        raise ValueError(
            f"the point cloud holds {data.size} bytes in rows of {row_step}, but says it has "
            f"{message.height}×{message.width} points of {message.point_step} bytes"
        )
    columns = []
    for field in (fields[name] for name in names):
        if field.datatype not in _FORMATS:
            raise ValueError(f"field {field.name} has the unknown datatype {field.datatype}")
        dtype = np.dtype(order + _FORMATS[field.datatype])
        if field.offset + dtype.itemsize > message.point_step:
            raise ValueError(
                f"field {field.name} ends at byte {field.offset + dtype.itemsize} of a point of "
                f"{message.point_step} bytes"
            )
        column: NDArray[np.generic] = np.ndarray(
            shape, dtype, data, offset=field.offset, strides=(row_step, message.point_step)
        )
        columns.append(column.reshape(-1))
    return columns
