from __future__ import annotations

import numpy as np
import pytest

from uncal.simulation.scene.meshes import Mesh, Surfaces
from uncal.simulation.scene.textures import SIZE, TextureLibrary
from uncal.simulation.scene.triangle_scene import NOTHING, Scene, Sky
from uncal.simulation.sensors.view import View

EYE = np.array([1.0, 2.5, 10.0])


@pytest.fixture
def view() -> View:
    """A floor of 20 m at z = 0 under EYE; its texture repeats every 4 m from the corner (-10, -10).

    Blend is 0.2 in the lower half of the tile and 0.6 in the upper half; grain is 128/255 + 0.5.
    """
    tile = np.full((SIZE, SIZE, 2), 128, np.uint8)
    tile[: SIZE // 2, :, 0], tile[SIZE // 2 :, :, 0] = 51, 153
    coarse = [np.full(((SIZE >> level) ** 2, 2), 128, np.uint8) for level in range(1, 8)]
    texels = np.concatenate([tile.reshape(-1, 2), *coarse])
    offsets = np.cumsum([0, SIZE**2, *(len(level) for level in coarse[:-1])]).astype(np.int32)
    surface = Surfaces(
        texture=np.zeros(1, np.int32),
        tile=np.full((1, 2), 4.0, np.float32),
        colours=np.array([[[0.5] * 3, [1.0] * 3]], np.float32),
        reflectance=np.array([[0.2, 0.7]], np.float32),
        fit=np.zeros(1, bool),
    )
    corners = np.array([[-10, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0]], np.float64)
    mesh = Mesh()
    mesh.add(corners[None, None], np.array([[[20.0, 20.0]]]), surface)
    sky = Sky(
        to_sun=np.array([0, 0, 1], np.float32),
        sun=np.array([1.0, 0.5, 0.25], np.float32),
        ambient=np.array([0.1, 0.2, 0.3], np.float32),
        horizon=np.ones(3, np.float32),
        zenith=np.ones(3, np.float32),
        clouds=0,
    )
    return View(Scene(mesh, sky, TextureLibrary(texels, offsets), (-100.0, 100.0)), EYE)


# Straight down with length 2; slanted, to (4, 5.5, 0); and one that is known to meet nothing.
DIRECTIONS = np.array([[0, 0, -2], [0.3, 0.3, -1], [0, 0, 1]], np.float32).T
TRIANGLES = np.array([0, 0, NOTHING], np.int32)


def test_depth_slant_and_texture_coordinates(view: View) -> None:
    meeting = view.meet(TRIANGLES, DIRECTIONS)
    assert meeting.t.tolist() == pytest.approx([5.0, 10.0, 0.0])
    assert meeting.slant[:2].tolist() == pytest.approx([2.0, 1.0])
    # (1, 2.5) and (4, 5.5) are (11, 12.5) and (14, 15.5) from the corner, in repeats of 4 m.
    assert meeting.u[:2].tolist() == pytest.approx([2.75, 3.5], abs=1e-5)
    assert meeting.v[:2].tolist() == pytest.approx([3.125, 3.875], abs=1e-5)
    assert meeting.texel_density[:2].tolist() == [SIZE / 4] * 2


def test_both_halves_of_a_quad_agree(view: View) -> None:
    both = view.meet(np.array([0, 1], np.int32), DIRECTIONS[:, [1, 1]])
    assert both.t[0] == pytest.approx(both.t[1])
    assert both.u[0] == pytest.approx(both.u[1], abs=1e-5)
    assert both.v[0] == pytest.approx(both.v[1], abs=1e-5)


def test_radiance_and_reflectance_by_hand(view: View) -> None:
    meeting = view.meet(TRIANGLES, DIRECTIONS)
    footprint = np.full(3, 0.01, np.float32)
    radiance = view.radiance(meeting, footprint, np.array([1.0, 0.0, 1.0], np.float32))
    grain = 0.5 + 128 / 255
    # v = 3.125 lies in the lower half of a tile (blend 0.2), 3.875 in the upper (blend 0.6).
    # A face towards the zenith and the sun receives the whole ambient light: 0.55 + 0.3 + 0.15.
    lit = (0.5 + 0.2 * 0.5) * grain * np.array([1.1, 0.7, 0.55])
    shaded = (0.5 + 0.6 * 0.5) * grain * np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(radiance, np.stack([lit, shaded, np.zeros(3)], 1), rtol=1e-5)
    seen = view.reflectance(meeting, footprint)[:2]
    expected = [(0.2 + 0.2 * 0.5) * (0.5 + 0.5 * grain), (0.2 + 0.6 * 0.5) * (0.5 + 0.5 * grain)]
    assert seen.tolist() == pytest.approx(expected)
