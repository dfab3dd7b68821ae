"""Virtual rotations of the camera: other rigs out of recordings of one.

A pinhole image taken by a camera turned about its centre is a homography of the one at hand,
u' ~ K R K⁻¹ u, whatever the scene. With T' = [R | 0] · T the recording is that of another rig, so
that the ring pattern alone no longer tells a decalibration.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from uncal.data.dataset import Batch
from uncal.errors import ConfigurationError
from uncal.geometry import euler_to_matrix

MULTIPLE = 8
"""Both sides of the cropped image are multiples of so many pixels."""


def rotate_cameras(batch: Batch, angles: Tensor, largest: float) -> Batch:
    """Turn every camera, and crop what not all of them see.

    Args:
        batch: B samples.
        angles: (B, 3) rotation about the camera's x, y and z axes, radians.
        largest: what no angle exceeds, radians; decides how much is cropped, for all alike.

    Returns:
        The batch with smaller images, and camera matrices and extrinsics to match.

    Raises:
        ConfigurationError: nothing would be left of the image.
    """
    height, width = batch.camera.shape[-2:]
    rotation = euler_to_matrix(angles)
    top, left = margins(batch.K, (height, width), largest)
    size = (height - 2 * top) // MULTIPLE * MULTIPLE, (width - 2 * left) // MULTIPLE * MULTIPLE
    if min(size) < 4 * MULTIPLE:
        raise ConfigurationError(
            f"augmentation.rotation_deg={math.degrees(largest):g}: an image of {height}×{width} px "
            "has nothing left when what such a rotation uncovers is cropped; lower it"
        )
    rows = torch.arange(size[0], device=angles.device) + float(top)
    columns = torch.arange(size[1], device=angles.device) + float(left)
    v, u = torch.meshgrid(rows, columns, indexing="ij")
    pixels = torch.stack([u, v, torch.ones_like(u)], -1).flatten(0, 1)
    back = batch.K @ rotation.transpose(1, 2) @ torch.linalg.inv(batch.K)
    source = pixels @ back.transpose(1, 2)
    source = source[..., :2] / source[..., 2:]
    grid = (2 * source + 1) / source.new_tensor([width, height]) - 1
    camera = F.grid_sample(
        batch.camera.float(), grid.view(len(angles), *size, 2), align_corners=False
    )
    if batch.camera.dtype == torch.uint8:
        camera = camera.round().clamp(0, 255)
    K = batch.K.clone()
    K[:, 0, 2] -= left
    K[:, 1, 2] -= top
    T = batch.T_cam_lidar.clone()
    T[:, :3] = rotation @ T[:, :3]
    return batch._replace(camera=camera.to(batch.camera.dtype), K=K, T_cam_lidar=T)


def margins(K: Tensor, size: tuple[int, int], largest: float) -> tuple[int, int]:
    """Rows and columns to crop on each side, so that no rotation shows what the image has not."""
    focal = float(K[:, :2, :2].max())
    height, width = size
    # A ray at the border moves by f·θ·(1 + x²) for a turn sideways, and by θ times the distance
    # from the centre for a roll.
    across, down = width / 2 / focal, height / 2 / focal
    rows = largest * (focal * (1 + down**2) + focal * down * across + width / 2)
    columns = largest * (focal * (1 + across**2) + focal * down * across + height / 2)
    return math.ceil(1.1 * rows), math.ceil(1.1 * columns)
