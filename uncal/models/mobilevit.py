"""Backbones of MobileViT (Mehta and Rastegari, ICLR 2022) blocks, taken from `transformers`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

from torch import Tensor, nn
from transformers import MobileViTConfig, MobileViTModel

from uncal.models.dropout import use_fast_dropout


class MobileViT(nn.Module):
    """The published MobileViT: all channels fused early, five stages.

    Dropout of rate ``dropout`` stands in every transformer layer (after attention and after the
    MLP), which is what the paper calls the backbone layers.

    Args:
        in_channels: C of the input.
        hidden_sizes: widths of the three transformer stages.
        neck_hidden_sizes: widths of the stem, the five stages and the final projection.
        expand_ratio: of the inverted residual blocks.
        output_stride: of the last stage, 8, 16 or 32.
        dropout: rate in the transformer layers.
        pretrained: hub name of weights to start from (``apple/mobilevit-small``; sizes must then
            be that model's, and the first convolution starts anew unless C = 3), or None.
    """

    def __init__(
        self,
        in_channels: int,
        hidden_sizes: Sequence[int],
        neck_hidden_sizes: Sequence[int],
        expand_ratio: float,
        output_stride: int,
        dropout: float,
        pretrained: str | None,
    ) -> None:
        super().__init__()
        sizes: dict[str, Any] = {
            "num_channels": in_channels,
            "hidden_sizes": list(hidden_sizes),
            "neck_hidden_sizes": list(neck_hidden_sizes),
            "expand_ratio": float(expand_ratio),
            "output_stride": output_stride,
            "hidden_dropout_prob": dropout,
        }
        if pretrained is None:
            self.body = MobileViTModel(MobileViTConfig(**sizes), expand_output=False)
        else:
            self.body = MobileViTModel.from_pretrained(
                pretrained, ignore_mismatched_sizes=True, expand_output=False, **sizes
            )
        use_fast_dropout(self.body)
        self.channels: tuple[int, ...] = tuple(neck_hidden_sizes[1:6])

    def forward(self, x: Tensor) -> list[Tensor]:
        """Features of (B, C, H, W), fine to coarse; H and W are best multiples of 32.

        Returns:
            Five maps (B, channels[i], H/s, W/s), s = 2, 4, 8, 16 and the output stride.
        """
        maps = []
        x = cast(Tensor, self.body.conv_stem(x))
        for stage in self.body.encoder.layer:
            x = cast(Tensor, stage(x))
            maps.append(x)
        return maps
