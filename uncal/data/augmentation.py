"""Training-time augmentation of whole batches, on the device."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import torch
from torch import Tensor

from uncal.data.camera_rotation import rotate_cameras
from uncal.data.dataset import Batch
from uncal.edges.sweep import KIND, N_ACROSS, SIDE
from uncal.settings.group import SettingsGroup
from uncal.settings.rules import number


def mirror(batch: Batch, which: Tensor) -> Batch:
    """Mirror samples where (B,) ``which`` says: camera, its matrix, sweep and extrinsic together.

    With M the reflection of the camera's x axis and L of the LiDAR's y axis, the mirrored rig has
    ``T' = M · T · L``, again a rigid transform, and sees the mirrored scene exactly as the true
    rig sees the true one. It doubles the scenes and the rigs.
    """
    width = batch.camera.shape[-1]
    camera = torch.where(which[:, None, None, None], batch.camera.flip(-1), batch.camera)
    K = batch.K.clone()
    K[:, 0, 2] = torch.where(which, width - 1 - K[:, 0, 2], K[:, 0, 2])
    sign = torch.where(which, -1.0, 1.0)
    points = batch.points.clone()
    points[..., 1] *= sign[:, None]
    edges = batch.edges.clone()
    edges[..., 1] *= sign[:, None]
    across = edges[..., KIND] < N_ACROSS
    edges[..., SIDE] = torch.where(across, edges[..., SIDE] * sign[:, None], edges[..., SIDE])
    T = batch.T_cam_lidar.clone()
    T[:, 0, :] *= sign[:, None]
    T[:, :, 1] *= sign[:, None]
    return batch._replace(camera=camera, K=K, points=points, edges=edges, T_cam_lidar=T)


@dataclass(frozen=True)
class Augmentation(SettingsGroup):
    """What happens to a training batch before it is decalibrated.

    Attributes:
        mirror: probability of mirroring a sample left-right.
        brightness: exposure of images varies by a factor within 1 ± this.
        contrast: contrast about an image's mean varies by a factor within 1 ± this.
        rotation_deg: the camera is turned by up to so many degrees about each of its axes; see
            :mod:`uncal.data.camera_rotation`.
    """

    key: ClassVar[str] = "augmentation"
    mirror: Annotated[float, number(0, 1)]
    brightness: Annotated[float, number(0, 1)]
    contrast: Annotated[float, number(0, 1)]
    rotation_deg: Annotated[float, number(0, 20)] = 0.0

    def __call__(self, batch: Batch) -> Batch:
        """Augment a batch with torch's global generator."""
        n, device = len(batch.frames), batch.camera.device
        if self.mirror > 0:
            batch = mirror(batch, torch.rand(n, device=device) < self.mirror)
        if self.rotation_deg > 0:
            largest = math.radians(self.rotation_deg)
            angles = (2.0 * torch.rand(n, 3, device=device) - 1.0) * largest
            batch = rotate_cameras(batch, angles, largest)
        is_image = batch.camera.dtype == torch.uint8
        if is_image and (self.brightness > 0 or self.contrast > 0):
            low = 1.0 - torch.tensor([self.brightness, self.contrast], device=device)
            factor = low + (1.0 - low) * 2.0 * torch.rand(n, 2, device=device)
            gain, contrast = factor[:, 0, None, None, None], factor[:, 1, None, None, None]
            image = batch.camera.float()
            mean = image.mean((1, 2, 3), keepdim=True)
            image = ((image - mean) * contrast + mean) * gain
            batch = batch._replace(camera=image.clamp(0.0, 255.0).to(torch.uint8))
        return batch
