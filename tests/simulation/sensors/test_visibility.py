from __future__ import annotations

import numpy as np
import pytest

from uncal.simulation.formats.drive import Piece, build_scene
from uncal.simulation.rigid import inverse
from uncal.simulation.scene.meshes import Array
from uncal.simulation.scene.trajectory import vehicle_pose
from uncal.simulation.scene.triangle_scene import Numbers, Scene
from uncal.simulation.sensors.rig import draw_rig
from uncal.simulation.sensors.view import visible
from uncal.simulation.settings import SimulationSettings


class CountingScene:
    """Passes rays on and counts them."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.rays = 0

    def cast(self, origins: Array, directions: Array) -> Numbers:
        self.rays += len(origins)
        return self.scene.cast(origins, directions)


@pytest.mark.parametrize("shape", [(48, 128), (47, 127), (1, 5), (2, 1)])
def test_same_triangles_as_a_ray_per_sample(
    tiny_settings: SimulationSettings, shape: tuple[int, int]
) -> None:
    rig = draw_rig(tiny_settings, 0)
    street, scene = build_scene(tiny_settings, Piece(0, 0, 0, 3))
    T_world_lidar = vehicle_pose(tiny_settings, street, 0, 0, 0) @ rig.T_vehicle_lidar
    T_world_cam = T_world_lidar @ inverse(rig.T_cam_lidar)
    x, y = np.meshgrid(np.linspace(-0.4, 0.4, shape[1]), np.linspace(-0.15, 0.15, shape[0]))
    directions = np.stack([x, y, np.ones_like(x)], -1) @ T_world_cam[:3, :3].T
    directions = directions.astype(np.float32)
    position = T_world_cam[:3, 3].astype(np.float32)
    counting = CountingScene(scene)
    found = visible(counting, position, directions)  # type: ignore[arg-type]
    flat = directions.reshape(-1, 3)
    expected = scene.cast(np.tile(position, (len(flat), 1)), flat)
    assert found.shape == shape
    assert (found.ravel() == expected).mean() > 0.995
    if len(flat) > 1000:
        assert counting.rays < 0.75 * len(flat)
