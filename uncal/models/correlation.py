"""Where edges of the camera and the LiDAR agree, for every small displacement: a fixed front end.

Convolutions add their inputs, but a displacement is found by multiplying them. Handing the network
the local correlation of edges, which needs no learning, spares it from learning to multiply.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from uncal.errors import ConfigurationError

PAIRS = 5
"""Edge pairs that are correlated; see :meth:`EdgeCorrelation.edges`."""

CONTRAST_WINDOW = 15
"""Side of the window over which edge strength is normalised, cells."""

IMAGE_EDGES: tuple[str, ...] = ("mean", "density", "channels")
"""What the image's edges are the gradients of; see :meth:`EdgeCorrelation.edges`."""

STRONGEST_EDGE = 4.0
"""Edges count at most this many times the strength that is usual around them."""


class EdgeCorrelation(nn.Module):
    """Normalised local correlation of image and LiDAR edges; no parameters, no gradient.

    Works on the image reduced by 2. Output cells are 8 pixels apart, each looks at 16 × 16 pixels.

    Args:
        image_channels: the first channels of the input are the image's; then come inverse depth
            and intensity.
        radius: largest shift, in cells of 2 pixels; must reach the usual displacements.
        image_edges: one of :data:`IMAGE_EDGES`.
    """

    STRIDE = 8

    def __init__(self, image_channels: int, radius: int, image_edges: str = "mean") -> None:
        super().__init__()
        if image_channels < 1 or radius < 1:
            raise ConfigurationError(
                f"model.backbone: image_channels={image_channels}, radius={radius}: "
                "both must be at least 1"
            )
        if image_edges not in IMAGE_EDGES:
            raise ConfigurationError(
                f"model.image_edges={image_edges}: expected {' or '.join(IMAGE_EDGES)}"
            )
        self.image_channels = image_channels
        self.radius = radius
        self.image_edges = image_edges

    @property
    def out_channels(self) -> int:
        """Edge pairs times shifts."""
        return PAIRS * (2 * self.radius + 1) ** 2

    def edges(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Edge maps of both sensors, pair by pair, on cells of 2 pixels.

        The pairs: image edges across columns with depth jumps across columns; the same across
        rows; image edges across columns with the outline of what returns nothing (the sky);
        image edges with intensity gradients across columns, and across rows.

        The image's edges are the gradients of its channels' ``mean`` (right for RGB), of the mean
        of their magnitudes (``density``: where events are, whatever their sign and time), or the
        root mean square of each of its ``channels``' own (events of another sign or time do not
        cancel).

        Args:
            x: (B, C, H, W) network input.

        Returns:
            Image edges and LiDAR edges, each (B, PAIRS, H/2, W/2).
        """
        n = self.image_channels
        x = x.float()
        across, along = _gradients(F.avg_pool2d(self._shown(x[:, :n]), 2))
        if self.image_edges == "channels":
            across, along = (g.square().mean(1, keepdim=True).sqrt() for g in (across, along))
        usual = _usual(across + along)
        across, along = across / usual, along / usual

        inverse_depth = F.max_pool2d(x[:, n : n + 1], 2)
        seen = inverse_depth > 0
        # A single empty cell is a gap between two rings, not the sky.
        inverse_depth = torch.where(seen, inverse_depth, F.max_pool2d(inverse_depth, 3, 1, 1))
        intensity = F.max_pool2d(x[:, n + 1 : n + 2], 2)
        intensity = torch.where(seen, intensity, F.max_pool2d(intensity, 3, 1, 1))

        left, right, up, down = _neighbours(inverse_depth)
        both_across, both_along = (left > 0) & (right > 0), (up > 0) & (down > 0)
        jump_across = (right - left).abs() / (right + left + 1e-6) * both_across
        jump_along = (down - up).abs() / (down + up + 1e-6) * both_along
        outline = ((left > 0) ^ (right > 0)).float()
        bright_across, bright_along = _gradients(intensity)
        bright_across, bright_along = bright_across * both_across, bright_along * both_along
        usual = _usual(bright_across + bright_along)

        image = torch.cat([across, along, across, across, along], 1)
        lidar = torch.cat(
            [jump_across, jump_along, outline, bright_across / usual, bright_along / usual], 1
        )
        return image.clamp(max=STRONGEST_EDGE), lidar.clamp(max=STRONGEST_EDGE)

    def _shown(self, image: Tensor) -> Tensor:
        """(B, 1 or n, H, W) what the gradients are taken of."""
        if self.image_edges == "channels":
            return image
        return (image.abs() if self.image_edges == "density" else image).mean(1, keepdim=True)

    @torch.no_grad()
    def forward(self, x: Tensor) -> Tensor:
        """Correlate.

        Args:
            x: (B, C, H, W) network input; H and W multiples of 8.

        Returns:
            (B, PAIRS·(2·radius+1)², H/8, W/8), for each pair minus the mean over its shifts; shifts
            in row-major order. A peak at shift d says that what the LiDAR sees here lies d cells
            further in the image.
        """
        image, lidar = self.edges(x)
        height, width = lidar.shape[-2:]
        padded = F.pad(image, (self.radius,) * 4)
        energy = (_windows(lidar * lidar) * _windows(image * image)).sqrt() + 1e-2
        side = 2 * self.radius + 1
        volume = torch.stack(
            [
                _windows(padded[:, :, row : row + height, column : column + width] * lidar)
                for row in range(side)
                for column in range(side)
            ],
            2,
        )
        volume /= energy[:, :, None]
        volume -= volume.mean(2, keepdim=True)
        return volume.flatten(1, 2).contiguous(memory_format=torch.channels_last)


def _neighbours(x: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Left, right, upper and lower neighbour of every cell; the border repeats."""
    x = F.pad(x, (1, 1, 1, 1), mode="replicate")
    return x[..., 1:-1, :-2], x[..., 1:-1, 2:], x[..., :-2, 1:-1], x[..., 2:, 1:-1]


def _gradients(x: Tensor) -> tuple[Tensor, Tensor]:
    """Absolute differences across columns and across rows."""
    left, right, up, down = _neighbours(x)
    return (right - left).abs(), (down - up).abs()


def _usual(strength: Tensor) -> Tensor:
    """Mean edge strength around every cell, away from zero."""
    half = CONTRAST_WINDOW // 2
    return F.avg_pool2d(strength, CONTRAST_WINDOW, 1, half, count_include_pad=False) + 0.02


def _windows(x: Tensor) -> Tensor:
    """Means over windows of 8 cells, 4 cells apart."""
    return F.avg_pool2d(x, 8, 4, 2, count_include_pad=False)
