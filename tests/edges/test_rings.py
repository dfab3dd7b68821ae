"""Sweeps as sensors and files order them; the lasers are known, and must be found."""

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.edges.rings import rings

STEP = 0.4
HDL = np.linspace(-24.0, 2.0, 24)
VLP = np.linspace(-15.0, 15.0, 16)


def points_at(
    azimuth_deg: NDArray[np.float64], elevation_deg: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(N, 4) returns at ranges that vary, as a street's do."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    distance = 12.0 + 6.0 * np.sin(3 * azimuth) + np.cos(11 * elevation)
    flat = distance * np.cos(elevation)
    xyz = [flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)]
    return np.stack([*xyz, np.full_like(azimuth, 0.5)], -1).astype(np.float32)


def azimuth_of(points: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.arctan2(points[:, 1], points[:, 0]).astype(np.float64)


def assert_turning_left(points: NDArray[np.float32], ring: NDArray[np.intp]) -> None:
    """Along each laser azimuths ascend."""
    step = (np.diff(azimuth_of(points)) + np.pi) % (2 * np.pi) - np.pi
    assert (step[np.diff(ring) == 0] > 0).all()


@pytest.mark.parametrize("lost", [0.0, 0.2])
@pytest.mark.parametrize("elevations", [HDL, HDL[::-1]])
def test_laser_by_laser_over_part_of_a_revolution(
    elevations: NDArray[np.float64], lost: float
) -> None:
    azimuth = np.arange(-45.0, 45.0, STEP)
    laser = np.repeat(np.arange(len(elevations)), len(azimuth))
    kept = np.random.default_rng(0).random(len(laser)) >= lost
    points = points_at(np.tile(azimuth, len(elevations)), elevations[laser])[kept]
    order, ring = rings(points)
    np.testing.assert_array_equal(order, np.arange(len(points)))
    np.testing.assert_array_equal(ring, laser[kept])
    assert_turning_left(points[order], ring)


@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_full_revolutions_that_begin_straight_ahead(lost: float) -> None:
    azimuth = np.arange(0.5 * STEP, 360.0, STEP)
    laser = np.repeat(np.arange(len(HDL)), len(azimuth))
    kept = np.random.default_rng(0).random(len(laser)) >= lost
    points = points_at(np.tile(azimuth, len(HDL)), HDL[::-1][laser])[kept]
    order, ring = rings(points)
    np.testing.assert_array_equal(order, np.arange(len(points)))
    np.testing.assert_array_equal(ring, laser[kept])
    assert_turning_left(points[order], ring)


def test_full_revolutions_with_a_hole_straight_ahead() -> None:
    # Nothing returns from the 40° in front, as on an open road.
    azimuth = np.arange(20.0, 340.0, STEP)
    laser = np.repeat(np.arange(len(HDL)), len(azimuth))
    points = points_at(np.tile(azimuth, len(HDL)), HDL[laser])
    _, ring = rings(points)
    np.testing.assert_array_equal(ring, laser)


@pytest.mark.parametrize("whole", [False, True])
def test_rotation_the_other_way_is_turned_round(whole: bool) -> None:
    azimuth = np.arange(-0.5 * STEP, -360.0, -STEP) if whole else np.arange(45.0, -45.0, -STEP)
    laser = np.repeat(np.arange(len(HDL)), len(azimuth))
    points = points_at(np.tile(azimuth, len(HDL)), HDL[laser])
    order, ring = rings(points)
    np.testing.assert_array_equal(order, np.arange(len(points))[::-1])
    np.testing.assert_array_equal(ring, (len(HDL) - 1 - laser)[::-1])
    assert_turning_left(points[order], ring)


@pytest.mark.parametrize("lost", [0.0, 0.2])
@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_column_by_column_in_the_order_of_firing(turn: float, lost: float) -> None:
    # A VLP-16 fires -15°, 1°, -13°, 3°, …: neighbours in the file are never neighbours in space.
    firing = np.stack([np.arange(8), np.arange(8, 16)], -1).ravel()
    azimuth = turn * np.arange(-60.0, 60.0, STEP)
    laser = np.tile(firing, len(azimuth))
    kept = np.random.default_rng(0).random(len(laser)) >= lost
    points = points_at(np.repeat(azimuth, 16), VLP[laser])[kept]
    order, ring = rings(points)
    assert sorted(order) == list(range(len(points)))
    np.testing.assert_array_equal(ring, laser[kept][order])
    assert (np.diff(ring) >= 0).all()
    assert_turning_left(points[order], ring)


@pytest.mark.parametrize("n", [0, 1])
def test_too_few_points_to_tell(n: int) -> None:
    order, ring = rings(np.ones((n, 4), np.float32))
    assert order.tolist() == list(range(n))
    assert ring.tolist() == [0] * n
