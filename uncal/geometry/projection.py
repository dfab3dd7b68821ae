"""LiDAR sweeps to z-buffered images, a whole batch at once, on any device; how pixels move there.

When a decalibration is taken out, they move: to first order, and exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from uncal.geometry import invert, transform_points
from uncal.geometry.decalibration import correct

NEAREST_DEPTH = 0.1
"""Points closer to the image plane than this (metres) are behind or inside the lens."""


class Projection(NamedTuple):
    """A sweep seen from the camera, by the nearest return of every pixel.

    Attributes:
        inverse_depth: (B, 1, H, W) 1/metres along the optical axis; 0 where no point falls.
        intensity: (B, 1, H, W) reflectance of that same point; 0 where no point falls.
    """

    inverse_depth: Tensor
    intensity: Tensor

    @property
    def depth(self) -> Tensor:
        """(B, 1, H, W) metres along the optical axis; 0 where no point falls."""
        return torch.where(self.inverse_depth > 0, 1.0 / self.inverse_depth, 0.0)


def pixel_coordinates(points_cam: Tensor, K: Tensor) -> Tensor:
    """(..., N, 2) column and row, pixels, of (..., N, 3) points in the camera frame, z > 0, metres.

    A pinhole projection by (..., 3, 3) camera matrices; integer coordinates are pixel centres.

    >>> K = torch.tensor([[100.0, 0.0, 50.0], [0.0, 100.0, 20.0], [0.0, 0.0, 1.0]])
    >>> pixel_coordinates(torch.tensor([[1.0, 0.5, 2.0]]), K).tolist()
    [[100.0, 45.0]]
    """
    homogeneous = points_cam @ K.transpose(-1, -2)
    return homogeneous[..., :2] / homogeneous[..., 2:]


def project(points: Tensor, T_cam_lidar: Tensor, K: Tensor, size: tuple[int, int]) -> Projection:
    """Project sweeps with a z-buffer: each pixel keeps depth and intensity of its nearest point.

    The nearest point has the largest inverse depth, so one atomic maximum per point into a zeroed
    image is the whole z-buffer, and its result does not depend on the order of the points.

    Args:
        points: (B, N, 4) x, y, z in metres in the LiDAR frame, and reflectance; rows of NaN pad.
        T_cam_lidar: (B, 4, 4) extrinsics to project with.
        K: (B, 3, 3) camera matrices of the image, pixels.
        size: (H, W) of the image, pixels.

    >>> near, far = [4.0, 0.0, 0.0, 0.9], [8.0, 0.0, 0.0, 0.1]
    >>> camera_from_lidar = torch.tensor(
    ...     [[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])[None]
    >>> K = torch.tensor([[10.0, 0, 1], [0, 10, 1], [0, 0, 1]])[None]
    >>> seen = project(torch.tensor([[far, near]]), camera_from_lidar, K, (3, 3))
    >>> seen.depth[0, 0, 1, 1].item(), round(seen.intensity[0, 0, 1, 1].item(), 3)
    (4.0, 0.9)
    """
    height, width = size
    rotation = K @ T_cam_lidar[:, :3, :3]
    translation = K @ T_cam_lidar[:, :3, 3:]
    u, v, depth = torch.baddbmm(translation, rotation, points[..., :3].transpose(1, 2)).unbind(1)
    inverse_depth = depth.reciprocal()
    column, row = u * inverse_depth + 0.5, v * inverse_depth + 0.5
    visible = (depth > NEAREST_DEPTH) & (column >= 0) & (column < width)
    visible &= (row >= 0) & (row < height)

    which, index = visible.nonzero(as_tuple=True)
    flat = which * points.shape[1] + index
    column, row = column.reshape(-1)[flat].long(), row.reshape(-1)[flat].long()
    pixel = (which * height + row) * width + column
    value = inverse_depth.reshape(-1)[flat]
    images = [points.new_zeros(points.shape[0] * height * width) for _ in range(2)]
    images[0].scatter_reduce_(0, pixel, value, "amax")
    nearest = images[0][pixel] == value
    # Two returns at the very same depth: the brighter one, so that their order never matters.
    reflectance = points[..., 3].reshape(-1)[flat[nearest]]
    images[1].scatter_reduce_(0, pixel[nearest], reflectance, "amax")
    shape = (points.shape[0], 1, height, width)
    return Projection(images[0].view(shape), images[1].view(shape))


def displacement_jacobian(points_cam: Tensor, K: Tensor, T_init: Tensor) -> Tensor:
    """How pixels move when a decalibration is taken out, to first order.

    A point p of the LiDAR frame, seen at q = T_init p, belongs at T_init D⁻¹ p, that is
    q - R_init (t + ω × p) for a small D with translation t and rotation vector ω.

    Args:
        points_cam: (B, N, 3) points q in the decalibrated camera frame, metres.
        K: (B, 3, 3) camera matrices.
        T_init: (B, 4, 4) decalibrated extrinsics.

    Returns:
        (B, N, 2, 6) pixels per metre and per radian.
    """
    x, y, z = points_cam.unbind(-1)
    fx, fy = K[:, 0, 0, None], K[:, 1, 1, None]
    zero = torch.zeros_like(z)
    pixel_by_point = torch.stack(
        [
            torch.stack([fx / z, zero, -fx * x / z**2], -1),
            torch.stack([zero, fy / z, -fy * y / z**2], -1),
        ],
        -2,
    )
    points = transform_points(invert(T_init), points_cam)
    by_translation = -(pixel_by_point @ T_init[:, None, :3, :3])
    # a · (ω × p) = ω · (p × a)
    by_rotation = torch.linalg.cross(
        points[:, :, None, :].expand_as(by_translation), by_translation
    )
    return torch.cat([by_translation, by_rotation], -1)


def true_displacement(points_cam: Tensor, K: Tensor, T_init: Tensor, target: Tensor) -> Tensor:
    """Where pixels really belong, minus where they are; exact, not linearised.

    Args:
        points_cam: (B, N, 3) points in the decalibrated camera frame, metres.
        K: (B, 3, 3) camera matrices.
        T_init: (B, 4, 4) decalibrated extrinsics.
        target: (B, 6) the decalibration.

    Returns:
        (B, N, 2) columns and rows, pixels.
    """
    move = correct(T_init, target) @ invert(T_init)
    moved = transform_points(move, points_cam)
    here = points_cam[..., :2] / points_cam[..., 2:]
    there = moved[..., :2] / moved[..., 2:].clamp(min=0.1)
    focal = torch.stack([K[:, 0, 0], K[:, 1, 1]], -1)[:, None]
    return (there - here) * focal
