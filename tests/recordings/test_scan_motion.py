"""Motion from two sweeps of posts, which is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.errors import FrameError
from uncal.recordings.scan_motion import SweepMotion, twist_between


def posts(rng: np.random.Generator, n: int = 60) -> NDArray[np.float64]:
    """(n, 2) places of posts, and not one like another."""
    return np.column_stack([rng.uniform(4, 45, n), rng.uniform(-15, 15, n)])


def seen_from(
    where: NDArray[np.float64], ahead: float, angle: float, twist: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(n, 3) of a LiDAR that has driven on and turned, distorted by its motion."""
    moved = where - [ahead, 0]
    cos, sin = np.cos(angle), np.sin(angle)
    there = np.column_stack([moved @ [cos, sin], moved @ [-sin, cos], np.zeros(len(where))])
    delay = -np.arctan2(there[:, 1], there[:, 0]) / (2 * np.pi) * 0.1
    seen = there - delay[:, None] * (twist[:3] + np.cross(twist[3:], there))
    return np.asarray(seen, np.float32)


@pytest.mark.parametrize("speed", [-2.0, 0.0, 3.0, 14.0, 38.0])
@pytest.mark.parametrize("turn", [-0.3, 0.0, 0.3])
def test_finds_the_motion_that_was(speed: float, turn: float) -> None:
    rng = np.random.default_rng(0)
    where = posts(rng)
    twist = np.array([speed, 0, 0, 0, 0, turn])
    first = seen_from(where, 0.0, 0.0, twist)
    second = seen_from(where, 0.1 * speed, 0.1 * turn, twist)
    noise = rng.normal(0, 0.02, second.shape).astype(np.float32)
    found = twist_between(first, second + noise, 0.1)
    assert found is not None
    assert found[0] == pytest.approx(speed, abs=0.15)
    assert found[5] == pytest.approx(turn, abs=0.02)
    assert (found[1:5] == 0).all()


def test_a_turn_between_sweeps_far_apart_is_not_the_turn_at_one() -> None:
    where = posts(np.random.default_rng(1))
    twist = np.array([8.0, 0, 0, 0, 0, 0])
    found = twist_between(
        seen_from(where, 0, 0, twist), seen_from(where, 0.4 * 8, 0.05, twist), 0.4
    )
    assert found is not None
    assert found[0] == pytest.approx(8, abs=0.15)
    assert found[5] == 0


def test_two_other_places_tell_nothing() -> None:
    rng = np.random.default_rng(2)
    still = np.zeros(6)
    first, second = (seen_from(posts(rng), 0, 0, still) for _ in range(2))
    assert twist_between(first, second, 0.1) is None
    assert twist_between(first[:20], first[:20], 0.1) is None


def test_unknown_times_and_unreadable_neighbours_give_none() -> None:
    def read(position: int) -> NDArray[np.float32]:
        raise FrameError("damaged")

    assert SweepMotion(read, np.array([0.0, np.nan])).twist(1) is None
    assert SweepMotion(read, np.array([0.0, 5.0])).twist(1) is None
    assert SweepMotion(read, np.array([0.0])).twist(0) is None
    assert SweepMotion(read, np.array([0.0, 0.1])).twist(1) is None
