from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from uncal.simulation.scene.meshes import Mesh, Surfaces
from uncal.simulation.scene.textures import build_library
from uncal.simulation.scene.triangle_scene import Scene, draw_sky
from uncal.simulation.sensors.lidar import REVOLUTION_S, Lidar
from uncal.simulation.settings import LidarSettings, SimulationSettings

MakeSettings = Callable[..., SimulationSettings]


def room(half_size: float, reflectance: float) -> Scene:
    """Four walls around the origin, PLAIN texture."""
    surface = Surfaces(
        np.zeros(1, np.int32),
        np.ones((1, 2), np.float32),
        np.full((1, 2, 3), 0.5, np.float32),
        np.full((1, 2), reflectance, np.float32),
        np.zeros(1, bool),
    )
    rng = np.random.default_rng(0)
    mesh = Mesh()
    size = np.array([[2 * half_size, 2 * half_size, 200.0]])
    mesh.add_boxes(np.array([[0.0, 0.0, -100.0]]), size, np.zeros(1), surface, rng)
    return Scene(mesh, draw_sky(rng), build_library(rng), (-1e3, 1e3))


def lidar_settings(make_settings: MakeSettings, **changes: float) -> LidarSettings:
    noiseless = {"range_noise_m": 0.0, "reflectance_noise": 0.0, "dropout": 0.0}
    exact = noiseless | {"range_min_m": 0.1, "stagger": False}
    return make_settings(lidar=exact | {"azimuth_fov_deg": 360.0} | changes).lidar


def sweep(
    settings: LidarSettings, scene: Scene, elevations: list[float], seed: int = 0
) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    lidar = Lidar(settings, np.deg2rad(elevations))
    points = lidar.sweep(scene, np.eye(4), np.random.default_rng(seed))
    return points.reshape(-1, 4)


def test_every_ray_of_a_full_revolution_meets_the_walls(make_settings: MakeSettings) -> None:
    points = sweep(lidar_settings(make_settings), room(10.0, 0.9), [-5.0, 0.0])
    assert points.shape == (2 * 360, 4)
    np.testing.assert_allclose(np.abs(points[:, :2]).max(1), 10.0, rtol=1e-5)
    azimuth = np.rad2deg(np.arctan2(points[360:, 1], points[360:, 0]))
    np.testing.assert_allclose(np.diff(azimuth), 1.0, atol=1e-3)
    elevation = np.rad2deg(np.arctan2(points[:360, 2], np.hypot(*points[:360, :2].T)))
    np.testing.assert_allclose(elevation, -5.0, atol=1e-3)


def test_field_of_view_is_centred_on_the_front(make_settings: MakeSettings) -> None:
    settings = lidar_settings(make_settings, azimuth_fov_deg=90.0)
    points = sweep(settings, room(10.0, 0.9), [0.0])
    azimuth = np.rad2deg(np.arctan2(points[:, 1], points[:, 0]))
    assert len(points) == 90
    assert [azimuth.min(), azimuth.max()] == pytest.approx([-44.5, 44.5], abs=1e-3)


def test_range_limits_hold(make_settings: MakeSettings) -> None:
    settings = lidar_settings(make_settings, range_min_m=11.0, range_max_m=12.0, range_noise_m=0.2)
    ranges = np.linalg.norm(sweep(settings, room(10.0, 0.9), [0.0])[:, :3], axis=1)
    assert 50 < len(ranges) < 200
    assert 11.0 <= ranges.min() < 11.2
    assert 11.8 < ranges.max() <= 12.0


def test_range_noise_lies_along_the_ray(make_settings: MakeSettings) -> None:
    exact = sweep(lidar_settings(make_settings), room(10.0, 0.9), [0.0])
    noisy = sweep(lidar_settings(make_settings, range_noise_m=0.1), room(10.0, 0.9), [0.0])
    error = np.linalg.norm(noisy[:, :3], axis=1) - np.linalg.norm(exact[:, :3], axis=1)
    assert error.std() == pytest.approx(0.1, rel=0.2)
    assert abs(error.mean()) < 0.02
    np.testing.assert_allclose(np.cross(noisy[:, :3], exact[:, :3]), 0.0, atol=1e-3)


