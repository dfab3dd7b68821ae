"""What an image says of where each LiDAR edge lies: learned, or by image gradients alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from uncal.edges.evidence import ProjectedEdges, profiles
from uncal.edges.image import IMAGE_EDGES, edge_maps
from uncal.edges.sweep import CONTRAST, GAP, KIND, KINDS, REFLECTANCE, SIDE, STRENGTH
from uncal.errors import ConfigurationError
from uncal.models.dropout import FastDropout

STRIDES: tuple[int, ...] = (4, 2, 1)
"""Pixels per cell of the feature maps, coarse to fine."""

ATTRIBUTES = len(KINDS) + 8
"""Numbers that describe an edge to the network; see :meth:`EvidenceNetwork.attributes`."""

FIXED = 2
"""The last channels of every feature map: :func:`uncal.edges.image.edge_maps`."""

BLOCK_PX = 24.0
"""Side of the blocks of an image whose edges are dropped together, pixels."""

BLOCKS = (8, 16)
"""Rows and columns of blocks with a fate of their own; beyond that fates repeat."""


class EvidenceNetwork(nn.Module):
    """Curves of log-likelihood for the edges of a sweep, from features of the image.

    A small convolutional network describes every pixel of the image, at three scales; it never
    sees the LiDAR. A perceptron turns what is known of an edge of the sweep (kind, side, strength,
    depth, reflectance) into a query; a pixel's log-likelihood of being where the edge lies is the
    product of query and features. Two of the features are fixed image gradients with a fixed share
    in the query, so that the network starts as an alignment of edges and improves on it.

    Dropout acts on whole channels of features, the same for all edges, and on the evidence of all
    edges in a block of the image at once: errors of neighbouring edges are common, and dropping
    them one by one would average out.

    Args:
        in_channels: C of the input; only the camera's channels are read.
        camera_channels: the first channels of the input are the camera's.
        image_edges: what image gradients are taken of; see :func:`uncal.edges.image.edge_maps`.
        window: half the side of the area that edges are normalised in, pixels.
        widths: channels at strides 2, 4 and 8.
        features: channels of the feature maps that queries are multiplied with.
        reach: offsets on each side at each of :data:`STRIDES`.
        channel_dropout: rate on channels of features.
        evidence_dropout: rate on blocks of edges.

    Raises:
        ConfigurationError: a setting is out of its range.
    """

    reads_edges = True

    def __init__(
        self,
        in_channels: int,
        camera_channels: int,
        image_edges: str,
        window: int,
        widths: Sequence[int],
        features: int,
        reach: Sequence[int],
        channel_dropout: float,
        evidence_dropout: float,
    ) -> None:
        super().__init__()
        if image_edges not in IMAGE_EDGES:
            raise ConfigurationError(
                f"model.image_edges={image_edges}: expected {' or '.join(IMAGE_EDGES)}"
            )
        if len(widths) != 3 or len(reach) != len(STRIDES) or min(*widths, *reach, window) < 1:
            raise ConfigurationError(
                f"model.network: widths={list(widths)}, reach={list(reach)}, window={window}: "
                "expected three numbers each for widths and reach, and all of them at least 1"
            )
        self.camera_channels = camera_channels
        self.image_edges = image_edges
        self.window = window
        self.features = features
        self.reach = tuple(reach)
        half, quarter, eighth = widths
        # Wide maps at half size cost a CPU a sixth of narrow ones at full size.
        self.stem = nn.Sequential(
            nn.Conv2d(camera_channels + FIXED, half, 4, 2, 1, bias=False),
            nn.BatchNorm2d(half),
            nn.ReLU(inplace=True),
            _convolution(half, half),
        )
        self.quarter = nn.Sequential(_convolution(half, quarter, 2), _convolution(quarter, quarter))
        self.eighth = nn.Sequential(_convolution(quarter, eighth, 2), _convolution(eighth, eighth))
        self.to_quarter = nn.Conv2d(eighth, quarter, 1)
        self.join_quarter = _convolution(quarter, quarter)
        self.to_half = nn.Conv2d(quarter, half, 1)
        self.heads = nn.ModuleList(
            [
                nn.Conv2d(quarter, features, 1),
                nn.Conv2d(half, features, 1),
                nn.ConvTranspose2d(half, features, 2, 2),
            ]
        )
        self.queries = nn.ModuleList(_perceptron(features + FIXED) for _ in STRIDES)
        self.gain = nn.Parameter(torch.full((len(STRIDES),), 0.8))
        self.channel_dropout = FastDropout(channel_dropout)
        self.evidence_dropout = FastDropout(evidence_dropout)
        self.products = Products(self)

    def describe(self, x: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Features of the image.

        Args:
            x: (B, C, H, W) network input; H and W multiples of 8.

        Returns:
            Learned (B, features, H/s, W/s) and fixed ones (B, 2, H/s, W/s) for each stride s of
            :data:`STRIDES`.
        """
        camera = x[:, : self.camera_channels]
        with torch.no_grad():
            edges = edge_maps(camera, self.window, self.image_edges)
        full = torch.cat([camera, edges], 1)
        half = self.stem(full.contiguous(memory_format=torch.channels_last))
        quarter = self.quarter(half)
        eighth = self.eighth(quarter)
        quarter = self.join_quarter(F.relu(quarter + _doubled(self.to_quarter(eighth), quarter)))
        half = F.relu(half + _doubled(self.to_half(quarter), half))
        learned = [head(maps) for head, maps in zip(self.heads, (quarter, half, half), strict=True)]
        return [
            (maps.float(), edges if s == 1 else F.avg_pool2d(edges, s))
            for maps, s in zip(learned, STRIDES, strict=True)
        ]

    def read(
        self, maps: list[tuple[Tensor, Tensor]], projected: ProjectedEdges, level: int
    ) -> Tensor:
        """Features around every edge, before any dropout.

        Returns:
            (B, features + 2, M, 2·reach + 1).
        """
        at = projected.pixels, projected.along, STRIDES[level], self.reach[level]
        return torch.cat([profiles(part, *at) for part in maps[level]], 1)

    def curves(
        self, read: Tensor, edges: Tensor, K: Tensor, projected: ProjectedEdges, level: int
    ) -> tuple[Tensor, Tensor]:
        """Log-likelihood of every offset, and how much each edge counts.

        Args:
            read: of :meth:`read`.
            edges: (B, M, columns).
            K: (B, 3, 3) camera matrices.
            projected: the edges.
            level: which of :data:`STRIDES`.

        Returns:
            Curves (B, M, R) and weights (B, M).
        """
        products, fixed = self.products(read, edges, K, projected, level)
        ones = torch.ones(products.shape[:2], dtype=products.dtype, device=products.device)
        kept = self.channel_dropout(ones)
        learned = torch.bmm(kept[:, None], products).view(fixed.shape)
        return learned + fixed, projected.seen * self._kept(projected)

    def attributes(self, edges: Tensor, K: Tensor, projected: ProjectedEdges) -> Tensor:
        """What is known of an edge, in numbers of order one.

        Args:
            edges: (B, M, columns).
            K: (B, 3, 3) camera matrices.
            projected: the edges.

        Returns:
            (B, M, :data:`ATTRIBUTES`).
        """
        edges = edges.nan_to_num()
        kind = F.one_hot(edges[..., KIND].long(), len(KINDS)).to(edges.dtype)
        depth = projected.points_cam[..., 2]
        side = edges[..., SIDE]
        columns = [
            side,
            2.0 * edges[..., STRENGTH],
            0.3 * edges[..., GAP] * K[:, 0, 0, None],
            2.0 * edges[..., REFLECTANCE],
            2.0 * edges[..., CONTRAST],
            3.0 / depth,
            3.0 / depth * side,
            depth.log() - 2.5,
        ]
        return torch.cat([kind, torch.stack(columns, -1)], -1)

    def _kept(self, projected: ProjectedEdges) -> Tensor:
        """(B, M) 1 without dropout, else 0 or 1/(1-p), alike for all edges of a block."""
        rows, columns = BLOCKS
        ones = projected.seen.new_ones(len(projected.seen), rows * columns)
        kept: Tensor = self.evidence_dropout(ones)
        pixels = projected.pixels.detach()
        cell = (pixels / BLOCK_PX).long()
        index = (cell[..., 1] % rows) * columns + cell[..., 0] % columns
        return kept.gather(1, index)


