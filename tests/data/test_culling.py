from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from uncal.data.culling import frustum_mask, largest_rotation_chord
from uncal.geometry import pose_to_matrix
from uncal.recordings.frame import Frame

Array = NDArray[np.float64]

KITTI_K = np.array([[721.5377, 0.0, 609.5593], [0.0, 721.5377, 172.854], [0.0, 0.0, 1.0]])
KITTI_SIZE = (375, 1242)
KITTI_T = np.array(
    [
        [0.000235, -0.999944, -0.010563, 0.0571],
        [0.010449, 0.010565, -0.999890, -0.0755],
        [0.999945, 0.000124, 0.010451, -0.2694],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
BOUNDS = [(math.radians(1), 0.1), (math.radians(20), 1.5), (math.radians(1), 0.0), (0.0, 0.1)]
CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=6)))


def decalibrations(units: Array, max_rotation: float, max_translation: float) -> Array:
    """(D, 4, 4) from (D, 6) numbers in -1..1."""
    bounds = np.array([max_translation] * 3 + [max_rotation] * 3)
    return pose_to_matrix(torch.from_numpy(units * bounds)).numpy()


def random_rig(rng: np.random.Generator) -> tuple[Array, Array, tuple[int, int]]:
    """T_cam_lidar at any attitude within 0.6 rad of KITTI's, K and image size."""
    pose = torch.from_numpy(np.concatenate([rng.normal(0, 0.5, 3), rng.uniform(-0.6, 0.6, 3)]))
    height, width = int(rng.integers(40, 400)), int(rng.integers(40, 1300))
    focal = width / (2 * math.tan(rng.uniform(0.2, 1.0)))
    K = np.array(
        [
            [focal, 0, width * rng.uniform(0.4, 0.6)],
            [0, focal * rng.uniform(0.9, 1.1), height * rng.uniform(0.4, 0.6)],
            [0, 0, 1],
        ]
    )
    return KITTI_T @ pose_to_matrix(pose).numpy(), K, (height, width)


