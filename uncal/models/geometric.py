"""From a displacement map to six numbers: weighted least squares through the projection."""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from uncal.geometry.displacement import displacement_jacobian


class GridPoints(NamedTuple):
    """One LiDAR point per cell of a displacement map: the nearest one that falls into it.

    Attributes:
        points_cam: (B, n, 3) in the decalibrated camera frame, metres; n = h·w cells.
        seen: (B, n) 1 where a point falls into the cell, else 0 (its position then means nothing).
    """

    points_cam: Tensor
    seen: Tensor


def grid_points(inverse_depth: Tensor, K: Tensor, grid: tuple[int, int]) -> GridPoints:
    """Back-project the nearest return of every cell, from the pixel in which it lies.

    Args:
        inverse_depth: (B, 1, H, W) 1/m; 0 where no point falls.
        K: (B, 3, 3) camera matrices of that image.
        grid: (h, w) cells.

    Returns:
        The points, in the order of the flattened grid.
    """
    width = inverse_depth.shape[-1]
    nearest, index = F.adaptive_max_pool2d(inverse_depth, grid, return_indices=True)
    inverse, index = nearest.flatten(1), index.flatten(1)
    row = index.div(width, rounding_mode="floor")
    column = index - row * width
    pixels = torch.stack([column, row, torch.ones_like(row)], -1).to(K.dtype)
    rays = pixels @ torch.linalg.inv(K).transpose(1, 2)
    seen = inverse > 0
    return GridPoints(rays / torch.where(seen, inverse, 1.0)[..., None], seen.to(K.dtype))


class Geometry(NamedTuple):
    """All that the solver needs to know of the points, whatever the network says.

    Attributes:
        points: the LiDAR points of a displacement map's cells.
        jacobian: (B, n, 2, 6) pixels by decalibration in units of its range.
    """

    points: GridPoints
    jacobian: Tensor


class PointGeometry(nn.Module):
    """:func:`grid_points` and their :func:`displacement_jacobian`.

    A module, so that the stochastic passes of one frame can share its output.

    Args:
        bounds: (6,) range of the decalibrations, metres and radians.
    """

    bounds: Tensor

    def __init__(self, bounds: Tensor) -> None:
        super().__init__()
        self.register_buffer("bounds", bounds.clone(), persistent=False)

    def forward(
        self, inverse_depth: Tensor, K: Tensor, T_init: Tensor, grid: tuple[int, int]
    ) -> Geometry:
        """Look at one batch.

        Args:
            inverse_depth: (B, 1, H, W) 1/m of the decalibrated projection.
            K: (B, 3, 3) camera matrices.
            T_init: (B, 4, 4) decalibrated extrinsics.
            grid: (h, w) cells of the displacement map.
        """
        points = grid_points(inverse_depth, K, grid)
        jacobian = displacement_jacobian(points.points_cam, K, T_init) * self.bounds
        return Geometry(points, jacobian)


class GeometricSolver(nn.Module):
    """The decalibration that best explains a displacement map.

    Minimises Σ_i w_i |J_i ξ - d_i|² / n + Σ_j λ_j (ξ_j / range_j)² over the pixels i that a LiDAR
    point reaches; λ, learned per DoF, stands for the prior range. Differentiable.

    Args:
        bounds: (6,) range of the decalibrations, metres and radians.
        ridge: initial λ.
    """

    bounds: Tensor

    def __init__(self, bounds: Tensor, ridge: float) -> None:
        super().__init__()
        self.register_buffer("bounds", bounds.clone())
        self.log_ridge = nn.Parameter(torch.full((6,), ridge).log())

    def forward(self, flow: Tensor, geometry: Geometry) -> Tensor:
        """Solve for six numbers.

        Args:
            flow: (B, 4, h, w) displacement in pixels and two log-weights.
            geometry: of the points in the map's cells.

        Returns:
            (B, 6) decalibration, metres and radians.
        """
        flow = flow.float().flatten(2).transpose(1, 2)
        seen, jacobian = geometry.points.seen, geometry.jacobian.flatten(1, 2)
        weight = flow[..., 2:].clamp(-8.0, 8.0).exp() * seen[..., None]
        weight = weight / seen.sum(1).clamp(min=1.0)[:, None, None]
        weighted = (jacobian * weight.flatten(1)[..., None]).transpose(1, 2)
        normal = weighted @ jacobian + torch.diag(self.log_ridge.exp())
        right = weighted @ flow[..., :2].flatten(1, 2)[..., None]
        return cast(Tensor, torch.linalg.solve(normal, right)).squeeze(-1) * self.bounds
