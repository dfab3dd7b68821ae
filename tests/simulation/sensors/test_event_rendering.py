from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.rigid import Matrix, inverse, pose_matrix
from uncal.simulation.scene.palette import LUMINANCE
from uncal.simulation.scene.trajectory import pose_around, turn_rates, vehicle_pose
from uncal.simulation.scene.triangle_scene import Scene
from uncal.simulation.sensors.camera import Camera
from uncal.simulation.sensors.event_camera import EventCamera, LuminanceMeter
from uncal.simulation.sensors.rig import Rig, draw_rig
from uncal.simulation.settings import CameraSettings, SimulationSettings

MakeSettings = Callable[..., SimulationSettings]


def straight_rays(settings: CameraSettings, K: NDArray[np.float64]) -> NDArray[np.float32]:
    """Rays of a camera without distortion."""
    n = settings.supersampling
    v, u = np.mgrid[: settings.height * n, : settings.width * n]
    pixels = np.stack([(u + 0.5) / n - 0.5, (v + 0.5) / n - 0.5, np.ones(u.shape)], -1)
    return np.asarray(pixels @ np.linalg.inv(K).T, np.float32)


def view_of(settings: SimulationSettings, index: int) -> tuple[Rig, Scene, Matrix]:
    """A rig, its street and the pose of its camera at the second frame."""
    rig = draw_rig(settings, index)
    street, scene = build_scene(settings, Piece(index, 0, 0, 3))
    T_world_vehicle = vehicle_pose(settings, street, index, 0, 1)
    return rig, scene, T_world_vehicle @ rig.T_vehicle_lidar @ inverse(rig.T_cam_lidar)


@pytest.mark.parametrize("index", [0, 1, 2, 3])
@pytest.mark.parametrize("supersampling", [1, 2])
def test_luminance_is_what_the_colour_camera_exposes(
    make_settings: MakeSettings, index: int, supersampling: int
) -> None:
    # With several rays per pixel, the colour camera asks for the sun once per pixel and triangle.
    size = {"height": 48, "width": 128, "shadows": supersampling == 1}
    settings = make_settings(camera={"supersampling": supersampling, **size})
    rig, scene, pose = view_of(settings, index)
    colours = Camera(settings.camera, rig.K)._expose(scene, pose)
    expected = (LUMINANCE @ colours).reshape(48, 128)
    rays = straight_rays(settings.camera, rig.K)
    measured = LuminanceMeter(scene, settings.camera, rays).measure(pose)
    assert measured.dtype == np.float32
    assert expected.std() > 0.05
    # A ray that grazes a shadow's edge may fall on either side of it.
    assert (np.abs(measured - expected) < 1e-3).mean() > 0.999


def test_shadows_can_be_left_out(make_settings: MakeSettings) -> None:
    darker = 0
    for index in range(4):
        settings = make_settings()
        rig, scene, pose = view_of(settings, index)
        rays = straight_rays(settings.camera, rig.K)
        with_shadows = LuminanceMeter(scene, settings.camera, rays).measure(pose)
        without = replace(settings.camera, shadows=False)
        bright = LuminanceMeter(scene, without, rays).measure(pose)
        assert (with_shadows <= bright + 1e-5).all()
        darker += int((with_shadows < bright - 1e-3).sum())
    assert darker > 100


@pytest.mark.parametrize(("axis", "sign"), [(1, 1.0), (1, -1.0), (0, 1.0)])
def test_events_follow_gradient_and_flow_of_a_street(
    make_event_settings: MakeSettings, axis: int, sign: float
) -> None:
    """A turning camera: the flow does not depend on depth, so gradient · flow is known."""
    plain = {"threshold_mismatch": 0.0, "noise_hz": 0.0, "refractory_us": 0.0, "dark": 0.02}
    settings = make_event_settings(
        camera={"height": 80, "width": 208, "focal_px": 230.0, "supersampling": 3},
        events={**plain, "threshold_on": 0.05, "threshold_off": 0.05},
    )
    assert settings.events is not None
    rig, scene, pose = view_of(settings, 1)
    meter = LuminanceMeter(scene, settings.camera, straight_rays(settings.camera, rig.K))
    turn = np.zeros(3)
    turn[axis] = sign * 1.0 / rig.K[0, 0]
    # One pixel to either side, as far as the gradient below reaches.
    poses = [pose @ pose_matrix((0, 0, 0), share * turn) for share in (-1.0, 0.0, 1.0)]
    light = np.stack([meter.measure(each) for each in poses])
    camera = EventCamera(settings.events, light.shape[1:], np.random.default_rng(0))
    events = camera.watch(light, np.array([0, 5000, 10_000]), np.random.default_rng(1))

    along_y, along_x = np.gradient(np.log(light[1] + 0.02 * light[1].mean()))
    # Camera y is down: turning about it by one pixel's angle moves the picture one pixel to the
    # left; turning about x, downwards.
    flow_x, flow_y = (-sign, 0.0) if axis == 1 else (0.0, sign)
    expected = -2 * (flow_x * along_x + flow_y * along_y)
    counted = np.zeros(expected.shape)
    np.add.at(counted, (events.y, events.x), np.where(events.p, 1.0, -1.0))

    assert np.corrcoef(expected.ravel(), counted.ravel())[0, 1] > 0.95
    clear = np.abs(expected) > 0.1
    assert clear.sum() > 1000
    assert (np.sign(counted[clear]) == np.sign(expected[clear])).mean() > 0.96
    flat = np.abs(expected) < 0.005
    assert np.abs(counted[flat]).mean() < 0.1 * np.abs(counted[clear]).mean()


def test_the_vehicle_moves_through_the_window_to_its_pose(
    make_event_settings: MakeSettings,
) -> None:
    settings = make_event_settings(vehicle={"speed_mps": 10.0})
    at = pose_matrix((5.0, 1.0, 0.2), (0.0, 0.0, np.pi / 2))
    rates = np.array([0.0, 0.0, 0.2])
    np.testing.assert_array_equal(pose_around(settings, at, rates, 0.0), at)
    before = pose_around(settings, at, rates, -0.05)
    # Heading along +y: half a metre back is y - 0.5, and it had still to turn by 0.01.
    np.testing.assert_allclose(before[:3, 3], [5.0, 0.5, 0.2], atol=1e-12)
    expected = pose_matrix((0, 0, 0), (0, 0, np.pi / 2 - 0.01))
    np.testing.assert_allclose(before[:3, :3], expected[:3, :3], atol=1e-12)


def test_turn_rates_stay_within_their_limits(make_event_settings: MakeSettings) -> None:
    events = make_event_settings(events={"yaw_rate_deg_s": 20.0, "sway_rate_deg_s": 2.0}).events
    assert events is not None
    rng = np.random.default_rng(0)
    drawn = np.rad2deg([turn_rates(events, rng) for _ in range(500)])
    largest = np.abs(drawn).max(0)
    assert (largest <= [2.0, 2.0, 20.0]).all()
    assert (largest > [1.9, 1.9, 19.0]).all()
