from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.simulation.scene.meshes import Mesh, Surfaces, blobs, boxes, prisms


def surfaces(n: int, fit: bool = False) -> Surfaces:
    return Surfaces(
        texture=np.arange(n, dtype=np.int32),
        tile=np.full((n, 2), 2.0, np.float32),
        colours=np.zeros((n, 2, 3), np.float32),
        reflectance=np.zeros((n, 2), np.float32),
        fit=np.full(n, fit),
    )


def outward(triangles: NDArray[np.floating], centre: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each (T, 3, 3) triangle, seen counter-clockwise, faces away from the centre."""
    edges = triangles[:, 1:] - triangles[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1])
    return np.asarray(((triangles.mean(1) - centre) * normals).sum(1) > 0)


def test_boxes_are_closed_and_face_outwards() -> None:
    base, size = np.array([[1.0, 2.0, 3.0]]), np.array([[4.0, 2.0, 1.0]])
    mesh = Mesh()
    mesh.add_boxes(base, size, np.array([0.7]), surfaces(1), np.random.default_rng(0), taper=0.8)
    triangles = np.concatenate(mesh.triangles)
    assert triangles.shape == (12, 3, 3)
    assert outward(triangles, base[0] + [0, 0, 0.5]).all()
    # Signed tetrahedra about the origin add up to the volume of a closed surface only:
    # a frustum's is h/3 (A + a + sqrt(A a)) with a = 0.64 A.
    volume = np.linalg.det(triangles.astype(np.float64)).sum() / 6
    assert volume == pytest.approx(1 / 3 * (8 + 8 * 0.64 + 8 * 0.8), rel=1e-5)


def test_boxes_stand_on_their_base_and_turn_about_it() -> None:
    sides, extent, _, _ = boxes(
        np.array([[10.0, 0.0, 1.0]]), np.array([[4.0, 2.0, 3.0]]), np.array([np.pi / 2])
    )
    low, high = sides.reshape(-1, 3).min(0), sides.reshape(-1, 3).max(0)
    np.testing.assert_allclose([low, high], [[9, -2, 1], [11, 2, 4]], atol=1e-9)
    assert extent[0].tolist() == [[4, 3], [2, 3], [4, 3], [2, 3]]


def test_prisms_and_blobs_face_outwards() -> None:
    quads, extent = prisms(
        np.zeros((1, 3)), np.array([0.1]), np.array([5.0]), np.array([[0.5, 0.0]]), 6
    )
    axis_centre = np.array([0.25, 0.0, 2.5])
    assert outward(quads[0, :, :3], axis_centre).all()
    np.testing.assert_allclose(quads[0, :, 2:, 2], 5.0)
    np.testing.assert_allclose(extent[0, 0], [0.2 * np.pi / 6, 5.0])
    rng = np.random.default_rng(0)
    triangles, _ = blobs(np.array([[1.0, 2.0, 3.0]]), np.array([[2.0, 1.0, 1.0]]), 0.0, rng)
    assert triangles.shape == (1, 80, 3, 3)
    assert outward(triangles[0], np.array([1.0, 2.0, 3.0])).all()
    scaled = (triangles - [1, 2, 3]) / [2, 1, 1]
    np.testing.assert_allclose(np.linalg.norm(scaled, axis=-1), 1.0, rtol=1e-6)


@pytest.mark.parametrize(("fit", "expected"), [(False, [2.5, 1.5]), (True, [2.0, 2.0])])
def test_fitted_textures_repeat_a_whole_number_of_times(fit: bool, expected: list[float]) -> None:
    mesh = Mesh()
    quad = np.array([[[[0, 0, 0], [5, 0, 0], [5, 0, 3], [0, 0, 3]]]], np.float64)
    mesh.add(quad, np.array([[[5.0, 3.0]]]), surfaces(1, fit))
    uv = np.concatenate(mesh.uv).reshape(-1, 2)
    assert uv.min(0).tolist() == [0, 0]
    assert uv.max(0).tolist() == expected


def test_every_triangle_keeps_its_objects_surface() -> None:
    mesh = Mesh()
    zeros = np.zeros((3, 3))
    mesh.add_boxes(zeros, zeros + 1, np.zeros(3), surfaces(3), np.random.default_rng(0))
    sides, ends = [[owner] * 8 for owner in range(3)], [[owner] * 4 for owner in range(3)]
    assert np.concatenate(mesh.texture).tolist() == np.concatenate(sides + ends).tolist()


def test_nothing_to_add_is_no_error() -> None:
    mesh = Mesh()
    nothing = np.zeros((0, 3))
    mesh.add_boxes(nothing, nothing, np.zeros(0), surfaces(0), np.random.default_rng(0))
    assert mesh.triangles == []
