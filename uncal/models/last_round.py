"""One round of an estimate: the part that stochastic passes repeat."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from uncal.edges.evidence import (
    ProjectedEdges,
    gaussian_factors,
    offsets_of,
    pack,
    project_edges,
)
from uncal.models.evidence import STRIDES, EvidenceNetwork


class LastRound(nn.Module):
    """One round for given extrinsics: the part of an estimate that stochastic passes repeat.

    Args:
        network: gives the curves.
        bounds: (6,) range of the decalibrations, metres and radians.
    """

    bounds: Tensor

    def __init__(self, network: EvidenceNetwork, bounds: Tensor) -> None:
        super().__init__()
        self.network = network
        self.register_buffer("bounds", bounds.clone())
        # Errors of neighbouring edges are alike: what they say together is less than their sum.
        self.log_share = nn.Parameter(torch.full((len(STRIDES),), -1.5))
        self.log_blur = nn.Parameter(torch.tensor([1.4, 0.7, -0.3]))
        self.look = Look(self)

    def forward(self, x: Tensor, edges: Tensor, K: Tensor, T: Tensor, covariance: Tensor) -> Tensor:
        """Normal equations of every frame at the finest scale.

        Args:
            x: (B, C, H, W) network input.
            edges: (B, M, columns).
            K: (B, 3, 3) camera matrices.
            T: (B, 4, 4) extrinsics as they are assumed now.
            covariance: (B, 6, 6) of the pose, in units of the range.

        Returns:
            (B, 27) packed; see :func:`uncal.edges.evidence.pack`.
        """
        level = len(STRIDES) - 1
        projected, read = self.look(x, edges, K, T)
        curves, weights = self.network.curves(read, edges, K, projected, level)
        return pack(*self.equations(curves, weights, projected, covariance, level))

    def equations(
        self,
        curves: Tensor,
        weights: Tensor,
        projected: ProjectedEdges,
        covariance: Tensor,
        level: int,
    ) -> tuple[Tensor, Tensor]:
        """Sum of the edges' Gaussian contributions.

        Args:
            curves: (B, M, R) log-likelihoods.
            weights: (B, M) how much each edge counts.
            projected: the edges.
            covariance: (B, 6, 6) of the pose, in units of the range.
            level: which of :data:`~uncal.models.evidence.STRIDES`.

        Returns:
            (B, 6, 6) and (B, 6) normal equations of what is left of the decalibration.
        """
        J = projected.jacobian
        mean, weight = self.factors(curves, weights, projected, covariance, level)
        weighted = (J * weight[..., None]).transpose(1, 2)
        return weighted @ J, (weighted @ mean[..., None]).squeeze(-1)

    def factors(
        self,
        curves: Tensor,
        weights: Tensor,
        projected: ProjectedEdges,
        covariance: Tensor,
        level: int,
    ) -> tuple[Tensor, Tensor]:
        """Gaussian contribution of each edge; arguments as of :meth:`equations`.

        Returns:
            (B, M) offsets in pixels, and (B, M) precisions in 1/pixels².
        """
        J = projected.jacobian
        variance = ((J @ covariance) * J).sum(-1) + (2 * self.log_blur[level]).exp()
        offsets = offsets_of(STRIDES[level], self.network.reach[level], curves)
        mean, precision = gaussian_factors(curves, offsets, variance, STRIDES[level])
        return mean, precision * weights * self.log_share[level].exp()

    def residual(
        self, x: Tensor, edges: Tensor, K: Tensor, T: Tensor, covariance: Tensor
    ) -> Tensor:
        """How far from their places in the image the solved pose leaves the edges.

        Arguments as of :meth:`forward`.

        Returns:
            (B,) root of the weighted mean of squared offsets, pixels.
        """
        level = len(STRIDES) - 1
        projected, read = self.look(x, edges, K, T)
        curves, weights = self.network.curves(read, edges, K, projected, level)
        mean, weight = self.factors(curves, weights, projected, covariance, level)
        J = projected.jacobian
        weighted = (J * weight[..., None]).transpose(1, 2)
        normal = weighted @ J + torch.linalg.inv(covariance)
        step = torch.linalg.solve(normal, weighted @ mean[..., None])
        left = mean - (J @ step).squeeze(-1)
        mean_square: Tensor = (weight * left**2).sum(-1) / weight.sum(-1).clamp(min=1e-9)
        return mean_square.sqrt()


class Look(nn.Module):
    """Projection and features around the edges: nothing random, so that passes share it.

    Args:
        owner: whose network and bounds it uses; not registered a second time.
    """

    def __init__(self, owner: LastRound) -> None:
        super().__init__()
        self._owner = [owner]

    def forward(
        self, x: Tensor, edges: Tensor, K: Tensor, T: Tensor
    ) -> tuple[ProjectedEdges, Tensor]:
        """What :class:`LastRound` needs of the image.

        Args:
            x: (B, C, H, W) network input.
            edges: (B, M, columns).
            K: (B, 3, 3) camera matrices.
            T: (B, 4, 4) extrinsics as they are assumed now.

        Returns:
            The projected edges and the features around them.
        """
        owner = self._owner[0]
        size = (x.shape[-2], x.shape[-1])
        projected = project_edges(edges, K, T, size, owner.bounds)
        maps = owner.network.describe(x)
        return projected, owner.network.read(maps, projected, len(STRIDES) - 1)
