import numpy as np
from numpy.typing import NDArray

from uncal.events.stream import Events, PixelMap
from uncal.reporting.overlay import draw_events, draw_points, overlay_panel

K = np.array([[50.0, 0.0, 31.5], [0.0, 50.0, 15.5], [0.0, 0.0, 1.0]])
T = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
GREY = np.full((32, 64, 3), 90, np.uint8)


def painted(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray((picture != 90).any(-1))


def test_a_point_is_drawn_where_it_projects() -> None:
    point = np.array([[10.0, -2.0, 1.0, 0.5]], np.float32)  # to the right and up
    mask = painted(draw_points(GREY, point, T, K, scale=4))
    rows, columns = np.nonzero(mask)
    expected = np.array([15.5 - 5.0, 31.5 + 10.0]) * 4 + 1.5
    np.testing.assert_allclose([rows.mean(), columns.mean()], expected, atol=1.0)


def test_near_points_hide_far_ones() -> None:
    near, far = [5.0, 0.0, 0.0, 0.0], [50.0, 0.0, 0.0, 0.0]
    both = draw_points(GREY, np.array([near, far], np.float32), T, K, scale=6)
    alone = draw_points(GREY, np.array([near], np.float32), T, K, scale=6)
    centre = (slice(96, 97), slice(192, 193))  # (15.5, 31.5) enlarged six times
    np.testing.assert_array_equal(both[centre], alone[centre])
    alone_far = draw_points(GREY, np.array([far], np.float32), T, K, scale=6)
    assert not np.array_equal(alone_far[centre], alone[centre])


def test_many_depths_have_many_colours() -> None:
    depth = np.linspace(5, 50, 9, dtype=np.float32)
    points = np.stack([depth, np.linspace(-0.4, 0.4, 9) * depth, 0 * depth, depth], 1)
    picture = draw_points(GREY, points.astype(np.float32), T, K, scale=6)
    row = 96  # (15.5 + 0.5) · 6
    colours = {tuple(pixel) for pixel in picture[row, painted(picture)[row]].tolist()}
    assert len(colours) >= 9


def test_points_behind_and_beside_the_camera_are_left_out() -> None:
    points = np.array([[-5.0, 0, 0, 0], [1.0, 30.0, 0, 0]], np.float32)
    np.testing.assert_array_equal(
        draw_points(GREY, points, T, K, scale=1), draw_points(GREY, points[:0], T, K, scale=1)
    )


def test_a_panel_has_one_captioned_row_per_extrinsic() -> None:
    points = np.array([[10.0, 0.0, 0.0, 0.5]], np.float32)
    one = overlay_panel(GREY, points, K, {"true": T}, scale=2)
    two = overlay_panel(GREY, points, K, {"true": T, "estimated": T}, scale=2)
    assert two.shape == (2 * one.shape[0], one.shape[1], 3)
    assert one.shape[0] > 64


def events_at(columns: list[float], rows: list[float], brighter: list[bool]) -> Events:
    x, y = np.array(columns, np.float32), np.array(rows, np.float32)
    t = np.arange(len(x), dtype=np.int64)
    return Events(x, y, t, np.array(brighter, np.bool_), (0, 100), (8, 16))


def test_events_are_blue_where_it_got_brighter_and_red_where_darker() -> None:
    picture = draw_events(
        events_at([2.0, 9.0, 5.0], [1.0, 6.0, 3.0], [True, False, True]),
        (8, 16),
        PixelMap.identity(),
    ).astype(int)
    assert (picture[0, 0] == 255).all()
    assert picture[1, 2, 2] > picture[1, 2, 0] + 50  # blue over red
    assert picture[6, 9, 0] > picture[6, 9, 2] + 50
    assert ((picture < 255).any(-1)).sum() == 3


def test_more_events_are_stronger_and_both_signs_mix() -> None:
    columns = [1.0] + [3.0] * 4 + [5.0] * 4
    signs = [True] * 5 + [True, True, False, False]
    picture = draw_events(
        events_at(columns, [2.0] * 9, signs), (8, 16), PixelMap.identity()
    ).astype(int)
    assert picture[2, 3, 0] < picture[2, 1, 0] < 255
    assert picture[2, 3, 0] < picture[2, 5, 0] < 255


def test_no_events_are_white_and_the_map_is_followed() -> None:
    assert (draw_events(events_at([], [], []), (8, 16), PixelMap.identity()) == 255).all()
    half = PixelMap(0.5, -0.25, 0.5, -0.25)
    picture = draw_events(events_at([10.5], [4.5], [True]), (4, 8), half)
    assert [axis.tolist() for axis in np.nonzero((picture < 255).any(-1))] == [[2], [5]]
