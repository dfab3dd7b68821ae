"""A network and the solver behind it, as one function from inputs to pose.

The solver goes from a displacement map to six numbers: weighted least squares through the
projection.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from uncal.data.network_input import NetworkInput
from uncal.errors import ConfigurationError
from uncal.geometry.projection import displacement_jacobian, true_displacement
from uncal.models.answer import Answer, Question
from uncal.models.losses import displacement_loss, pinball_loss, pose_loss


class GridPoints(NamedTuple):
    """One LiDAR point per cell of a displacement map: the nearest one that falls into it.

    Attributes:
        points_cam: (B, n, 3) in the decalibrated camera frame, metres; n = h·w cells.
        seen: (B, n) 1 where a point falls into the cell, else 0 (its position then means nothing).
    """

    points_cam: Tensor
    seen: Tensor


def grid_points(inverse_depth: Tensor, K: Tensor, grid: tuple[int, int]) -> GridPoints:
    """Back-project the nearest return of each of (h, w) cells, from the pixel in which it lies.

    Args and shapes are those of :meth:`PointGeometry.forward`; in the order of the flattened grid.
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

    A module, so that the stochastic passes of one frame can share its output; ``bounds`` are the
    (6,) range of the decalibrations, metres and radians.
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
            inverse_depth: (B, 1, H, W) 1/m of the decalibrated projection; 0 without a point.
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
        """(B, 6) decalibration, metres and radians, of (B, 4, h, w) pixels and two log-weights."""
        flow = flow.float().flatten(2).transpose(1, 2)
        seen, jacobian = geometry.points.seen, geometry.jacobian.flatten(1, 2)
        weight = flow[..., 2:].clamp(-8.0, 8.0).exp() * seen[..., None]
        weight = weight / seen.sum(1).clamp(min=1.0)[:, None, None]
        weighted = (jacobian * weight.flatten(1)[..., None]).transpose(1, 2)
        normal = weighted @ jacobian + torch.diag(self.log_ridge.exp())
        right = weighted @ flow[..., :2].flatten(1, 2)[..., None]
        return cast(Tensor, torch.linalg.solve(normal, right)).squeeze(-1) * self.bounds


class DisplacementMap(NamedTuple):
    """What a geometric head says.

    Attributes:
        flow: (B, 4, h, w) displacement in pixels and two log-weights.
        points: the LiDAR points of its cells.
    """

    flow: Tensor
    points: GridPoints


class Estimate(NamedTuple):
    """What a network says of one batch.

    Attributes:
        pose: (B, 6) estimated decalibration, metres and radians.
        displacement: of a geometric head, else None.
        quantiles: a lower and an upper quantile of the pose, each (B, 6), of a head that has them.
    """

    pose: Tensor
    displacement: DisplacementMap | None
    quantiles: tuple[Tensor, Tensor] | None


class PoseEstimator(nn.Module):
    """A network and, if it returns a displacement map, the least-squares solver behind it.

    Args:
        network: (B, C, H, W) → (B, 6) in units of ``bounds``, or → (B, 3, 6) with a lower and an
            upper quantile behind the pose, or → (B, 4, h, w).
        bounds: (6,) range of the decalibrations, metres and radians.
        ridge: initial ridge of the solver.
        displacement_weight: weight of the displacement loss (per pixel) beside the pose loss.
        quantile_levels: what the outputs of a quantile head stand for, such as 0.05 and 0.95.
    """

    bounds: Tensor

    def __init__(
        self,
        network: nn.Module,
        bounds: Tensor,
        ridge: float,
        displacement_weight: float,
        quantile_levels: tuple[float, float],
    ) -> None:
        super().__init__()
        self.displacement_weight = displacement_weight
        self.quantile_levels = quantile_levels
        # Channels last is what convolutions on CPUs and tensor cores are fastest with.
        self.network: nn.Module = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.geometry = PointGeometry(bounds)
        self.solver = GeometricSolver(bounds, ridge)
        self.register_buffer("bounds", bounds.clone(), persistent=False)

    @property
    def repeated(self) -> nn.Module:
        """What stochastic passes repeat: all of it."""
        return self

    def pose(self, batch: NetworkInput) -> Tensor:
        """(n, 6) estimates, metres and radians."""
        return self.estimate(*_single(batch)).pose

    def question(self, batch: NetworkInput) -> Question:
        """The network's own arguments."""
        return Question(_single(batch), None)

    def answer(self, samples: Tensor, batch: NetworkInput, question: Question) -> Answer:
        """The (N, B, 6 or 18) passes as they are; there is no covariance but that of dropout."""
        return Answer(samples, None)

    def loss(self, batch: NetworkInput) -> Tensor:
        """Pose loss plus, for a displacement map, the loss of the map itself."""
        estimate = self.estimate(*_single(batch))
        loss = pose_loss(estimate.pose, batch.target, self.bounds)
        if estimate.displacement is not None:
            flow, points = estimate.displacement
            truth = true_displacement(points.points_cam, batch.K, batch.T_init, batch.target)
            displacement = flow[:, :2].flatten(2).transpose(1, 2)
            error = displacement_loss(displacement, truth, points.seen)
            loss = loss + self.displacement_weight * error
        if estimate.quantiles is not None:
            for level, quantile in zip(self.quantile_levels, estimate.quantiles, strict=True):
                loss = loss + pinball_loss(quantile, batch.target, level, self.bounds)
        return loss

    def estimate(self, x: Tensor, inverse_depth: Tensor, K: Tensor, T_init: Tensor) -> Estimate:
        """The network and, where needed, the solver.

        Args:
            x: (B, C, H, W) the network's input.
            inverse_depth: (B, 1, H, W) 1/m of the decalibrated projection.
            K: (B, 3, 3) camera matrices.
            T_init: (B, 4, 4) decalibrated extrinsics.

        Raises:
            ValueError: the network returned none of the shapes above.
        """
        output = cast(Tensor, self.network(x.contiguous(memory_format=torch.channels_last)))
        batch = len(x)
        if output.shape == (batch, 6):
            return Estimate(output.float() * self.bounds, None, None)
        if output.shape == (batch, 3, 6):
            pose, lower, upper = (output.float() * self.bounds).unbind(1)
            return Estimate(pose, None, (lower, upper))
        if output.ndim != 4 or output.shape[:2] != (batch, 4):
            raise ValueError(
                f"the network returned shape {tuple(output.shape)} for {batch} rows; expected "
                "(B, 6), (B, 3, 6) or (B, 4, h, w)"
            )
        # Pixels and metres need more than half precision.
        with torch.autocast(x.device.type, enabled=False):
            grid = (output.shape[2], output.shape[3])
            geometry = self.geometry(inverse_depth, K, T_init, grid)
            flow = DisplacementMap(output.float(), geometry.points)
            return Estimate(self.solver(output, geometry), flow, None)

    def forward(self, x: Tensor, inverse_depth: Tensor, K: Tensor, T_init: Tensor) -> Tensor:
        """(B, 6) the pose, or (B, 18) with its lower and upper quantiles; see :meth:`estimate`."""
        estimate = self.estimate(x, inverse_depth, K, T_init)
        if estimate.quantiles is None:
            return estimate.pose
        return torch.cat([estimate.pose, *estimate.quantiles], 1)


def _single(batch: NetworkInput) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    if len(batch.unit_index) != len(batch.x):
        raise ConfigurationError(
            "window.frames above 1 adds up the normal equations of several frames, and this "
            "network has none: use model/backbone=edges, or window.frames=1"
        )
    return batch.x, batch.inverse_depth, batch.K, batch.T_init
