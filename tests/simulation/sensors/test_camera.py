from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.simulation.rigid import inverse
from uncal.simulation.scene.meshes import Mesh, Surfaces
from uncal.simulation.scene.textures import SIZE, TextureLibrary
from uncal.simulation.scene.triangle_scene import Scene, Sky
from uncal.simulation.sensors.camera import Camera
from uncal.simulation.sensors.rig import CAMERA_FROM_LIDAR_AXES
from uncal.simulation.settings import CameraSettings, SimulationSettings

MakeSettings = Callable[..., SimulationSettings]
K = np.array([[70.0, 0.0, 31.0], [0.0, 70.0, 11.0], [0.0, 0.0, 1.0]])
T_WORLD_CAM = inverse(CAMERA_FROM_LIDAR_AXES)


def wall(left_y: float, right_y: float, bottom: float, top: float) -> Scene:
    """A white wall 10 m ahead under a black sky."""
    sizes = [(SIZE >> level) ** 2 for level in range(8)]
    texels = np.tile(np.array([[0, 128]], np.uint8), (sum(sizes), 1))
    library = TextureLibrary(texels, np.cumsum([0, *sizes[:-1]]).astype(np.int32))
    surface = Surfaces(
        np.zeros(1, np.int32),
        np.ones((1, 2), np.float32),
        np.ones((1, 2, 3), np.float32),
        np.ones((1, 2), np.float32),
        np.zeros(1, bool),
    )
    mesh = Mesh()
    corners = [[10, left_y, bottom], [10, right_y, bottom], [10, right_y, top], [10, left_y, top]]
    quad = np.array([[corners]], np.float64)
    mesh.add(quad, np.array([[[1.0, 1.0]]]), surface)
    black = np.zeros(3, np.float32)
    light = np.ones(3, np.float32)
    towards = np.array([-1, 0, 0], np.float32)
    return Scene(mesh, Sky(towards, black, light, black, black, 0), library, (0.0, 20.0))


@pytest.fixture
def camera_settings(make_settings: MakeSettings) -> CameraSettings:
    plain = {"noise": 0.0, "vignetting": 0.0, "haze_m": 1e6, "supersampling": 4, "exposure": 1.0}
    plain |= {"exposure_stops": 0.0, "tint": 0.0, "blur_px": 0.0}
    return make_settings(camera=plain).camera


def coverage(settings: CameraSettings, scene: Scene) -> NDArray[np.float64]:
    """(H, W) share of each pixel that the wall covers, undoing gamma; 1 where it is brightest."""
    image = Camera(settings, K).photograph(scene, T_WORLD_CAM, np.random.default_rng(0))
    linear = (image[..., 0] / 255.0) ** 2.2
    return np.asarray(linear / linear.max())


def test_edges_fall_where_the_camera_matrix_says(camera_settings: CameraSettings) -> None:
    # Projected to u = 20.5 and 40.5, v = 5.5 and 15.5: pixel borders, if integers are centres.
    y_left, y_right = -(20.5 - 31) / 70 * 10, -(40.5 - 31) / 70 * 10
    z_top, z_bottom = -(5.5 - 11) / 70 * 10, -(15.5 - 11) / 70 * 10
    seen = coverage(camera_settings, wall(y_left, y_right, z_bottom, z_top))
    expected = np.zeros((24, 64))
    expected[6:16, 21:41] = 1.0
    np.testing.assert_allclose(seen, expected, atol=0.02)


def test_a_pixel_cut_in_half_is_half_as_bright(camera_settings: CameraSettings) -> None:
    y_left, y_right = -(20.0 - 31) / 70 * 10, -(40.5 - 31) / 70 * 10
    seen = coverage(camera_settings, wall(y_left, y_right, -5.0, 5.0))
    assert seen[12, 20] == pytest.approx(0.5, abs=0.02)
    assert seen[12, 19] == 0.0
    assert seen[12, 21] == pytest.approx(1.0, abs=0.01)


def test_exposure_noise_and_vignetting(make_settings: MakeSettings) -> None:
    scene = wall(50.0, -50.0, -50.0, 50.0)

    def picture(**changes: float) -> NDArray[np.uint8]:
        plain = {"noise": 0.0, "vignetting": 0.0, "haze_m": 1e6, "exposure": 1.0}
        plain |= {"exposure_stops": 0.0, "tint": 0.0, "blur_px": 0.0}
        settings = make_settings(camera=plain | changes).camera
        return Camera(settings, K).photograph(scene, T_WORLD_CAM, np.random.default_rng(0))

    assert picture().std() == 0
    assert picture(exposure=2.0).mean() > 1.2 * picture().mean()
    dimmed = picture(vignetting=0.6)
    assert dimmed[0, 63].max() < dimmed[11, 31].min() - 20
    noisy = picture(noise=0.05).astype(float)
    assert 2.0 < noisy.std() < 30.0
    assert noisy.mean() == pytest.approx(picture().mean(), abs=2.0)
