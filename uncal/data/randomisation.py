"""Domain randomisation: training batches less like the simulator, so that weights learn less of it.

Simulated edges are too good. In a real image shadows, markings and foliage have edges that no LiDAR
sees, exposure differs from camera to camera, and a real sweep has edges that no camera sees: lasers
of unlike gain, noise of reflectance, mixed returns. What follows makes some of both.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from uncal.edges.image import blurred
from uncal.edges.sweep import CONTRAST, KIND, KINDS, N_ACROSS, REFLECTANCE, STRENGTH

SHADOWS = 3
"""Half-planes of other brightness laid over an image."""

PATCHES = 10
"""Rectangles of another image of the batch pasted into an image."""

PATCH_SIDES = (0.04, 0.25)
"""Smallest and largest side of a patch, as a share of the image's height."""

ASTRAY = math.radians(3.0)
"""How far a false edge lies from where it was found, at most, in azimuth and in elevation."""


def randomise_appearance(image: Tensor, strength: float) -> Tensor:
    """Vary tone, colour, sharpness, noise, shadows and clutter of images.

    Args:
        image: (B, 3, H, W) in 0..255.
        strength: 0 changes nothing; 1 changes as much as cameras, weather and streets do.

    Returns:
        The same shape, in 0..255.
    """
    n, device = len(image), image.device
    image = _patched(image, strength)
    image = _shaded(image, strength)
    grey = image.mean(1, keepdim=True)
    image = grey + (image - grey) * (1.0 + strength * _symmetric(n, device))
    gamma = (0.7 * strength * _symmetric(n, device)).exp()
    image = 255.0 * (image.clamp(0.0, 255.0) / 255.0) ** gamma
    image = blurred(image, 0.05 + strength * torch.rand(n, device=device))
    deviation = 8.0 * strength * torch.rand(n, 1, 1, 1, device=device)
    return (image + deviation * torch.randn_like(image)).clamp(0.0, 255.0)


def randomise_edges(edges: Tensor, false: float) -> Tensor:
    """Lead edges of sweeps astray, vary reflectance, and leave out whole kinds of edges.

    Of every kind, and in every frame, another share of the edges is displaced: between none and
    ``false`` of the depth edges and outlines, twice that of the intensity edges.

    Args:
        edges: (B, M, columns) as :data:`uncal.edges.sweep.COLUMNS`; rows of NaN pad.
        false: largest share of false edges, 0..0.5; one frame in so many lacks a kind, too.

    Returns:
        The same shape.
    """
    n, device = len(edges), edges.device
    kind = edges[..., KIND].nan_to_num().long()
    share = false * torch.rand(n, len(KINDS), device=device)
    share[:, N_ACROSS - 1 :: N_ACROSS] *= 2.0
    astray = torch.rand(kind.shape, device=device) < share.gather(1, kind)
    angles = ASTRAY * (2.0 * torch.rand(*kind.shape, 2, device=device) - 1.0)
    edges = edges.clone()
    edges[..., :3] = torch.where(astray[..., None], _turned(edges, angles), edges[..., :3])

    gain = (0.7 * _symmetric(n, device)[..., 0, 0]).exp()
    intensity = kind % N_ACROSS == N_ACROSS - 1
    edges[..., REFLECTANCE] = (edges[..., REFLECTANCE] * gain).clamp(0.0, 1.0)
    edges[..., CONTRAST] = (edges[..., CONTRAST] * gain).clamp(-1.0, 1.0)
    strength = torch.where(intensity, edges[..., STRENGTH] * gain, edges[..., STRENGTH])
    edges[..., STRENGTH] = strength.clamp(max=1.0)

    lacking = torch.rand(n, len(KINDS), device=device) < false / 3.0
    edges[lacking.gather(1, kind)] = float("nan")
    return edges


def _symmetric(n: int, device: torch.device) -> Tensor:
    """(n, 1, 1, 1) uniform over -1..1."""
    return 2.0 * torch.rand(n, 1, 1, 1, device=device) - 1.0


def _turned(edges: Tensor, angles: Tensor) -> Tensor:
    """(B, M, 3) positions after other (B, M, 2) azimuth and elevation, at the same range."""
    x, y, z = edges[..., :3].unbind(-1)
    flat = torch.hypot(x, y)
    distance = torch.hypot(flat, z)
    azimuth = torch.atan2(y, x) + angles[..., 0]
    elevation = torch.atan2(z, flat) + angles[..., 1]
    flat = distance * elevation.cos()
    return torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), distance * elevation.sin()], -1)


def _patched(image: Tensor, strength: float) -> Tensor:
    n, _, height, width = image.shape
    device = image.device
    low, high = (share * height for share in PATCH_SIDES)
    sides = low + (high - low) * torch.rand(n, PATCHES, 2, device=device) ** 2
    corner = torch.rand(n, PATCHES, 2, device=device) * sides.new_tensor([height, width])
    there = torch.rand(n, PATCHES, device=device) < 0.5 * strength
    end = torch.where(there[..., None], corner + sides, corner)
    rows = torch.arange(height, device=device)[:, None]
    columns = torch.arange(width, device=device)[:, None]
    # Outer products of what rows and columns are in each patch, added up over the patches.
    in_rows = ((rows >= corner[:, None, :, 0]) & (rows < end[:, None, :, 0])).float()
    in_columns = ((columns >= corner[:, None, :, 1]) & (columns < end[:, None, :, 1])).float()
    covered = in_rows @ in_columns.transpose(1, 2) > 0
    return torch.where(covered[:, None], image.roll(1, 0), image)


def _shaded(image: Tensor, strength: float) -> Tensor:
    n, _, height, width = image.shape
    device = image.device
    rows = torch.linspace(-1.0, 1.0, height, device=device)[:, None]
    columns = torch.linspace(-1.0, 1.0, width, device=device)
    factor = image.new_ones(n, height, width)
    for _ in range(SHADOWS):
        angle = (math.pi * _symmetric(n, device))[:, 0]
        offset = _symmetric(n, device)[:, 0]
        dark = (rows * angle.sin() + columns * angle.cos()) > offset
        depth = 0.6 * strength * torch.rand(n, 1, 1, device=device)
        factor = torch.where(dark, factor * (1.0 - depth), factor)
    return image * factor[:, None]
