"""A turned camera sees the same scene: every point keeps its colour."""

from __future__ import annotations

import math

import pytest
import torch

from uncal.data.camera_rotation import margins, rotate_cameras
from uncal.data.dataset import Batch
from uncal.errors import ConfigurationError
from uncal.geometry import transform_points
from uncal.geometry.projection import pixel_coordinates
from uncal.recordings.frame import FrameId

ONE = math.radians(1.0)


def batch_of(camera: torch.Tensor, K: torch.Tensor, points: torch.Tensor) -> Batch:
    n = len(camera)
    lidar = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    return Batch(
        unit_index=torch.arange(n),
        unit=torch.arange(n),
        frames=[FrameId("rig", "drive", i) for i in range(n)],
        camera=camera,
        points=points,
        edges=torch.empty(n, 0, 9),
        K=K.expand(n, 3, 3),
        T_cam_lidar=lidar.expand(n, 4, 4),
        decalibration=None,
        skipped=[],
    )


def test_points_keep_their_colour() -> None:
    """An image that is a smooth function of the pixel, read where points fall, before and after."""
    K = torch.tensor([[200.0, 0, 99.5], [0, 200.0, 47.5], [0, 0, 1]])
    v, u = torch.meshgrid(torch.arange(96.0), torch.arange(200.0), indexing="ij")
    picture = torch.stack([u, v, u + v]).half()[None].repeat(2, 1, 1, 1)
    torch.manual_seed(0)
    points = torch.rand(2, 40, 4) * torch.tensor([5.0, 4.0, 2.0, 1.0])
    points = points + torch.tensor([8.0, -2.0, -1.0, 0.0])
    batch = batch_of(picture, K, points)
    angles = torch.tensor([[ONE, -ONE, ONE], [0.5 * ONE, 0.2 * ONE, -ONE]])
    turned = rotate_cameras(batch, angles, ONE)
    assert turned.camera.shape[-2] % 8 == turned.camera.shape[-1] % 8 == 0
    before = pixel_coordinates(transform_points(batch.T_cam_lidar, points[..., :3]), batch.K)
    after = pixel_coordinates(transform_points(turned.T_cam_lidar, points[..., :3]), turned.K)
    height, width = turned.camera.shape[-2:]
    checked = 0
    for i in range(2):
        for k in range(points.shape[1]):
            x, y = after[i, k].tolist()
            if not (0 <= x <= width - 2 and 0 <= y <= height - 2):
                continue
            left, top = int(x), int(y)
            patch = turned.camera[i, :2, top : top + 2, left : left + 2].float()
            a, b = x - left, y - top
            weights = torch.tensor([[(1 - a) * (1 - b), a * (1 - b)], [(1 - a) * b, a * b]])
            seen = (patch * weights).sum((1, 2))
            assert torch.allclose(seen, before[i, k], atol=0.2)
            checked += 1
    assert checked > 20


def test_no_rotation_only_crops() -> None:
    K = torch.tensor([[200.0, 0, 99.5], [0, 200.0, 47.5], [0, 0, 1]])
    camera = torch.randint(0, 256, (1, 3, 96, 200), dtype=torch.uint8)
    batch = batch_of(camera, K, torch.zeros(1, 1, 4))
    turned = rotate_cameras(batch, torch.zeros(1, 3), ONE)
    top, left = margins(batch.K, (96, 200), ONE)
    height, width = turned.camera.shape[-2:]
    assert torch.equal(turned.camera, camera[:, :, top : top + height, left : left + width])
    assert turned.K[0, 0, 2] == K[0, 2] - left
    assert turned.K[0, 1, 2] == K[1, 2] - top


def test_too_large_a_rotation_is_refused() -> None:
    K = torch.tensor([[200.0, 0, 99.5], [0, 200.0, 47.5], [0, 0, 1]])
    batch = batch_of(torch.zeros(1, 3, 96, 200, dtype=torch.uint8), K, torch.zeros(1, 1, 4))
    with pytest.raises(ConfigurationError, match=r"augmentation\.rotation_deg"):
        rotate_cameras(batch, torch.zeros(1, 3), math.radians(15.0))
