from __future__ import annotations

import numpy as np
import pytest

from uncal.simulation.meshes import Mesh, Surfaces
from uncal.simulation.scene import Scene
from uncal.simulation.sky import Sky
from uncal.simulation.textures import SIZE, TextureLibrary

BLEND, GRAIN = 51, 128  # 0.2 and 0.5 + 128/255 ≈ 1.002


def flat_texture() -> TextureLibrary:
    """One texture, the same everywhere."""
    sizes = [(SIZE >> level) ** 2 for level in range(8)]
    texels = np.tile(np.array([[BLEND, GRAIN]], np.uint8), (sum(sizes), 1))
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


def test_rays_find_the_nearest_surface_in_units_of_their_length(scene: Scene) -> None:
    hits = scene.cast(ORIGINS, DIRECTIONS)
    assert hits.t[:3].tolist() == pytest.approx([5.0, 7.0, 1.0])
    assert (hits.triangle >= 0).tolist() == [True, True, True, False]
    assert scene.slant(hits.take(np.arange(3)), DIRECTIONS[:3]).tolist() == pytest.approx([2, 1, 1])


def test_the_roof_shades_the_floor(scene: Scene) -> None:
    hits = scene.cast(ORIGINS, DIRECTIONS).take(np.arange(3))
    points = ORIGINS[:3] + hits.t[:, None] * DIRECTIONS[:3]
    assert scene.in_sun(points, hits.triangle).tolist() == [1.0, 1.0, 0.0]


def test_radiance_and_reflectance_by_hand(scene: Scene) -> None:
    hits = scene.cast(ORIGINS, DIRECTIONS).take(np.arange(2))
    footprint = np.full(2, 0.01, np.float32)
    radiance = scene.radiance(hits, footprint, np.array([1.0, 0.0], np.float32))
    grain = 0.5 + GRAIN / 255
    albedo = 0.5 + 0.2 * 0.5
    # A face towards the zenith and the sun receives the whole ambient light: 0.55 + 0.3 + 0.15.
    lit = albedo * grain * np.array([1.1, 0.7, 0.55])
    shaded = albedo * grain * np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(radiance, np.stack([lit, shaded], 1), rtol=1e-5)
    expected = (0.2 + 0.2 * 0.5) * (0.5 + 0.5 * grain)
    assert scene.reflectance(hits, footprint).tolist() == pytest.approx([expected] * 2)


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
