"""How strongly each pixel of a camera's image looks like an edge."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

IMAGE_EDGES: tuple[str, ...] = ("mean", "channels")
"""Gradients of what: of the channels' mean (an image), or of each channel (events)."""

STRONGEST = 3.0
"""An edge counts at most this many times what is usual around it."""

_FAINT = 0.09
"""Added to what is usual, in units of the input, lest noise in a plain area be an edge."""


def edge_maps(camera: Tensor, window: int, image_edges: str = "mean") -> Tensor:
    """Edge strength across columns and across rows, relative to what is usual nearby.

    Args:
        camera: (B, C, H, W) the camera's channels as a network reads them.
        window: half the side of the area that counts as nearby, pixels.
        image_edges: one of :data:`IMAGE_EDGES`. Events of other sign or time would cancel in the
            mean of the channels.

    Returns:
        (B, 2, H, W) from 0 to :data:`STRONGEST`.

    >>> step = torch.zeros(1, 3, 8, 8)
    >>> step[..., 4:] = 1.0
    >>> across, along = edge_maps(step, window=3)[0, :, 4]
    >>> across.argmax().item() in (3, 4), along.max().item()
    (True, 0.0)
    """
    if image_edges == "mean":
        camera = camera.mean(1, keepdim=True)
    x = F.pad(camera, (1, 1, 1, 1), mode="replicate")
    smooth_rows = x[..., :-2, :] + 2 * x[..., 1:-1, :] + x[..., 2:, :]
    smooth_columns = x[..., :-2] + 2 * x[..., 1:-1] + x[..., 2:]
    across = (smooth_rows[..., 2:] - smooth_rows[..., :-2]).abs() / 4
    along = (smooth_columns[..., 2:, :] - smooth_columns[..., :-2, :]).abs() / 4
    if image_edges == "channels":
        across, along = (g.square().mean(1, keepdim=True).sqrt() for g in (across, along))
    usual = box_mean(across + along, window) + _FAINT
    return torch.cat([across / usual, along / usual], 1).clamp(max=STRONGEST)


def box_mean(x: Tensor, half: int) -> Tensor:
    """Mean over squares of about 2·half + 1 pixels; the border repeats.

    Args:
        x: (B, C, H, W).
        half: half the side.
    """
    # A wide mean is smooth: a quarter of the pixels will do, one direction after the other.
    step = min(4, max(1, half // 3))
    small = F.avg_pool2d(x, step, ceil_mode=True)
    reach = max(1, round(half / step))
    side = 2 * reach + 1
    padded = F.pad(small, (reach, reach, reach, reach), mode="replicate")
    mean = F.avg_pool2d(F.avg_pool2d(padded, (1, side), 1), (side, 1), 1)
    return F.interpolate(mean, x.shape[-2:], mode="bilinear", align_corners=False)


def gaussian_kernels(sigma: Tensor, reach: int | None = None) -> Tensor:
    """Normalised Gaussians, each cut off at its own three σ, whatever its neighbours are.

    Args:
        sigma: (B,) pixels.
        reach: offsets on each side, at least 3 σ; None: no more than the widest needs.

    Returns:
        (B, R), R odd.

    >>> gaussian_kernels(torch.tensor([0.1, 1.0])).shape
    torch.Size([2, 7])
    """
    if reach is None:
        reach = math.ceil(3.0 * float(sigma.max()))
    offsets = torch.arange(-reach, reach + 1, device=sigma.device, dtype=sigma.dtype)
    kernels = torch.exp(-0.5 * (offsets / sigma[:, None]).square())
    kernels = kernels * (offsets.abs() <= (3.0 * sigma).ceil()[:, None])
    return kernels / kernels.sum(1, keepdim=True)


def blurred(maps: Tensor, sigma: Tensor, reach: int | None = None) -> Tensor:
    """Gaussian blur, of another width for each image; the border repeats.

    Args:
        maps: (B, C, H, W).
        sigma: (B,) pixels.
        reach: as in :func:`gaussian_kernels`.

    >>> bool((blurred(torch.ones(1, 2, 8, 8), torch.tensor([1.0])) - 1).abs().max() < 1e-5)
    True
    """
    batch, channels, height, width = maps.shape
    kernels = gaussian_kernels(sigma, reach).repeat_interleave(channels, 0)
    reach = kernels.shape[1] // 2
    x = maps.reshape(1, batch * channels, height, width)
    x = F.pad(x, (reach, reach, 0, 0), mode="replicate")
    x = F.conv2d(x, kernels[:, None, None, :], groups=len(kernels))
    x = F.pad(x, (0, 0, reach, reach), mode="replicate")
    x = F.conv2d(x, kernels[:, None, :, None], groups=len(kernels))
    return x.view_as(maps)
