from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.rigid import Matrix, inverse, pose_matrix
from uncal.simulation.scene.trajectory import vehicle_pose
from uncal.simulation.scene.triangle_scene import NOTHING, Scene
from uncal.simulation.sensors.lidar import Lidar
from uncal.simulation.sensors.rig import Rig, draw_rig
from uncal.simulation.sensors.view import View
from uncal.simulation.settings import SimulationSettings

MakeSettings = Callable[..., SimulationSettings]


def depth_agreement(
    rig: Rig,
    scene: Scene,
    T_world_lidar: Matrix,
    points: NDArray[np.float32],
    T_cam_lidar: Matrix,
) -> float:
    """Share of points that lie where the true camera sees them, projected with ``T_cam_lidar``."""
    in_camera = points[:, :3] @ T_cam_lidar[:3, :3].T + T_cam_lidar[:3, 3]
    in_camera = in_camera[in_camera[:, 2] > 1]
    pixels = in_camera @ rig.K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    inside = (np.abs(pixels - [31.5, 11.5]) < [32, 12]).all(1)
    in_camera, pixels = in_camera[inside], pixels[inside]
    T_world_cam = T_world_lidar @ inverse(rig.T_cam_lidar)
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(rig.K).T
    directions = (rays @ T_world_cam[:3, :3].T).astype(np.float32)
    origins = np.tile(T_world_cam[:3, 3].astype(np.float32), (len(rays), 1))
    triangle = scene.cast(origins, directions)
    depth = View(scene, T_world_cam[:3, 3]).meet(triangle, directions.T).t
    assert len(depth) > 100
    return float((np.abs(depth - in_camera[:, 2]) < 0.02 * depth + 0.05).mean())


@pytest.mark.parametrize("index", [0, 1, 2])
def test_points_lie_on_what_the_camera_sees_only_with_the_true_extrinsic(
    make_settings: MakeSettings, index: int
) -> None:
    settings = make_settings(lidar={"azimuth_step_deg": 0.5, "beams": 32})
    rig = draw_rig(settings, index)
    street, scene = build_scene(settings, Piece(index, 0, 0, 3))
    T_world_lidar = vehicle_pose(settings, street, index, 0, 1) @ rig.T_vehicle_lidar
    lidar = Lidar(settings.lidar, rig.elevations)
    points = lidar.sweep(scene, T_world_lidar, np.random.default_rng(0))
    true = depth_agreement(rig, scene, T_world_lidar, points, rig.T_cam_lidar)
    decalibration = pose_matrix((0.1, -0.1, 0.1), np.deg2rad([1.0, 1.0, -1.0]))
    wrong = depth_agreement(rig, scene, T_world_lidar, points, rig.T_cam_lidar @ decalibration)
    # The two sensors stand 30 cm apart, so a few points are hidden from the camera.
    assert true > 0.93
    assert wrong < true - 0.15


def test_the_vehicle_moves_forward_in_its_lane(tiny_settings: SimulationSettings) -> None:
    street, _ = build_scene(tiny_settings, Piece(0, 0, 0, 3))
    poses = [vehicle_pose(tiny_settings, street, 0, 0, frame) for frame in range(3)]
    x = [pose[0, 3] for pose in poses]
    assert x == pytest.approx([0.0, 5.0, 10.0])
    for pose in poses:
        s = pose[0, 3]
        off_centre = pose[1, 3] - street.lateral(s) + street.lane_m / 2
        assert abs(off_centre) <= tiny_settings.vehicle.drift_m
        assert abs(pose[2, 3] - street.height(s)) <= tiny_settings.vehicle.height_m
    assert not np.allclose(poses[0][:3, :3], poses[1][:3, :3], atol=1e-3)


def test_another_drive_is_another_street(tiny_settings: SimulationSettings) -> None:
    first, _ = build_scene(tiny_settings, Piece(0, 0, 0, 3))
    second, _ = build_scene(tiny_settings, Piece(0, 1, 0, 3))
    assert first.lane_m != second.lane_m


def test_no_car_stands_where_the_vehicle_drives(make_settings: MakeSettings) -> None:
    crowded = {"moving_cars_per_100m": 15.0, "parked_cars_per_100m": 30.0}
    settings = make_settings(frames_per_drive=8, scene=crowded)
    for index in range(4):
        street, scene = build_scene(settings, Piece(index, 0, 0, 8))
        for frame in range(8):
            pose = vehicle_pose(settings, street, index, 0, frame)
            eye, forward = pose[:3, 3] + [0, 0, 1], pose[:3, :1].astype(np.float32)
            ahead = scene.cast(eye.astype(np.float32)[None], forward.T.copy())
            assert ahead[0] == NOTHING or View(scene, eye).meet(ahead, forward).t[0] > 4.0