def project(points: Array, T: Array, K: Array) -> tuple[Array, Array]:
    """(N, 2) pixel coordinates and (N,) depths."""
    camera = points @ T[:3, :3].T + T[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        return (camera @ K.T)[:, :2] / camera[:, 2:], camera[:, 2]


def visible(points: Array, T: Array, K: Array, image_size: tuple[int, int]) -> NDArray[np.bool_]:
    """Points in front of the camera whose pixel, by any rounding, is in the image."""
    pixels, depth = project(points, T, K)
    height, width = image_size
    inside = (pixels >= -0.5) & (pixels < [width, height])
    return (depth > 0) & inside[:, 0] & inside[:, 1]


def border_points(
    rng: np.random.Generator, n: int, T: Array, K: Array, image_size: tuple[int, int]
) -> Array:
    """(n, 3) points in the LiDAR frame that T projects just inside the image's border."""
    height, width = image_size
    pixels = rng.uniform([-0.5, -0.5], [width, height], (n, 2))
    side = rng.integers(0, 4, n)
    pixels[side == 0, 0], pixels[side == 1, 0] = -0.4999, width - 1e-4
    pixels[side == 2, 1], pixels[side == 3, 1] = -0.4999, height - 1e-4
    depth = np.exp(rng.uniform(math.log(0.05), math.log(120), (n, 1)))
    camera = np.column_stack([pixels, np.ones(n)]) @ np.linalg.inv(K).T * depth
    return np.asarray((camera - T[:3, 3]) @ T[:3, :3])


def spinning_sweep(n_azimuths: int) -> NDArray[np.float32]:
    """(64 · n_azimuths, 3) returns of a 64-beam LiDAR 1.73 m above ground between walls."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-np.pi, np.pi, n_azimuths, endpoint=False),
        np.radians(np.linspace(-24.8, 2.0, 64)),
    )
    directions = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    )
    with np.errstate(divide="ignore"):
        ground = np.where(elevation < 0, -1.73 / np.sin(elevation), np.inf)
        walls = 8.0 / np.abs(directions[..., 1])
    ranges = np.minimum(np.minimum(ground, walls), 80.0)
    sweep: NDArray[np.float32] = (directions * ranges[..., None]).reshape(-1, 3).astype(np.float32)
    return sweep


@pytest.mark.parametrize(("max_rotation", "max_translation"), BOUNDS)
def test_no_visible_point_is_culled(max_rotation: float, max_translation: float) -> None:
    rng = np.random.default_rng(0)
    n_visible = 0
    for _ in range(25):
        T, K, image_size = random_rig(rng)
        units = np.concatenate([CORNERS, rng.uniform(-1, 1, (16, 6))])
        for D in decalibrations(units, max_rotation, max_translation):
            anywhere = rng.normal(size=(20, 3)) * np.exp(rng.uniform(-2, 4, (20, 1)))
            points = np.concatenate([border_points(rng, 60, T @ D, K, image_size), anywhere])
            points = points.astype(np.float32)
            seen = visible(points.astype(np.float64), T @ D, K, image_size)
            keep = frustum_mask(points, T, K, image_size, max_rotation, max_translation)
            assert keep[seen].all()
            n_visible += int(seen.sum())
    assert n_visible > 30_000


def test_most_of_a_sweep_is_culled() -> None:
    points = spinning_sweep(1800)
    mask = frustum_mask(points, KITTI_T, KITTI_K, KITTI_SIZE, math.radians(1), 0.1)
    in_view = visible(points.astype(np.float64), KITTI_T, KITTI_K, KITTI_SIZE).mean()
    assert in_view < mask.mean() < 0.35
    assert mask.mean() < 1.3 * in_view


def depth_image(points: Array, T: Array) -> Array:
    """Depth of the nearest return of each pixel of a KITTI image; infinite where there is none."""
    pixels, depth = project(points, T, KITTI_K)
    inside = visible(points, T, KITTI_K, KITTI_SIZE)
    columns, rows = np.floor(pixels[inside] + 0.5).astype(int).T
    image = np.full((KITTI_SIZE[0] + 1, KITTI_SIZE[1] + 1), np.inf)
    np.minimum.at(image, (rows, columns), depth[inside])
    return image


@pytest.mark.parametrize(("max_rotation", "max_translation"), BOUNDS[:2])
def test_no_crop_edge_shows_in_a_projection(max_rotation: float, max_translation: float) -> None:
    points = spinning_sweep(900)
    mask = frustum_mask(points, KITTI_T, KITTI_K, KITTI_SIZE, max_rotation, max_translation)
    everything, culled = points.astype(np.float64), points[mask].astype(np.float64)
    n_drawn = 0
    for D in decalibrations(CORNERS[::3], max_rotation, max_translation):
        image = depth_image(everything, KITTI_T @ D)
        n_drawn += int(np.isfinite(image).sum())
        np.testing.assert_array_equal(depth_image(culled, KITTI_T @ D), image)
    assert n_drawn > 50_000


def test_culling_at_the_true_border_would_show() -> None:
    # What the test above must be able to catch: no margin, and returns are missing at the edge.
    points = spinning_sweep(900)
    mask = frustum_mask(points, KITTI_T, KITTI_K, KITTI_SIZE, 0.0, 0.0)
    D = decalibrations(CORNERS[:1], *BOUNDS[0])[0]
    everything, culled = points.astype(np.float64), points[mask].astype(np.float64)
    missing = (
        np.isfinite(depth_image(everything, KITTI_T @ D)).sum()
        - np.isfinite(depth_image(culled, KITTI_T @ D)).sum()
    )
    assert missing > 50


@pytest.mark.parametrize("max_rotation", [0.0, 0.01, math.radians(20), math.radians(80)])
def test_rotation_chord_is_the_least_upper_bound(max_rotation: float) -> None:
    rng = np.random.default_rng(1)
    units = np.concatenate([CORNERS, rng.uniform(-1, 1, (5_000, 6))])
    rotations = decalibrations(units, max_rotation, 0.0)[:, :3, :3]
    # The spectral norm of R - I is the farthest that R moves a unit vector.
    moved = np.linalg.norm(rotations - np.eye(3), ord=2, axis=(1, 2))
    assert moved.max() == pytest.approx(largest_rotation_chord(max_rotation), abs=1e-9)


def test_rotation_chord_from_90_degrees_on() -> None:
    assert largest_rotation_chord(math.pi / 2 - 1e-9) == pytest.approx(2.0)
    assert largest_rotation_chord(3.0) == 2.0


def test_every_point_stays_when_everything_can_turn_into_view() -> None:
    points = np.random.default_rng(0).normal(0, 20, (500, 3)).astype(np.float32)
    assert frustum_mask(points, KITTI_T, KITTI_K, KITTI_SIZE, math.pi, 0.0).all()


def test_takes_a_view_of_four_columns_and_no_points() -> None:
    points = np.random.default_rng(0).normal(0, 20, (500, 4)).astype(np.float32)
    args = (KITTI_T, KITTI_K, KITTI_SIZE, 0.02, 0.1)
    from_view = frustum_mask(points[:, :3], *args)
    np.testing.assert_array_equal(from_view, frustum_mask(points[:, :3].copy(), *args))
    assert from_view.dtype == np.bool_
    assert frustum_mask(points[:0, :3], *args).shape == (0,)


@pytest.mark.parametrize("bounds", [(-0.1, 0.1), (0.1, -0.1), (math.nan, 0.1), (0.1, math.inf)])
def test_bounds_out_of_range(bounds: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="at least 0"):
        frustum_mask(np.zeros((1, 3), np.float32), KITTI_T, KITTI_K, KITTI_SIZE, *bounds)


@pytest.mark.kitti
def test_real_sweeps_are_culled_to_a_fifth(kitti_frames: list[Frame]) -> None:
    for frame in kitti_frames:
        points = frame.points[:, :3]
        assert frame.image is not None
        size = frame.image.shape[:2]
        mask = frustum_mask(points, frame.T_cam_lidar, frame.K, size, *BOUNDS[0])
        assert 0.1 < mask.mean() < 0.25
        for D in decalibrations(CORNERS[::21], *BOUNDS[0]):
            seen = visible(points.astype(np.float64), frame.T_cam_lidar @ D, frame.K, size)
            assert mask[seen].all()
