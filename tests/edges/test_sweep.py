"""Edges of made-up sweeps: rays of known directions against planes of known places."""

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.edges.sweep import (
    COLUMNS,
    CONTRAST,
    GAP,
    KIND,
    KINDS,
    REFLECTANCE,
    SIDE,
    STRENGTH,
    find_edges,
)

STEP = np.radians(0.35)
ROW = np.radians(0.5)
AZIMUTH = np.arange(-86, 87) * STEP
ELEVATION = np.radians(-12.0) + ROW * np.arange(32)
Grid = NDArray[np.float64]


def rays() -> tuple[Grid, Grid, Grid]:
    """(lasers, azimuths) azimuth and elevation, and (lasers, azimuths, 3) directions."""
    azimuth, elevation = np.meshgrid(AZIMUTH, ELEVATION)
    flat = np.cos(elevation)
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1)
    return azimuth, elevation, direction


def wall(distance: float, yaw_deg: float = 0.0) -> Grid:
    """(lasers, azimuths) ranges to a plane, infinite where a ray does not meet it."""
    normal = np.array([np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg)), 0.0])
    towards = rays()[2] @ normal
    return np.where(towards > 0.05, distance / np.maximum(towards, 0.05), np.inf)


def sweep(distance: Grid, reflectance: Grid | float = 0.5) -> NDArray[np.float32]:
    """Laser by laser, without what never returns."""
    points = rays()[2] * np.where(np.isfinite(distance), distance, 0.0)[..., None]
    shine = np.broadcast_to(reflectance, distance.shape)[..., None]
    whole = np.concatenate([points, shine], -1)[np.isfinite(distance)]
    return whole.astype(np.float32)


def edges_of(points: NDArray[np.float32], kind: str) -> NDArray[np.float32]:
    found = find_edges(points)
    assert found.dtype == np.float32
    assert found.shape[1] == len(COLUMNS)
    return np.asarray(found[found[:, KIND] == KINDS.index(kind)], np.float32)


def angles(edges: NDArray[np.float32]) -> tuple[Grid, Grid, Grid]:
    """Azimuth, elevation, range."""
    x, y, z = edges[:, :3].astype(np.float64).T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)), np.linalg.norm(edges[:, :3], axis=1)


PANEL = {"x": 10.0, "left": 1.53, "right": -1.71, "top": 0.31, "bottom": -0.86}


def wall_with_panel() -> NDArray[np.float32]:
    """A wall 20 m away; 10 m away a panel in front of it."""
    far, near = wall(20.0), wall(PANEL["x"])
    at = rays()[2] * near[..., None]
    y, z = at[..., 1], at[..., 2]
    on = (y > PANEL["right"]) & (y < PANEL["left"]) & (z > PANEL["bottom"]) & (z < PANEL["top"])
    return sweep(np.where(on, near, far))


def gap_around(angle: float, grid: Grid) -> float:
    """Middle of the gap between the two directions around an angle."""
    above = int(np.searchsorted(grid, angle))
    return float(grid[above - 1] + grid[above]) / 2


@pytest.mark.parametrize("yaw", [0.0, 25.0, -40.0])
def test_a_plane_has_no_edges(yaw: float) -> None:
    assert len(find_edges(sweep(wall(15.0, yaw)))) == 0


def test_sides_of_a_panel_lie_in_the_middle_of_their_gaps() -> None:
    edges = edges_of(wall_with_panel(), "depth across")
    azimuth, elevation, distance = angles(edges)
    borders = {side: np.arctan2(PANEL[side], PANEL["x"]) for side in ("left", "right")}
    is_left = azimuth > 0
    rows = np.tan(ELEVATION)[:, None] * PANEL["x"] / np.cos(AZIMUTH)
    crossed = ((rows > PANEL["bottom"]) & (rows < PANEL["top"])).any(1).sum()
    assert 0.8 * crossed <= is_left.sum() <= crossed
    assert 0.8 * crossed <= (~is_left).sum() <= crossed
    for side, chosen in (("left", is_left), ("right", ~is_left)):
        middle = gap_around(borders[side], AZIMUTH)
        np.testing.assert_allclose(azimuth[chosen], middle, atol=1e-5)
        assert abs(middle - borders[side]) <= STEP / 2
    # The farther neighbour is on the outside; the edge is as far away as the panel is.
    np.testing.assert_array_equal(edges[:, SIDE], np.where(is_left, 1.0, -1.0))
    x = distance * np.cos(elevation) * np.cos(azimuth)
    np.testing.assert_allclose(x, PANEL["x"], rtol=0.01)
    np.testing.assert_allclose(edges[:, GAP], STEP, rtol=1e-3)
    # Half the inverse range is gone, and on either side it hardly changes.
    np.testing.assert_allclose(edges[:, STRENGTH], 0.5, atol=0.02)


