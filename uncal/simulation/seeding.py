"""Independent random streams, named by what they are for: neither order nor processes matter."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What a random stream is for; part of its key, so streams never share numbers."""

    TEXTURES = 0
    RIG = 1
    STREET = 2
    TRAJECTORY = 3
    CAMERA = 4
    LIDAR = 5
    MOTION = 6
    EVENTS = 7
    EVENT_PIXELS = 8
    STEREO = 9
    SPEED = 10
    VIBRATION = 11


def generator(seed: int, stream: Stream, *indices: int) -> np.random.Generator:
    """The random generator of one stream.

    >>> a, b = (generator(1, Stream.RIG, i).integers(2**62) for i in (0, 1))
    >>> bool(a == generator(1, Stream.RIG, 0).integers(2**62)), bool(a == b)
    (True, False)
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream, *indices)))
