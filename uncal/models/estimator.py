"""A network and the solver behind it, as one function from inputs to pose."""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from uncal.models.geometric import GeometricSolver, grid_points


class Estimate(NamedTuple):
    """What a network says of one batch.

    Attributes:
        pose: (B, 6) estimated decalibration, metres and radians.
        flow: (B, 4, h, w) displacement map and log-weights of the geometric head, else None.
    """

    pose: Tensor
    flow: Tensor | None


class PoseEstimator(nn.Module):
    """A network and, if it returns a displacement map, the least-squares solver behind it.

    Args:
        network: (B, C, H, W) → (B, 6) in units of ``bounds``, or → (B, 4, h, w).
        bounds: (6,) range of the decalibrations, metres and radians.
        ridge: initial ridge of the solver.
    """

    bounds: Tensor

    def __init__(self, network: nn.Module, bounds: Tensor, ridge: float) -> None:
        super().__init__()
        # Channels last is what convolutions on CPUs and tensor cores are fastest with.
        self.network: nn.Module = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.solver = GeometricSolver(bounds, ridge)
        self.register_buffer("bounds", bounds.clone(), persistent=False)

    def encode(self, x: Tensor) -> Tensor:
        """The part of the network that no dropout reaches, if it says so by an ``encode`` method.

        Args:
            x: (B, C, H, W) the network's input.

        Returns:
            What its ``decode`` goes on with; ``x`` itself for a network without the two.
        """
        x = x.contiguous(memory_format=torch.channels_last)
        encode = getattr(self.network, "encode", None)
        return x if encode is None else cast(Tensor, encode(x))

    def decode(
        self, features: Tensor, inverse_depth: Tensor, K: Tensor, T_init: Tensor
    ) -> Estimate:
        """The rest of the network and, where needed, the solver.

        Args:
            features: what :meth:`encode` returned.
            inverse_depth: (B, 1, H, W) 1/m of the decalibrated projection.
            K: (B, 3, 3) camera matrices.
            T_init: (B, 4, 4) decalibrated extrinsics.

        Returns:
            Pose and displacement map.

        Raises:
            ValueError: the network returned neither of the two shapes.
        """
        output = cast(Tensor, getattr(self.network, "decode", self.network)(features))
        if output.shape == (len(features), 6):
            return Estimate(output.float() * self.bounds, None)
        if output.ndim != 4 or output.shape[1] != 4:
            raise ValueError(
                f"the network returned shape {tuple(output.shape)}; expected (B, 6) or (B, 4, h, w)"
            )
        # Pixels and metres need more than half precision.
        with torch.autocast(features.device.type, enabled=False):
            points = grid_points(inverse_depth, K, (output.shape[2], output.shape[3]))
            return Estimate(self.solver(output, points, K, T_init), output)

    def forward(self, x: Tensor, inverse_depth: Tensor, K: Tensor, T_init: Tensor) -> Tensor:
        """The pose alone; see :meth:`decode`."""
        return self.decode(self.encode(x), inverse_depth, K, T_init).pose


class StochasticPart(nn.Module):
    """What differs from pass to pass: an estimator from behind its ``encode`` on.

    The encoder's weights belong to its state too, so that a fingerprint covers the whole.

    Args:
        estimator: the whole.
    """

    def __init__(self, estimator: PoseEstimator) -> None:
        super().__init__()
        self.estimator = estimator

    def forward(self, features: Tensor, inverse_depth: Tensor, K: Tensor, T_init: Tensor) -> Tensor:
        """(B, 6) pose; see :meth:`PoseEstimator.decode`."""
        return self.estimator.decode(features, inverse_depth, K, T_init).pose
