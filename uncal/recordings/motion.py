"""A spinning LiDAR measures while the vehicle drives: undoing that, where the motion is known.

KITTI raw reports every return from where the LiDAR was when it fired. At 12 m/s a return at 45° is
displaced by 15 cm, to one side ahead and to the other behind, and the edges of a whole sweep with
it: that looks like a pose, and no averaging over frames takes it out.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uncal.errors import FrameError

REVOLUTION_S = 0.1
"""Time of one revolution of a Velodyne at 10 Hz."""

_FIELDS, _LINEAR, _ANGULAR = 30, slice(8, 11), slice(20, 23)
"""Of KITTI's OXTS lines: forward, leftward, upward velocity; rates about these axes."""


def read_oxts(path: Path, R_lidar_imu: NDArray[np.float64]) -> NDArray[np.float64]:
    """Velocity and turn rate of a vehicle from one of KITTI raw's OXTS files.

    Args:
        path: the text file of one frame, 30 numbers.
        R_lidar_imu: (3, 3) rotation IMU → LiDAR. That the IMU sits elsewhere than the LiDAR is
            left out: at usual turn rates it moves the LiDAR by millimetres in a sweep.

    Returns:
        (6,) in the LiDAR frame, metres and radians per second.

    Raises:
        FrameError: the file is missing, damaged or not finite.
    """
    remedy = "restore it, or read sweeps as they are with dataset.recording.untwist=false"
    try:
        numbers = np.array(path.read_text(encoding="utf-8").split(), np.float64)
    except OSError as error:
        raise FrameError(f"{path}: cannot be read ({error.strerror}); {remedy}.") from error
    except ValueError as error:
        raise FrameError(f"{path}: {error}, expected {_FIELDS} numbers; {remedy}.") from error
    if len(numbers) < _FIELDS or not np.isfinite(numbers[:23]).all():
        raise FrameError(
            f"{path}: {len(numbers)} numbers, expected {_FIELDS} finite ones; {remedy}."
        )
    return np.concatenate([R_lidar_imu @ numbers[_LINEAR], R_lidar_imu @ numbers[_ANGULAR]])


class Spin(NamedTuple):
    """When a spinning LiDAR measures what; the defaults are KITTI's.

    Attributes:
        revolution_s: seconds for a revolution; azimuth falls as time goes on.
        ahead_s: seconds from the camera's moment until the LiDAR looks straight ahead.
    """

    revolution_s: float = REVOLUTION_S
    ahead_s: float = 0.0


KITTI_SPIN = Spin()


def untwisted(
    rows: NDArray[np.float32], twist: NDArray[np.float64], spin: Spin = KITTI_SPIN
) -> NDArray[np.float32]:
    """What a sweep would be had all of it been measured at the camera's moment.

    A Velodyne turns clockwise seen from above, so that azimuth falls as time goes on; KITTI's
    cameras are triggered when it looks ahead.

    Args:
        rows: (N, C) float32 whose first three columns are a position, LiDAR frame, metres.
        twist: (6,) velocity and turn rate in the LiDAR frame, metres and radians per second.
        spin: when the sweep was measured.

    Returns:
        The same shape; the other columns as they were.

    >>> point = np.array([[0.0, 5.0, 0.0]], np.float32)
    >>> untwisted(point, np.array([8.0, 0.0, 0.0, 0.0, 0.0, 0.0])).astype(float).round(2).tolist()
    [[-0.2, 5.0, 0.0]]
    """
    position = rows[:, :3].astype(np.float64)
    share = -np.arctan2(position[:, 1], position[:, 0]) / (2 * np.pi)
    delay = share * spin.revolution_s + spin.ahead_s
    # To first order: a turn of 1° within a sweep leaves less than a millimetre at 10 m.
    moved = twist[:3] + np.cross(twist[3:], position)
    result = np.array(rows, np.float32)
    result[:, :3] = position + delay[:, None] * moved
    return result