def test_dark_distant_and_random_returns_are_lost(make_settings: MakeSettings) -> None:
    settings = lidar_settings(make_settings, range_max_m=500.0)
    near = len(sweep(settings, room(5.0, 0.02), [0.0]))
    far = len(sweep(settings, room(60.0, 0.02), [0.0]))
    bright = len(sweep(settings, room(60.0, 0.9), [0.0]))
    assert near > 350
    assert far < 60
    assert bright > 330
    dropped = lidar_settings(make_settings, dropout=0.5, azimuth_step_deg=0.1)
    # 3600 rays, half lost: within five standard deviations of the binomial law.
    assert len(sweep(dropped, room(10.0, 0.9), [0.0])) == pytest.approx(1800, abs=150)


def test_reflectance_follows_material_and_incidence(make_settings: MakeSettings) -> None:
    settings = lidar_settings(make_settings)
    bright = sweep(settings, room(10.0, 0.8), [0.0])
    dark = sweep(settings, room(10.0, 0.2), [0.0])
    assert ((bright[:, 3] >= 0) & (bright[:, 3] <= 1)).all()
    assert bright[:, 3].mean() > 2.5 * dark[:, 3].mean()
    frontal = np.abs(bright[:, 1]) < 2
    oblique = np.abs(bright[:, 1]) > 8
    assert bright[frontal, 3].mean() > bright[oblique, 3].mean()


def test_returns_are_reported_from_where_the_lidar_then_is(make_settings: MakeSettings) -> None:
    settings = lidar_settings(make_settings, motion_distortion=True)
    velocity = np.array([12.0, -3.0, 0.0])
    lidar = Lidar(settings, np.deg2rad([-5.0, 0.0, 3.0]))
    rng = np.random.default_rng
    moving = lidar.sweep(room(10.0, 0.9), np.eye(4), rng(0), velocity).astype(np.float64)
    assert len(moving) == 3 * 360
    # Straight ahead it is where the sweep is taken for; a revolution takes 0.1 s.
    # A Velodyne turns clockwise.
    delay = -np.arctan2(moving[:, 1], moving[:, 0]) / (2 * np.pi) * REVOLUTION_S
    world = moving[:, :2] + delay[:, None] * velocity[:2]
    np.testing.assert_allclose(np.abs(world).max(1), 10.0, rtol=1e-4)
    assert np.abs(np.abs(moving[:, :2]).max(1) - 10.0).max() > 0.4
    still = lidar.sweep(room(10.0, 0.9), np.eye(4), rng(0))
    ahead = np.abs(np.arctan2(moving[:, 1], moving[:, 0])) < np.radians(1)
    np.testing.assert_allclose(moving[ahead, :3], still[ahead, :3], atol=0.02)
    off = Lidar(lidar_settings(make_settings, motion_distortion=False), np.deg2rad([0.0]))
    np.testing.assert_array_equal(
        off.sweep(room(10.0, 0.9), np.eye(4), rng(0), velocity),
        off.sweep(room(10.0, 0.9), np.eye(4), rng(0)),
    )


def test_staggered_lasers_look_into_directions_of_their_own(make_settings: MakeSettings) -> None:
    settings = lidar_settings(make_settings, stagger=True, azimuth_fov_deg=90.0)
    elevations = [-6.0, -4.0, -2.0, 0.0]
    points = sweep(settings, room(10.0, 0.9), elevations).reshape(4, 90, 4)
    azimuth = np.rad2deg(np.arctan2(points[..., 1], points[..., 0]))
    shift = azimuth - np.arange(-44.5, 45.0)
    # Each laser by an offset of its own, within half a step.
    np.testing.assert_allclose(shift, np.repeat(shift[:, :1], 90, 1), atol=1e-3)
    assert (np.abs(shift) <= 0.5 + 1e-3).all()
    assert np.diff(np.sort(shift[:, 0])).min() > 0.1


def test_a_laser_measures_too_much_by_its_bias(make_settings: MakeSettings) -> None:
    settings, elevations = lidar_settings(make_settings), np.deg2rad([-5.0, 0.0])
    scene = room(10.0, 0.9)
    plain, biased = (
        Lidar(settings, elevations, bias).sweep(scene, np.eye(4), np.random.default_rng(0))
        for bias in (None, np.array([0.1, -0.05]))
    )
    more = np.linalg.norm(biased[:, :3], axis=1) - np.linalg.norm(plain[:, :3], axis=1)
    np.testing.assert_allclose(more, np.repeat([0.1, -0.05], 360), atol=1e-4)
