"""From what an image shows around projected edges to normal equations of the decalibration.

An edge of the sweep, projected with the extrinsic as it is assumed now, should lie on an edge of
the image. Along the direction in which it is sharp (columns for an edge between azimuths, rows for
one between lasers) a *curve* gives the log-likelihood of each offset. A curve may have several
peaks, so it is not reduced to its best: under the uncertainty of the pose as it is now, the curve's
posterior has a mean and a variance, and the Gaussian that turns the prior into that posterior is
the edge's contribution (assumed-density filtering; Minka 2001, "Expectation propagation", 3.1).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from uncal.edges.sweep import N_ACROSS
from uncal.geometry import transform_points
from uncal.geometry.projection import displacement_jacobian

NEAREST_M = 0.5
"""Edges nearer than this to the camera's plane are not projected."""

WIDEST_PX = 20.0
"""Largest standard deviation of an edge's position that a curve is read under."""


class ProjectedEdges(NamedTuple):
    """Edges as an assumed extrinsic shows them.

    Attributes:
        points_cam: (B, M, 3) camera frame, metres.
        pixels: (B, M, 2) column and row.
        along: (B, M) 1 where the edge is sharp across rows, 0 where it is across columns.
        seen: (B, M) 1 where the edge lies in the image, else 0.
        jacobian: (B, M, 6) how far the edge moves, in the direction in which it is sharp, when a
            decalibration is taken out; pixels by units of the decalibrations' range.
    """

    points_cam: Tensor
    pixels: Tensor
    along: Tensor
    seen: Tensor
    jacobian: Tensor


def project_edges(
    edges: Tensor, K: Tensor, T: Tensor, size: tuple[int, int], bounds: Tensor
) -> ProjectedEdges:
    """Project edges with an extrinsic.

    Args:
        edges: (B, M, columns) as :data:`uncal.edges.sweep.COLUMNS`; rows of NaN pad.
        K: (B, 3, 3) camera matrices, pixels.
        T: (B, 4, 4) extrinsics assumed.
        size: (H, W) of the image, pixels.
        bounds: (6,) range of the decalibrations, metres and radians.

    Returns:
        What is known of each edge; finite everywhere.
    """
    present = ~edges[..., 0].isnan()
    q = transform_points(T, torch.where(present[..., None], edges[..., :3], 0.0))
    present = present & (q[..., 2] > NEAREST_M)
    ahead = q.new_tensor([0.0, 0.0, 10.0])
    q = torch.where(present[..., None], q, ahead)
    focal, centre = torch.stack([K[:, 0, 0], K[:, 1, 1]], -1), K[:, :2, 2]
    pixels = q[..., :2] / q[..., 2:] * focal[:, None] + centre[:, None]
    largest = pixels.new_tensor([size[1] - 1.0, size[0] - 1.0])
    seen = (present & ((pixels >= 0) & (pixels <= largest)).all(-1)).to(q.dtype)
    along = (edges[..., 3] >= N_ACROSS).to(q.dtype)
    both = displacement_jacobian(q, K, T) * bounds
    jacobian = torch.where(along[..., None] > 0, both[..., 1, :], both[..., 0, :])
    return ProjectedEdges(q, pixels, along, seen, jacobian * seen[..., None])


def sharp_component(vectors: Tensor, along: Tensor) -> Tensor:
    """Column or row component, whichever the edge is sharp in.

    Args:
        vectors: (B, M, 2) column and row.
        along: (B, M) of :class:`ProjectedEdges`.

    Returns:
        (B, M).
    """
    return torch.where(along > 0, vectors[..., 1], vectors[..., 0])