class Products(nn.Module):
    """Queries times features at every offset: nothing random, so that passes share it.

    Args:
        owner: whose queries and gains it uses; not registered a second time.
    """

    def __init__(self, owner: EvidenceNetwork) -> None:
        super().__init__()
        self._owner = [owner]

    def forward(
        self, read: Tensor, edges: Tensor, K: Tensor, projected: ProjectedEdges, level: int
    ) -> tuple[Tensor, Tensor]:
        """What each channel says, to be summed over those that dropout keeps.

        Args:
            read: (B, features + 2, M, R) of :meth:`EvidenceNetwork.read`.
            edges: (B, M, columns).
            K: (B, 3, 3) camera matrices.
            projected: the edges.
            level: which of :data:`STRIDES`.

        Returns:
            (B, features + 2, M·R) of the channels, and (B, M, R) of the fixed share in the query.
        """
        owner = self._owner[0]
        query = owner.queries[level](owner.attributes(edges, K, projected))
        strength = edges[..., STRENGTH].nan_to_num().clamp(0.02, 1.0).sqrt() * owner.gain[level]
        share = torch.stack([1.0 - projected.along, projected.along], 1) * strength[:, None]
        fixed = (share[..., None] * read[:, owner.features :]).sum(1)
        return (query.transpose(1, 2)[..., None] * read).flatten(2), fixed


def _convolution(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


def _perceptron(outputs: int) -> nn.Sequential:
    layers = nn.Sequential(
        nn.Linear(ATTRIBUTES, 48), nn.ReLU(), nn.Linear(48, 48), nn.ReLU(), nn.Linear(48, outputs)
    )
    last = cast(nn.Linear, layers[-1])
    nn.init.normal_(last.weight, std=0.02)
    nn.init.zeros_(last.bias)
    return layers


def _doubled(x: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(x, like.shape[-2:], mode="bilinear", align_corners=False)
