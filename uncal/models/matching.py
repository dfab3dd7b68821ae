"""Compare what the camera sees with what the LiDAR sees, at every small displacement."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class _LocalCorrelation(torch.autograd.Function):
    """Shift by shift, in place: unfolding all shifts at once outruns the caches.

    Autograd would keep one padded copy per shift for the backward pass; this keeps two tensors.
    """

    @staticmethod
    def forward(ctx: Any, image: Tensor, lidar: Tensor, radius: int) -> Tensor:  # noqa: ANN401
        padded = F.pad(image, (0, 0, radius, radius, radius, radius))
        ctx.save_for_backward(padded, lidar)
        ctx.radius = radius
        height, width = lidar.shape[1:3]
        result = lidar.new_empty(*lidar.shape[:3], (2 * radius + 1) ** 2)
        for k, row, column in _shifts(radius):
            shifted = padded[:, row : row + height, column : column + width]
            result[..., k] = (shifted * lidar).sum(-1)
        return result

    @staticmethod
    def backward(  # type: ignore[override]
        ctx: Any,  # noqa: ANN401
        grad: Tensor,
    ) -> tuple[Tensor, Tensor, None]:
        padded, lidar = ctx.saved_tensors
        height, width = lidar.shape[1:3]
        grad_padded, grad_lidar = torch.zeros_like(padded), torch.zeros_like(lidar)
        for k, row, column in _shifts(ctx.radius):
            part = grad[..., k : k + 1].expand_as(lidar)
            window = (slice(None), slice(row, row + height), slice(column, column + width))
            grad_padded[window].addcmul_(part, lidar)
            grad_lidar.addcmul_(part, padded[window])
        r = ctx.radius
        return grad_padded[:, r : r + height, r : r + width], grad_lidar, None


def _shifts(radius: int) -> Iterator[tuple[int, int, int]]:
    side = 2 * radius + 1
    for k in range(side * side):
        yield k, k // side, k % side


def local_correlation(image: Tensor, lidar: Tensor, radius: int) -> Tensor:
    """Inner products of each LiDAR descriptor with the image descriptors around it.

    Args:
        image: (B, h, w, C) descriptors of the image.
        lidar: (B, h, w, C) descriptors of the LiDAR maps.
        radius: largest shift, cells.

    Returns:
        (B, h, w, (2·radius+1)²); shifts in row-major order, the middle one is no shift. Beyond the
        border the image's descriptor is zero.

    >>> a = torch.tensor([1.0, 2.0, 3.0]).reshape(1, 1, 3, 1)
    >>> local_correlation(a, torch.ones_like(a), 1)[0, 0, :, 3:6].tolist()
    [[0.0, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 3.0, 0.0]]
    """
    return cast(Tensor, _LocalCorrelation.apply(image, lidar, radius))


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


class MatchingStem(nn.Module):
    """Two short branches, one per sensor, fused at stride 4 together with their local correlation.

    A convolution adds its inputs, and displacement is found by multiplying them: the correlation of
    learned descriptors hands the network what it would otherwise have to approximate, and cuts the
    samples it needs several times over.

    Args:
        image_channels: the first channels of the input are the image's.
        lidar_channels: the others are the LiDAR's.
        width: channels of each branch.
        descriptor: length of the descriptors that are correlated.
        radius: of the search, in cells of stride 4; must reach the largest displacement.
        out_channels: of the fused map.
    """

    def __init__(
        self,
        image_channels: int,
        lidar_channels: int,
        width: int,
        descriptor: int,
        radius: int,
        out_channels: int,
    ) -> None:
        super().__init__()
        self.image_channels = image_channels
        self.radius = radius
        self.image = nn.Sequential(
            convolution(image_channels, width // 2, 2), convolution(width // 2, width, 2)
        )
        self.lidar = nn.Sequential(
            convolution(lidar_channels, width // 2, 2), convolution(width // 2, width, 2)
        )
        self.describe_image = nn.Conv2d(width, descriptor, 1)
        self.describe_lidar = nn.Conv2d(width, descriptor, 1)
        self.fuse = convolution(2 * width + (2 * radius + 1) ** 2, out_channels, size=1)

    def forward(self, x: Tensor) -> Tensor:
        """Encode, correlate, fuse.

        Args:
            x: (B, C, H, W) image channels first.

        Returns:
            (B, out_channels, H/4, W/4).
        """
        image = self.image(x[:, : self.image_channels])
        lidar = self.lidar(x[:, self.image_channels :])
        with torch.autocast(x.device.type, enabled=False):
            correlation = local_correlation(
                _unit(self.describe_image(image.float())),
                _unit(self.describe_lidar(lidar.float())),
                self.radius,
            ).permute(0, 3, 1, 2)
        return cast(Tensor, self.fuse(torch.cat([image, lidar, correlation.to(image.dtype)], 1)))


def _unit(descriptors: Tensor) -> Tensor:
    """(B, C, h, w) → (B, h, w, C) of length one."""
    return F.normalize(descriptors.permute(0, 2, 3, 1), dim=-1).contiguous()
