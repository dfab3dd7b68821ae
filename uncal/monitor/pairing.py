"""How well the edges of a sweep lie on those of an image, and whether another pairing fits better.

Where messages are paired wrongly, or a clock is late, a sweep fits the image of another frame
better than its own. While the vehicle stands still all pairings fit alike, and nothing is said.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from uncal.data.network_input import NetworkInput
from uncal.edges.image import edge_maps
from uncal.models.edge_alignment import EdgeAlignment, score

CELL_PX = 2
"""Side of the cells of an image whose edges are compared, pixels."""

EDGES = 768
"""So many edges of a sweep; any first ones are a fair sample."""

REACH = 2
"""So many earlier frames are tried as partners."""

RECENT = 3
"""Frames of which most must fit another partner better."""


class Glimpse(NamedTuple):
    """What is compared of a frame.

    Attributes:
        strength: (1, 2, h, w) edge strength across columns and rows, of mean 0 and spread 1.
        edges: (1, M, columns) of the sweep, finite.
        weights: (1, M) how much each counts.
        K: (1, 3, 3) camera matrix in cells.
    """

    strength: Tensor
    edges: Tensor
    weights: Tensor
    K: Tensor


def glimpse(inputs: NetworkInput, alignment: EdgeAlignment) -> Glimpse:
    """What pairing needs of one frame.

    Args:
        inputs: of one frame.
        alignment: says what image gradients are taken of and how much edges count.
    """
    camera = inputs.x[:, : alignment.camera_channels]
    maps = F.avg_pool2d(edge_maps(camera, alignment.window, alignment.image_edges), CELL_PX)
    strength = (maps - maps.mean((2, 3), keepdim=True)) / maps.std().clamp(min=1e-6)
    K = inputs.K.clone()
    K[:, :2] /= CELL_PX
    K[:, :2, 2] += 0.5 / CELL_PX - 0.5
    edges = inputs.edges[:, :EDGES]
    weights = alignment.weigh(edges, inputs.T_init)
    return Glimpse(strength, edges.nan_to_num(), weights, K)


def fit(image: Glimpse, sweep: Glimpse, T: Tensor) -> Tensor:
    """Mean edge strength of an image where a sweep's edges lie, in its spreads; 0 by chance.

    Args:
        image: whose image.
        sweep: whose sweep.
        T: (P, 4, 4) extrinsics.

    Returns:
        (P,).
    """
    at = sweep.edges, sweep.weights, image.K, T[None]
    seen = score(torch.ones_like(image.strength), *at)
    return (score(image.strength, *at) / seen.clamp(min=1e-6))[0]


class PairingCheck:
    """Whether frames fit other partners than their own, frame by frame.

    Args:
        margin: by how much another one must fit better, in spreads of edge strength.

    Attributes:
        past: the last frames.
        better: of the last frames, by how much the best other pairing fits better.
    """

    def __init__(self, margin: float) -> None:
        self.margin = margin
        self.past: deque[Glimpse] = deque(maxlen=REACH)
        self.better: deque[float] = deque(maxlen=RECENT)

    def clear(self) -> None:
        """Forget all, as before the first frame of a drive."""
        self.past.clear()
        self.better.clear()

    def doubt(self, frame: Glimpse, T: Tensor) -> str | None:
        """What is wrong with the pairing; None if nothing is.

        Each pairing may choose the extrinsic that suits it best, so that a LiDAR that has moved is
        not taken for a wrong pairing.

        Args:
            frame: the next one.
            T: (P, 4, 4) extrinsics to be tried: that in use and the frame's own estimate.
        """
        if self.past:
            own = float(fit(frame, frame, T).max())
            others = [
                float(fit(image, sweep, T).max())
                for other in self.past
                for image, sweep in ((frame, other), (other, frame))
            ]
            self.better.append(max(others) - own)
        self.past.append(frame)
        late = [value for value in self.better if value > self.margin]
        if len(late) <= RECENT // 2:
            return None
        return (
            f"{len(late)} of the last {len(self.better)} frames fit the image or sweep of an "
            f"earlier frame better than their own (by up to {max(late):.1f} spreads): wrongly "
            "paired, or a clock is late"
        )
