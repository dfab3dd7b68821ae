import numpy as np
import torch
from torch import Tensor

from uncal.geometry import pose_to_matrix
from uncal.geometry.projection import NEAREST_DEPTH, pixel_coordinates, project

CAMERA_FROM_LIDAR = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
K = torch.tensor([[60.0, 0.0, 31.3], [0.0, 58.0, 19.6], [0.0, 0.0, 1.0]])
SIZE = (40, 64)


def scene(batch: int, n: int) -> tuple[Tensor, Tensor]:
    torch.manual_seed(0)
    xyz = torch.randn(batch, n, 3) * torch.tensor([10.0, 6.0, 3.0]) + torch.tensor([9.0, 0, 0])
    points = torch.cat([xyz, torch.rand(batch, n, 1)], -1)
    return points, CAMERA_FROM_LIDAR @ pose_to_matrix(0.05 * torch.randn(batch, 6))


def loop_projection(points: Tensor, T: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """One point at a time, in float64: the definition, not the implementation."""
    depth = np.zeros(SIZE)
    intensity = np.zeros(SIZE)
    matrix, camera = T.double().numpy(), K.double().numpy()
    for x, y, z, reflectance in points.double().tolist():
        p = matrix[:3, :3] @ [x, y, z] + matrix[:3, 3]
        if not p[2] > NEAREST_DEPTH:
            continue
        u, v, _ = camera @ p / p[2]
        column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
        inside = 0 <= column < SIZE[1] and 0 <= row < SIZE[0]
        if inside and (depth[row, column] == 0 or p[2] < depth[row, column]):
            depth[row, column], intensity[row, column] = p[2], reflectance
    return depth, intensity


def test_equals_a_plain_loop() -> None:
    points, T = scene(3, 3000)
    seen = project(points, T, K.expand(3, 3, 3), SIZE)
    for b in range(3):
        depth, intensity = loop_projection(points[b], T[b])
        assert (depth > 0).sum() > 200
        # A point within rounding of a pixel's border may fall on either side.
        same = np.isclose(seen.depth[b, 0].numpy(), depth, rtol=1e-4)
        assert same.mean() > 0.998
        np.testing.assert_allclose(seen.intensity[b, 0].numpy()[same], intensity[same], rtol=1e-5)


def test_the_nearest_return_wins_whatever_the_order() -> None:
    points, T = scene(2, 5000)
    shuffled = points[:, torch.randperm(5000)]
    first, second = (
        project(points, T, K.expand(2, 3, 3), SIZE),
        project(shuffled, T, K.expand(2, 3, 3), SIZE),
    )
    assert torch.equal(first.inverse_depth, second.inverse_depth)
    assert torch.equal(first.intensity, second.intensity)


def test_rows_of_nan_are_padding() -> None:
    points, T = scene(1, 500)
    padded = torch.cat([points, torch.full((1, 300, 4), float("nan"))], 1)
    expected = project(points, T, K[None], SIZE)
    seen = project(padded, T, K[None], SIZE)
    assert torch.equal(seen.inverse_depth, expected.inverse_depth)
    assert torch.equal(seen.intensity, expected.intensity)
    assert seen.inverse_depth.isfinite().all()


def test_points_behind_the_camera_are_not_seen() -> None:
    behind = torch.tensor([[[-5.0, 0.0, 0.0, 1.0], [0.05, 0.0, 0.0, 1.0]]])
    seen = project(behind, CAMERA_FROM_LIDAR[None], K[None], SIZE)
    assert seen.inverse_depth.count_nonzero() == 0


def test_samples_of_a_batch_do_not_mix() -> None:
    points, T = scene(3, 800)
    together = project(points, T, K.expand(3, 3, 3), SIZE)
    for b in range(3):
        alone = project(points[b : b + 1], T[b : b + 1], K[None], SIZE)
        torch.testing.assert_close(alone.inverse_depth[0], together.inverse_depth[b])


def test_pixel_coordinates_by_hand() -> None:
    pixel = pixel_coordinates(torch.tensor([[2.0, -1.0, 4.0]]), K)
    torch.testing.assert_close(pixel, torch.tensor([[60 * 0.5 + 31.3, -58 * 0.25 + 19.6]]))
