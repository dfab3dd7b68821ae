"""UniCal (Cocheteux et al., arXiv 2304.09715): image and LiDAR maps in one MobileViT network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, cast

from torch import Tensor, nn


class Pyramid(Protocol):
    """What a backbone is: it says how many channels its maps have, from fine to coarse."""

    channels: Sequence[int]


class UniCal(nn.Module):
    """One multi-channel image in; six numbers or a displacement map out, as its head decides.

    The published abstract fixes the fusion into one multi-channel input and the MobileViT; its
    layer table is not public, so that backbone and head are settings.

    Args:
        in_channels: C of the input.
        backbone: C → module that maps (B, C, H, W) to a list of maps, fine to coarse.
        head: channels of those maps → module that maps the list to the output.
    """

    def __init__(
        self,
        in_channels: int,
        backbone: Callable[[int], nn.Module],
        head: Callable[[Sequence[int]], nn.Module],
    ) -> None:
        super().__init__()
        self.backbone = backbone(in_channels)
        self.head = head(cast(Pyramid, self.backbone).channels)

    def forward(self, x: Tensor) -> Tensor:
        """Estimate from (B, C, H, W) normalised channels.

        Returns:
            (B, 6) in units of the decalibration's range, (B, 3, 6), or (B, 4, h, w); see
            :mod:`uncal.models.heads`.
        """
        return cast(Tensor, self.head(self.backbone(x)))
