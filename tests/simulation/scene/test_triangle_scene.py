from __future__ import annotations

import numpy as np
import pytest

from uncal.simulation.scene.meshes import Mesh, Surfaces
from uncal.simulation.scene.textures import SIZE, TextureLibrary
from uncal.simulation.scene.triangle_scene import NOTHING, Scene, Sky


def flat_texture() -> TextureLibrary:
    """One texture, the same everywhere."""
    sizes = [(SIZE >> level) ** 2 for level in range(8)]
    texels = np.tile(np.array([[51, 128]], np.uint8), (sum(sizes), 1))
    return TextureLibrary(texels, np.cumsum([0, *sizes[:-1]]).astype(np.int32))


def sky() -> Sky:
    """The sun stands overhead."""
    return Sky(
        to_sun=np.array([0, 0, 1], np.float32),
        sun=np.array([1.0, 0.5, 0.25], np.float32),
        ambient=np.array([0.1, 0.2, 0.3], np.float32),
        horizon=np.ones(3, np.float32),
        zenith=np.ones(3, np.float32),
        clouds=0,
    )


@pytest.fixture
def scene() -> Scene:
    """A square floor of 20 m at z = 0 and, 3 m above its middle, a roof of 2 m."""
    surface = Surfaces(
        texture=np.zeros(2, np.int32),
        tile=np.ones((2, 2), np.float32),
        colours=np.array([[[0.5] * 3, [1.0] * 3]] * 2, np.float32),
        reflectance=np.array([[0.2, 0.7]] * 2, np.float32),
        fit=np.zeros(2, bool),
    )
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
    quads = np.stack([10 * corners, corners + np.array([0, 0, 3])])[:, None]
    mesh = Mesh()
    mesh.add(quads, np.array([[[20.0, 20.0]], [[2.0, 2.0]]]), surface)
    return Scene(mesh, sky(), flat_texture(), (-100.0, 100.0))


ORIGINS = np.array([[5, 5, 10], [0.5, 0.3, 10], [2.5, 0, 1], [50, 0, 1]], np.float32)
DIRECTIONS = np.array([[0, 0, -2], [0, 0, -1], [-2, 0, -1], [0, 0, -1]], np.float32)


def test_rays_find_the_nearest_surface(scene: Scene) -> None:
    floor, roof = (0, 1), (2, 3)
    first, second, third, fourth = scene.cast(ORIGINS, DIRECTIONS)
    assert first in floor
    assert second in roof
    assert third in floor
    assert fourth == NOTHING


def test_the_roof_shades_the_floor(scene: Scene) -> None:
    points = np.array([[5, 5, 0], [0.5, 0.3, 3], [0.5, 0.3, 0]], np.float32)
    assert scene.in_sun(points, np.array([0, 2, 0], np.int32)).tolist() == [1.0, 1.0, 0.0]


def test_only_triangles_within_reach_are_kept(scene: Scene) -> None:
    assert len(scene) == 4
    mesh = Mesh()
    for x in (0.0, 50.0):
        triangle = np.array([[[[x, 0, 0], [x + 1, 0, 0], [x, 1, 0]]]], np.float64)
        surface = Surfaces(
            np.zeros(1, np.int32),
            np.ones((1, 2), np.float32),
            np.zeros((1, 2, 3), np.float32),
            np.zeros((1, 2), np.float32),
            np.zeros(1, bool),
        )
        mesh.add_triangles(triangle, triangle[..., :2], surface)
    assert len(Scene(mesh, sky(), flat_texture(), (-5.0, 20.0))) == 1
