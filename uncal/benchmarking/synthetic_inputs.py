"""Inputs made up for measuring time: of the right shapes, and nothing else."""

from __future__ import annotations

import torch

from uncal.data.network_input import NetworkInput
from uncal.edges.sweep import COLUMNS, KIND, KINDS, SIDE
from uncal.recordings.frame import FrameId


def synthetic_inputs(
    size: tuple[int, ...], batch: int, edges: int, device: torch.device
) -> NetworkInput:
    """Noise, a tenth of the pixels with a LiDAR point, and edges ahead of the camera.

    Args:
        size: (H, W).
        batch: B, each frame a unit of its own.
        edges: M, of a sweep.
        device: where to.

    Returns:
        Input of five channels with (B, M, columns) edges.
    """
    generator = torch.Generator().manual_seed(0)
    height, width = size
    depth = torch.rand(batch, 1, height, width, generator=generator)
    inverse_depth = torch.where(depth < 0.1, depth, 0.0)
    image = torch.randn(batch, 3, height, width, generator=generator)
    x = torch.cat([image, inverse_depth, inverse_depth], 1)
    x = x.contiguous(memory_format=torch.channels_last)
    K = torch.tensor([[230.0, 0.0, width / 2], [0.0, 230.0, height / 2], [0.0, 0.0, 1.0]])
    T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    sweep = torch.rand(batch, edges, len(COLUMNS), generator=generator)
    # Within 20° to either side and 10° up or down, 5 to 40 m away.
    away = 5.0 + 35.0 * sweep[..., :1]
    aside = (2.0 * sweep[..., 1:3] - 1.0) * sweep.new_tensor([0.36, 0.18])
    sweep[..., :3] = away * torch.cat([torch.ones_like(away), aside], -1)
    sweep[..., KIND] = (len(KINDS) * sweep[..., KIND]).floor()
    sweep[..., SIDE] = sweep[..., SIDE].round() * 2 - 1
    indices = torch.arange(batch, device=device)
    return NetworkInput(
        x=x.to(device),
        inverse_depth=inverse_depth.to(device),
        K=K.repeat(batch, 1, 1).to(device),
        T_init=T.repeat(batch, 1, 1).to(device),
        target=torch.zeros(batch, 6, device=device),
        unit_index=indices,
        frames=[FrameId("made", "up", number) for number in range(batch)],
        unit=indices,
        edges=sweep.to(device),
    )
