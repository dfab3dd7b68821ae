"""UniCal (Cocheteux et al., arXiv 2304.09715): image and LiDAR maps fused early, one MobileViT."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from uncal.errors import ConfigurationError
from uncal.models.heads import DisplacementHead, PoseHead
from uncal.models.mobilevit import MobileViTPyramid


class UniCal(nn.Module):
    """One multi-channel image in; six numbers (``mlp``) or a displacement map (``geometric``) out.

    The published abstract fixes the early fusion and the MobileViT; its layer table is not public,
    so that widths are settings.

    Args:
        in_channels: C of the input.
        head: ``mlp`` or ``geometric``.
        hidden_sizes: widths of the transformer stages.
        neck_hidden_sizes: widths of stem, stages and final projection.
        expand_ratio: of the inverted residual blocks.
        output_stride: of the last stage.
        head_hidden: widths of the hidden layers of the ``mlp`` head.
        decoder_width: channels of the ``geometric`` head.
        decoder_finest: finest stage that the ``geometric`` head uses; 0 has stride 2, 1 stride 4.
        backbone_dropout: rate in the transformer layers.
        head_dropout: rate in the head.
        pretrained: hub name of backbone weights, or None to train from scratch.
    """

    def __init__(
        self,
        in_channels: int,
        head: str,
        hidden_sizes: Sequence[int],
        neck_hidden_sizes: Sequence[int],
        expand_ratio: float,
        output_stride: int,
        head_hidden: Sequence[int],
        decoder_width: int,
        decoder_finest: int,
        backbone_dropout: float,
        head_dropout: float,
        pretrained: str | None,
    ) -> None:
        super().__init__()
        self.backbone = MobileViTPyramid(
            in_channels,
            hidden_sizes,
            neck_hidden_sizes,
            expand_ratio,
            output_stride,
            backbone_dropout,
            pretrained,
        )
        channels = self.backbone.channels
        self.head: nn.Module
        if head == "mlp":
            self.head = PoseHead(channels[-1], head_hidden, head_dropout)
        elif head == "geometric":
            self.head = DisplacementHead(channels, decoder_width, decoder_finest, head_dropout)
        else:
            raise ConfigurationError(f"model.network.head={head!r}: expected 'mlp' or 'geometric'")

    def forward(self, x: Tensor) -> Tensor:
        """Estimate from one fused image.

        Args:
            x: (B, C, H, W) normalised channels.

        Returns:
            (B, 6) in units of the decalibration's range, or (B, 4, h, w); see :mod:`.heads`.
        """
        output: Tensor = self.head(self.backbone(x))
        return output
