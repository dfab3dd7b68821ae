"""The vehicle's motion as KITTI raw's inertial system would report it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

OXTS_FIELDS = 30
VELOCITY = 8
"""Number of the first of forward, leftward and upward velocity."""


def oxts_line(velocity: NDArray[np.float64]) -> str:
    """One file of ``oxts/data``: the velocity, and nothing of what else KITTI has there.

    Args:
        velocity: (3,) forward, leftward, upward in the LiDAR frame, metres per second.

    Returns:
        30 numbers.
    """
    fields = np.zeros(OXTS_FIELDS)
    fields[VELOCITY : VELOCITY + 3] = velocity
    return " ".join(f"{value:.6g}" for value in fields) + "\n"