def test_top_and_bottom_of_a_panel_lie_between_lasers() -> None:
    edges = edges_of(wall_with_panel(), "depth along")
    azimuth, elevation, _ = angles(edges)
    is_top = elevation > 0
    borders = [np.arctan2(PANEL[end], PANEL["x"] / np.cos(azimuth)) for end in ("bottom", "top")]
    border = np.where(is_top, borders[1], borders[0])
    middles = [gap_around(each, ELEVATION) for each in border]
    np.testing.assert_allclose(elevation, middles, atol=1e-5)
    assert (np.abs(elevation - border) <= ROW / 2 + 1e-5).all()
    np.testing.assert_array_equal(edges[:, SIDE], np.where(is_top, 1.0, -1.0))
    np.testing.assert_allclose(edges[:, GAP], ROW, rtol=1e-3)
    # One for every column of the panel, but for those that its sides share.
    columns = (np.abs(AZIMUTH) < 0.145).sum()
    assert is_top.sum() > 0.8 * columns
    assert (~is_top).sum() > 0.8 * columns


def test_a_panel_makes_edges_of_depth_alone() -> None:
    found = find_edges(wall_with_panel())
    kinds = {KINDS[int(kind)] for kind in found[:, KIND]}
    assert kinds == {"depth across", "depth along"}
    assert (found[:, CONTRAST] == 0).all()
    np.testing.assert_allclose(found[:, REFLECTANCE], 0.5)


def test_paint_makes_edges_of_intensity_alone() -> None:
    azimuth, _, _ = rays()
    bright_left = sweep(wall(15.0), np.where(azimuth > 0.3 * STEP, 0.6, 0.2))
    edges = find_edges(bright_left)
    assert {KINDS[int(kind)] for kind in edges[:, KIND]} == {"intensity across"}
    assert len(edges) == len(ELEVATION)
    np.testing.assert_allclose(angles(edges)[0], STEP / 2, atol=1e-5)
    assert (edges[:, SIDE] == -1.0).all()  # the darker one is on the right
    np.testing.assert_allclose(edges[:, STRENGTH], 0.4, atol=1e-6)
    np.testing.assert_allclose(edges[:, REFLECTANCE], 0.6, atol=1e-6)
    np.testing.assert_allclose(edges[:, CONTRAST], -0.4, atol=1e-6)


def test_paint_between_lasers() -> None:
    _, elevation, _ = rays()
    low, high = ELEVATION[17], ELEVATION[18]
    bright_above = sweep(wall(15.0), np.where(elevation > (low + high) / 2, 0.6, 0.2))
    edges = find_edges(bright_above)
    assert {KINDS[int(kind)] for kind in edges[:, KIND]} == {"intensity along"}
    np.testing.assert_allclose(angles(edges)[1], (low + high) / 2, atol=1e-5)
    assert (edges[:, SIDE] == -1.0).all()  # the darker one is below
    assert len(edges) > 0.9 * len(AZIMUTH)


def test_outlines_against_what_returns_nothing() -> None:
    azimuth, elevation, _ = rays()
    right = (azimuth > np.radians(-15)) & (azimuth < np.radians(-5))
    left = (azimuth > np.radians(5)) & (azimuth < np.radians(15)) & (elevation < ELEVATION[20])
    points = sweep(np.where(right | left, wall(10.0), np.inf))
    across = edges_of(points, "outline across")
    at = angles(across)[0]
    ends = AZIMUTH[right.any(0)].max(), AZIMUTH[left.any(0)].min()
    is_left = at > 0
    assert is_left.sum() == (~is_left).sum() == 20
    np.testing.assert_allclose(at[~is_left], ends[0] + STEP / 2, atol=1e-5)
    np.testing.assert_allclose(at[is_left], ends[1] - STEP / 2, atol=1e-5)
    np.testing.assert_array_equal(across[:, SIDE], np.where(is_left, -1.0, 1.0))
    # The lower of the two has a top; what is above the higher one, no laser tells.
    along = edges_of(points, "outline along")
    azimuths, top, _ = angles(along)
    assert (azimuths > 0).all()
    np.testing.assert_allclose(top, ELEVATION[19] + ROW / 2, atol=1e-5)
    assert (along[:, SIDE] == 1.0).all()
    assert len(find_edges(points)) == len(across) + len(along)


def test_lasers_that_count_downwards_change_nothing() -> None:
    upwards = wall_with_panel()
    rows = upwards.reshape(len(ELEVATION), len(AZIMUTH), 4)
    downwards = np.ascontiguousarray(rows[::-1]).reshape(-1, 4)
    a, b = find_edges(upwards), find_edges(downwards)
    assert len(a) == len(b) > 0
    np.testing.assert_array_equal(a[np.lexsort(a.T)], b[np.lexsort(b.T)])


def test_the_strongest_of_each_kind_are_kept() -> None:
    azimuth, elevation, _ = rays()
    stripes = 0.5 + 0.2 * np.sign(np.sin(40 * azimuth)) * np.cos(9 * elevation)
    points = sweep(wall(15.0), stripes)
    found, few = find_edges(points), find_edges(points, most=60)
    assert 40 <= len(few) <= 60
    for kind in range(len(KINDS)):
        kept, whole = few[few[:, KIND] == kind], found[found[:, KIND] == kind]
        strongest = np.sort(whole[:, STRENGTH])[::-1][: len(kept)]
        np.testing.assert_array_equal(np.sort(kept[:, STRENGTH])[::-1], strongest)


def test_hardly_any_points_have_no_edges() -> None:
    assert find_edges(np.ones((5, 4), np.float32)).shape == (0, len(COLUMNS))
    assert find_edges(np.empty((0, 4), np.float32)).shape == (0, len(COLUMNS))