def profiles(maps: Tensor, pixels: Tensor, along: Tensor, stride: int, reach: int) -> Tensor:
    """Feature maps along the direction in which each edge is sharp.

    Args:
        maps: (B, C, H/stride, W/stride); each cell stands for the middle of its pixels.
        pixels: (B, M, 2) column and row in the full image.
        along: (B, M) 1 to read along rows' direction (vertically), 0 along columns'.
        stride: pixels from one cell, and from one offset, to the next.
        reach: offsets on each side.

    Returns:
        (B, C, M, 2·reach + 1), bilinear; 0 outside the image.
    """
    offsets = stride * torch.arange(-reach, reach + 1, device=maps.device, dtype=maps.dtype)
    direction = torch.stack([1.0 - along, along], -1)
    at = pixels[:, :, None] + direction[:, :, None] * offsets[:, None]
    height, width = maps.shape[-2:]
    half = (stride - 1) / 2
    cells = (at - half) / stride
    size = cells.new_tensor([width, height])
    # grid_sample's borders are the outer edges of the outermost cells.
    grid = (2 * cells + 1) / size - 1
    return F.grid_sample(maps, grid, mode="bilinear", padding_mode="zeros", align_corners=False)


def offsets_of(stride: int, reach: int, like: Tensor) -> Tensor:
    """(2·reach + 1,) offsets of a profile in pixels."""
    return stride * torch.arange(-reach, reach + 1, device=like.device, dtype=like.dtype)


def gaussian_factors(
    curves: Tensor, offsets: Tensor, variance: Tensor, stride: int
) -> tuple[Tensor, Tensor]:
    """The Gaussian that a curve amounts to, under the present uncertainty of its edge's position.

    With prior N(0, s²) and posterior mean m and variance v, the factor has precision
    λ = 1/v - 1/s² (none where the curve says less than nothing) and mean m / (v λ).

    Args:
        curves: (B, M, R) log-likelihood of each offset.
        offsets: (R,) pixels.
        variance: (B, M) s², pixels².
        stride: pixels between offsets; an offset cannot be told more finely than that.

    Returns:
        Means (B, M) in pixels, within two prior standard deviations, and precisions (B, M) in
        1/pixels².

    >>> offsets = torch.arange(-8.0, 9.0)
    >>> curve = -0.5 * (offsets - 1.0) ** 2 / 4.0
    >>> mean, precision = gaussian_factors(curve[None, None], offsets, torch.full((1, 1), 4.0), 1)
    >>> round(mean.item(), 1), round(precision.item(), 2)
    (1.0, 0.24)
    """
    quantum = 0.08 * stride**2
    variance = variance.clamp(max=WIDEST_PX**2)
    posterior = (curves - 0.5 * offsets**2 / variance[..., None]).softmax(-1)
    mean = (posterior * offsets).sum(-1)
    spread = (posterior * offsets**2).sum(-1) - mean**2 + quantum
    precision = (1.0 / spread - 1.0 / (variance + quantum)).clamp(min=0.0)
    far = 2.0 * variance.sqrt()
    factor = mean / spread / precision.clamp(min=1e-3)
    return torch.minimum(torch.maximum(factor, -far), far), precision


_PLACES = [i * (11 - i) // 2 + j for i, j in (sorted(divmod(n, 6)) for n in range(36))]
"""Where :func:`pack` puts the entries of a symmetric matrix, row by row."""


def pack(normal: Tensor, right: Tensor) -> Tensor:
    """Normal equations as one row per frame, so that they can be added up and remembered.

    Args:
        normal: (..., 6, 6) symmetric.
        right: (..., 6).

    Returns:
        (..., 27): the upper triangle, then the right-hand side.
    """
    rows, columns = torch.triu_indices(6, 6, device=normal.device)
    return torch.cat([normal[..., rows, columns], right], -1)


def unpack(packed: Tensor) -> tuple[Tensor, Tensor]:
    """The inverse of :func:`pack`.

    Args:
        packed: (..., 27).

    Returns:
        (..., 6, 6) and (..., 6).

    >>> normal, right = torch.eye(6), torch.arange(6.0)
    >>> back = unpack(pack(normal, right))
    >>> bool((back[0] == normal).all() and (back[1] == right).all())
    True
    """
    places = torch.tensor(_PLACES, device=packed.device)
    return packed[..., places].reshape(*packed.shape[:-1], 6, 6), packed[..., 21:]
