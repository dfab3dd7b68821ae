"""Backbones of MobileViT (Mehta and Rastegari, ICLR 2022) blocks, taken from `transformers`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor, nn
from transformers import MobileViTConfig, MobileViTModel
from transformers.models.mobilevit.modeling_mobilevit import MobileViTLayer

from uncal.errors import ConfigurationError
from uncal.models.correlation import EdgeCorrelation
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
        """Features from fine to coarse.

        Args:
            x: (B, C, H, W); H and W best multiples of 32.

        Returns:
            Five maps (B, channels[i], H/s, W/s), s = 2, 4, 8, 16 and the output stride.
        """
        maps = []
        x = cast(Tensor, self.body.conv_stem(x))
        for stage in self.body.encoder.layer:
            x = cast(Tensor, stage(x))
            maps.append(x)
        return maps


class EdgeFront(nn.Module):
    """Three convolutions of all channels, fused with the read-out of their edge correlation.

    Args:
        in_channels: C of the input: the image's, inverse depth, intensity.
        image_channels: how many of them are the image's.
        radius: of the edge correlation, cells of 2 pixels.
        stem_channels: of the convolutions, each with stride 2.
        out_channels: of the fused map.
        image_edges: what the correlation takes for an edge of the image.
    """

    def __init__(
        self,
        in_channels: int,
        image_channels: int,
        radius: int,
        stem_channels: Sequence[int],
        out_channels: int,
        image_edges: str,
    ) -> None:
        super().__init__()
        self.correlation = EdgeCorrelation(image_channels, radius, image_edges)
        self.stem = nn.Sequential(
            *(
                convolution(before, after, stride=2)
                for before, after in zip((in_channels, *stem_channels), stem_channels, strict=False)
            )
        )
        n = self.correlation.out_channels
        self.read = nn.Sequential(nn.BatchNorm2d(n), *convolution(n, out_channels, size=1))
        self.fuse = convolution(stem_channels[-1] + out_channels, out_channels, size=1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) → (B, out_channels, H/8, W/8)."""
        correlation = self.read(self.correlation(x))
        return cast(Tensor, self.fuse(torch.cat([self.stem(x), correlation], 1)))


class CorrelationMobileViT(nn.Module):
    """A small MobileViT on convolutions of all channels fused with their edge correlation.

    Args:
        in_channels: C of the input: the image's, inverse depth, intensity.
        image_channels: how many of them are the image's.
        radius: of the edge correlation, cells of 2 pixels.
        stem_channels: of the three convolutions with stride 2 before the fusion.
        channels: of the fused map and of each MobileViT stage, all but the first stage halving.
        hidden_sizes: widths of the transformers in those stages.
        layers: transformer layers in each of those stages.
        expand_ratio: of the inverted residual block that opens each stage.
        dropout: rate in the transformer layers.
        image_edges: ``mean`` suits images, ``channels`` events; see
            :meth:`~uncal.models.correlation.EdgeCorrelation.edges`.
    """

    def __init__(
        self,
        in_channels: int,
        image_channels: int,
        radius: int,
        stem_channels: Sequence[int],
        channels: Sequence[int],
        hidden_sizes: Sequence[int],
        layers: Sequence[int],
        expand_ratio: float,
        dropout: float,
        image_edges: str = "mean",
    ) -> None:
        super().__init__()
        if not len(channels) - 1 == len(hidden_sizes) == len(layers) or len(stem_channels) != 3:
            raise ConfigurationError(
                f"model.backbone: {len(stem_channels)} stem_channels (expected 3), {len(channels)} "
                f"channels, {len(hidden_sizes)} hidden_sizes, {len(layers)} layers (expected one "
                "channel more than stages)"
            )
        if in_channels != image_channels + 2:
            raise ConfigurationError(
                f"model.inputs gives {in_channels} channels; the correlation backbone expects "
                f"{image_channels} of the camera, then inverse_depth and intensity. Choose another "
                "with model/backbone=mobilevit_xxs"
            )
        self.front = EdgeFront(
            in_channels, image_channels, radius, stem_channels, channels[0], image_edges
        )
        config = MobileViTConfig(hidden_dropout_prob=dropout, expand_ratio=float(expand_ratio))
        self.stages = nn.ModuleList(
            MobileViTLayer(
                config,
                channels[i],
                channels[i + 1],
                stride=1 if i == 0 else 2,
                hidden_size=hidden_sizes[i],
                num_stages=layers[i],
            )
            for i in range(len(layers))
        )
        use_fast_dropout(self.stages)
        self.channels: tuple[int, ...] = tuple(channels[1:])

    def forward(self, x: Tensor) -> list[Tensor]:
        """Features from fine to coarse.

        Args:
            x: (B, C, H, W); H and W multiples of 8, best of 32.

        Returns:
            Maps (B, channels[i+1], H/s, W/s), s = 8, 16 and so on.
        """
        features = self.front(x)
        maps = []
        for stage in self.stages:
            features = cast(Tensor, stage(features))
            maps.append(features)
        return maps


def convolution(
    in_channels: int, out_channels: int, stride: int = 1, size: int = 3
) -> nn.Sequential:
    """Convolution, BatchNorm, SiLU.

    Args:
        in_channels: of the input.
        out_channels: of the output.
        stride: of the convolution.
        size: of the kernel, odd.
    """
    return nn.Sequential(
        nn.Conv2d(in_channels, out_channels, size, stride, size // 2, bias=False),
        nn.BatchNorm2d(out_channels),
        nn.SiLU(),
    )
