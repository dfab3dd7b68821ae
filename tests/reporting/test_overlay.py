import numpy as np
from numpy.typing import NDArray

from uncal.reporting.overlay import draw_points, overlay_panel

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
