"""What training minimises."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from uncal.models.answer import State


def pose_loss(estimate: Tensor, target: Tensor, bounds: Tensor) -> Tensor:
    """Smooth L1 of (B, 6) poses, m and rad, in units of their (6,) range; mean over all."""
    return F.smooth_l1_loss(estimate / bounds, target / bounds, beta=0.2)


def displacement_loss(displacement: Tensor, truth: Tensor, seen: Tensor) -> Tensor:
    """Mean absolute error of the displacement, where a LiDAR point tells the truth.

    Points close to the camera can be displaced by far more than the image; errors beyond
    20 pixels count as 20, lest one such point outweigh the rest. Displacements are (B, n, 2)
    pixels; ``seen`` is (B, n), 1 where there is a point, else 0.
    """
    error = (displacement - truth).abs().clamp(max=20.0) * seen[..., None]
    return error.sum() / (2.0 * seen.sum().clamp(min=1.0))


def pinball_loss(quantile: Tensor, target: Tensor, level: float, bounds: Tensor) -> Tensor:
    """What a quantile of a level in (0, 1) minimises (Koenker and Bassett 1978), mean over all.

    Quantile and target are (B, 6), metres and radians, in units of their (6,) range.

    >>> one = torch.ones(1, 6)
    >>> round(pinball_loss(0 * one, one, 0.9, one[0]).item(), 2)
    0.9
    """
    error = (target - quantile) / bounds
    return (level * error).maximum((level - 1.0) * error).mean()


def relative_error(estimate: Tensor, target: Tensor) -> Tensor:
    """(6,) mean absolute error over mean absolute decalibration of (n, 6); 1 is doing nothing.

    >>> relative_error(torch.zeros(2, 6), torch.ones(2, 6)).tolist()
    [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    """
    return (estimate - target).abs().mean(0) / target.abs().mean(0)


def cross_entropy(curves: Tensor, offset: Tensor, seen: Tensor, stride: int) -> Tensor:
    """Mean of -log p(true offset), linear between the two offsets next to it.

    Args:
        curves: (B, M, R) log-likelihoods, R odd.
        offset: (B, M) true offsets, pixels; those beyond the curve do not count.
        seen: (B, M) which edges do.
        stride: pixels between the curve's offsets.

    >>> curve = torch.log_softmax(torch.tensor([[[0.0, 1.0, 0.0]]]), -1)
    >>> loss = cross_entropy(curve, torch.zeros(1, 1), torch.ones(1, 1), 1)
    >>> torch.allclose(loss, -curve[0, 0, 1])
    True
    """
    reach = curves.shape[-1] // 2
    counted = seen * (offset.abs() < (reach - 0.5) * stride)
    position = (offset / stride + reach).clamp(0.0, 2 * reach - 1e-3)
    left = position.floor().long()
    part = position - left
    log = curves.log_softmax(-1)
    at_left = log.gather(-1, left[..., None]).squeeze(-1)
    at_right = log.gather(-1, left[..., None] + 1).squeeze(-1)
    value = -(at_left * (1 - part) + at_right * part) * counted
    return value.sum() / counted.sum().clamp(min=1.0)


def surprise(state: State, truth: Tensor) -> Tensor:
    """Gaussian -log p(truth) per DoF, without its constant; mean over units, each at most 8.

    Args:
        state: n units.
        truth: (n, 6) in units of the range.
    """
    error = (truth - state.pose)[..., None]
    factor: Tensor = torch.linalg.cholesky(state.covariance)
    squared = (torch.cholesky_solve(error, factor) * error).sum((1, 2))
    log_det = factor.diagonal(dim1=1, dim2=2).log().sum(1)
    return ((0.5 * squared + log_det) / 6).clamp(max=8.0).mean()
