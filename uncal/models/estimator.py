"""A network and the solver behind it, as one function from inputs to pose."""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from uncal.data.network_input import NetworkInput
from uncal.errors import ConfigurationError
from uncal.geometry.displacement import true_displacement
from uncal.models.answer import Answer, Question
from uncal.models.geometric import GeometricSolver, GridPoints, PointGeometry
from uncal.models.losses import displacement_loss, pinball_loss, pose_loss


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
        """The passes as they are; there is no covariance but that of dropout.

        Args:
            samples: (N, B, 6 or 18).
            batch: the same batch.
            question: what was asked.
        """
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

        Returns:
            Pose, and what else the network says.

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
