"""Heads on a feature pyramid: six numbers from a pooled vector, or a displacement map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from uncal.models.dropout import FastDropout


class PoseHead(nn.Module):
    """The paper-like head: global average pool, then one MLP each for translation and rotation.

    Args:
        in_channels: of the maps, fine to coarse; the coarsest is pooled.
        hidden: widths of the two hidden layers.
        dropout: rate before each linear layer.
    """

    def __init__(self, in_channels: Sequence[int], hidden: Sequence[int], dropout: float) -> None:
        super().__init__()
        self.translation = self._branch(in_channels[-1], hidden, dropout)
        self.rotation = self._branch(in_channels[-1], hidden, dropout)

    @staticmethod
    def _branch(in_channels: int, hidden: Sequence[int], dropout: float) -> nn.Sequential:
        layers: list[nn.Module] = []
        for width in hidden:
            layers += [FastDropout(dropout), nn.Linear(in_channels, width), nn.LeakyReLU(0.1)]
            in_channels = width
        return nn.Sequential(*layers, FastDropout(dropout), nn.Linear(in_channels, 3))

    def forward(self, maps: list[Tensor]) -> Tensor:
        """Pool and regress: (B, 6) decalibration in units of its range."""
        pooled = maps[-1].mean((2, 3))
        return torch.cat([self.translation(pooled), self.rotation(pooled)], 1)


class QuantileHead(nn.Module):
    """Three :class:`PoseHead` s: the pose, and a lower and an upper quantile around it.

    The quantiles are the pose minus and plus something positive, so that they never cross.
    """

    gives_quantiles = True
    """What ``interval=cqr`` looks for; a head of your own says the same."""

    def __init__(self, in_channels: Sequence[int], hidden: Sequence[int], dropout: float) -> None:
        super().__init__()
        self.pose, self.below, self.above = (
            PoseHead(in_channels, hidden, dropout) for _ in range(3)
        )

    def forward(self, maps: list[Tensor]) -> Tensor:
        """(B, 3, 6) pose, lower and upper quantile in units of the decalibration's range."""
        pose = self.pose(maps)
        below, above = F.softplus(self.below(maps)), F.softplus(self.above(maps))
        return torch.stack([pose, pose - below, pose + above], 1)


class DisplacementHead(nn.Module):
    """A top-down decoder (as in FPN, Lin et al. 2017) that keeps where things are.

    Args:
        in_channels: of the maps, fine to coarse.
        width: channels of the decoder.
        finest: index of the finest map used; the output has its stride.
        dropout: rate on the features before the last layer.
    """

    def __init__(self, in_channels: Sequence[int], width: int, finest: int, dropout: float) -> None:
        super().__init__()
        self.finest = finest
        used = list(in_channels)[finest:]
        self.lateral = nn.ModuleList(nn.Conv2d(c, width, 1) for c in used)
        self.smooth = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(width, width, 3, padding=1, bias=False),
                nn.BatchNorm2d(width),
                nn.SiLU(),
            )
            for _ in used
        )
        self.dropout = FastDropout(dropout)
        self.predict = nn.Conv2d(width, 4, 3, padding=1)
        nn.init.normal_(self.predict.weight, std=1e-3)
        nn.init.zeros_(cast(Tensor, self.predict.bias))

    def forward(self, maps: list[Tensor]) -> Tensor:
        """(B, 4, h, w): displacement in pixels of the input (columns, rows), two log-weights."""
        used = maps[self.finest :]
        x: Tensor | None = None
        pairs = zip(reversed(used), reversed(self.lateral), reversed(self.smooth), strict=True)
        for features, lateral, smooth in pairs:
            y = lateral(features)
            if x is not None:
                y = y + F.interpolate(x, y.shape[-2:], mode="bilinear", align_corners=False)
            x = smooth(y)
        return cast(Tensor, self.predict(self.dropout(x)))
