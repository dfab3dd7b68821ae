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

    def encode(self, x: Tensor) -> Tensor:
        """The part that no dropout reaches, as far as the backbone tells it apart.

        Args:
            x: (B, C, H, W) normalised channels.

        Returns:
            The backbone's features before its first dropout, or ``x``.
        """
        encode = getattr(self.backbone, "encode", None)
        return x if encode is None else cast(Tensor, encode(x))

    def decode(self, features: Tensor) -> Tensor:
        """Everything from the first dropout on.

        Args:
            features: what :meth:`encode` returned.

        Returns:
            (B, 6) in units of the decalibration's range, or (B, 4, h, w); see
            :mod:`uncal.models.heads`.
        """
        maps = getattr(self.backbone, "decode", self.backbone)(features)
        return cast(Tensor, self.head(maps))

    def forward(self, x: Tensor) -> Tensor:
        """Both parts, one after the other."""
        return self.decode(self.encode(x))
