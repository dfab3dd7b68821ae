from __future__ import annotations

import numpy as np
import pytest

from uncal.simulation.scene.meshes import Mesh
from uncal.simulation.scene.street import VERGE_M, Street, add_ground, draw_street
from uncal.simulation.scene.textures import build_library
from uncal.simulation.scene.triangle_scene import Scene, draw_sky
from uncal.simulation.settings import SimulationSettings

FLAT = (0.0, 100.0, 0.0)


@pytest.fixture
def street() -> Street:
    return Street(
        start=0.0,
        end=80.0,
        bend=FLAT,
        slope=FLAT,
        lane_m=3.0,
        parking_m=2.0,
        kerb_m=0.1,
        pavement_m=2.0,
        crossings=np.array([[30.0, 40.0]]),
    )


def test_ground_is_closed_and_at_the_right_height(street: Street) -> None:
    rng = np.random.default_rng(0)
    mesh = Mesh()
    add_ground(mesh, street, rng)
    scene = Scene(mesh, draw_sky(rng), build_library(rng), (-1e3, 1e3))
    s, y = rng.uniform(0.1, 79.9, 5000), rng.uniform(-VERGE_M, VERGE_M, 5000)
    above = np.column_stack([s, y, np.full(5000, 5.0)]).astype(np.float32)
    down = np.tile(np.array([0, 0, -1], np.float32), (5000, 1))
    triangle = scene.cast(above, down)
    assert (triangle >= 0).all()
    raised = (np.abs(y) > street.kerb_y) & ~street.in_crossing(s, 0.0)
    np.testing.assert_allclose(scene.corners[triangle, 2], np.where(raised, 0.1, 0.0), atol=1e-6)
    np.testing.assert_allclose(scene.normals[triangle], [[0, 0, 1]] * 5000, atol=1e-5)


def test_kerbs_hide_the_underside_of_the_pavement(street: Street) -> None:
    rng = np.random.default_rng(0)
    mesh = Mesh()
    add_ground(mesh, street, rng)
    scene = Scene(mesh, draw_sky(rng), build_library(rng), (-1e3, 1e3))
    # From the road and from the crossing, just above the ground, level with the kerb stones.
    origins = np.array([[10, 0, 0.05], [10, 0, 0.05], [35, 20, 0.05], [35, -20, 0.05]], np.float32)
    towards = np.array([[0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0]], np.float32)
    triangle = scene.cast(origins, towards)
    np.testing.assert_allclose((scene.normals[triangle] * towards).sum(1), -1.0, atol=1e-5)
    distance = ((scene.corners[triangle] - origins) * towards).sum(1)
    np.testing.assert_allclose(distance, 5.0, atol=1e-4)


def test_course_is_consistent_with_its_derivatives(tiny_settings: SimulationSettings) -> None:
    street = draw_street(tiny_settings.scene, np.random.default_rng(3), -25.0, 200.0)
    s = np.linspace(0, 150, 50)
    slope = (street.height(s + 1e-4) - street.height(s - 1e-4)) / 2e-4
    turn = (street.lateral(s + 1e-4) - street.lateral(s - 1e-4)) / 2e-4
    np.testing.assert_allclose(np.tan(street.heading(s)), turn, atol=1e-6)
    np.testing.assert_allclose(np.tan(-street.incline(s)), slope, atol=1e-6)
    assert np.abs(np.rad2deg(street.heading(s))).max() <= tiny_settings.scene.bend_deg
    assert np.abs(np.rad2deg(street.incline(s))).max() <= tiny_settings.scene.slope_deg
    assert street.lateral(0.0) == 0.0


def test_world_puts_the_road_under_the_vehicle(street: Street) -> None:
    np.testing.assert_allclose(street.world(np.array([3.0, 4.0, 5.0])), [3.0, 4.0, 5.0])
    assert street.in_crossing(np.array([29.0, 31.0, 41.0]), 1.5).tolist() == [True, True, True]
    assert street.in_crossing(np.array([29.0, 31.0, 41.0]), 0.0).tolist() == [False, True, False]
