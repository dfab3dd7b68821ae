"""How well the edges of sweeps lie on those of images, under any extrinsic, camera matrix or lens.

A right extrinsic is a sharp peak: turned by a degree or more, the edges of the sweep leave those of
the image. What a hypothesis is worth is therefore how far it stands above itself turned, in
standard deviations; a wrong one is as good as its neighbours, wherever in the image it looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uncal.checking.axes import to_lidar_axes
from uncal.edges.evidence import NEAREST_M
from uncal.edges.image import blurred, edge_maps
from uncal.edges.selection import select_edges
from uncal.edges.sweep import KIND, N_ACROSS, STRENGTH, find_edges
from uncal.events.representations import Histogram
from uncal.events.stream import PixelMap
from uncal.recordings.frame import Frame

WIDEST_PX = 640
"""Images are compared at no more than this width."""

MOST_EDGES = 2000
"""Edges of a sweep that are compared."""

KIND_WEIGHTS = (1.0, 0.5, 0.25, 1.0, 0.35, 0.25)
"""Of :data:`uncal.edges.sweep.KINDS`, as in ``model=edges``."""

BLUR = 0.004
"""Standard deviation of the blur of the image's edges, by its width: what a pose may be off."""

RING_DEG = (2.0, 3.5, 5.0)
"""How far a hypothesis is turned to be compared with itself."""

FEWEST_SEEN = 40
"""Fewer edges in the image say nothing."""

_WINDOW_PX = 15
_AROUND = 12


class View(NamedTuple):
    """One frame, ready to be compared.

    Attributes:
        edges: (m, 3) float32 positions in the frame of the file, metres.
        along: (m,) int64 1 where an edge is sharp across rows, 0 where it is across columns.
        weights: (m,) float32.
        strength: (2, H, W) float32 edge strength across columns and across rows, less its mean.
        K: (3, 3) float32 camera matrix at this size, pixels.
        T: (4, 4) float32 extrinsic as declared.
        link: (4, 4) float32 LiDAR → what the calibration file leads it to: the camera, or another
            one from which it is known how to go on.
        up: (3,) float32 the sweep's axis of rotation, in the frame of the file.
    """

    edges: Tensor
    along: Tensor
    weights: Tensor
    strength: Tensor
    K: Tensor
    T: Tensor
    link: Tensor
    up: Tensor

    def fewer(self, share: int) -> View:
        """The same with every ``share``-th edge."""
        return self._replace(
            edges=self.edges[::share], along=self.along[::share], weights=self.weights[::share]
        )


def view_of(frame: Frame, link: NDArray[np.float64] | None = None) -> View:
    """Find the edges of a frame's sweep and of its image or events.

    Args:
        frame: of any reader; the axes of its points may be any, but metres.
        link: see :class:`View`; None: the extrinsic itself.
    """
    camera, scale = _camera(frame)
    K = frame.K.copy()
    # Pixel centres are at whole numbers.
    K[:2, 2] = (K[:2, 2] + 0.5) * scale - 0.5
    K[0, 0], K[1, 1] = K[0, 0] * scale, K[1, 1] * scale
    width = camera.shape[-1]
    # Not by the declared focal length, which may be what is wrong.
    sigma = torch.tensor([BLUR * width])
    kind = "channels" if frame.image is None else "mean"
    strength = blurred(edge_maps(camera, _WINDOW_PX, kind), sigma)[0]
    strength = strength - strength.mean((1, 2), keepdim=True)
    axes = to_lidar_axes(frame.points)
    turned = frame.points.copy()
    turned[:, :3] = frame.points[:, :3] @ axes.T
    found = select_edges(find_edges(turned), MOST_EDGES, seed=0)
    edges = torch.from_numpy(found)
    weights = torch.tensor(KIND_WEIGHTS)[edges[:, KIND].long()]
    return View(
        edges[:, :3] @ torch.from_numpy(axes),
        (edges[:, KIND] >= N_ACROSS).long(),
        weights * edges[:, STRENGTH].clamp(0.02, 1.0).sqrt(),
        strength,
        torch.from_numpy(K).float(),
        torch.from_numpy(frame.T_cam_lidar).float(),
        torch.from_numpy(frame.T_cam_lidar if link is None else link).float(),
        torch.from_numpy(axes[2].copy()),
    )


def agreement(view: View, T: Tensor, K: Tensor | None = None, k1: float = 0.0) -> Tensor:
    """Mean edge strength under the projected edges, less the image's mean.

    Args:
        view: the frame.
        T: (P, 4, 4) extrinsics; reflections too.
        K: (3, 3) camera matrix; None: the frame's.
        k1: radial distortion of the lens, x (1 + k1 r²); 0: none is left in the image.

    Returns:
        (P,); NaN where fewer than :data:`FEWEST_SEEN` edges are in the image.
    """
    K = view.K if K is None else K
    height, width = view.strength.shape[1:]
    q = view.edges @ T[:, :3, :3].transpose(1, 2) + T[:, None, :3, 3]
    ahead = q[..., 2] > NEAREST_M
    x, y = (q[..., :2] / q[..., 2:].clamp(min=NEAREST_M)).unbind(-1)
    if k1:
        squared = x * x + y * y
        # Beyond the turning point of the polynomial no ray comes back into the image.
        ahead &= 1.0 + 3.0 * k1 * squared > 0.0
        x, y = (coordinate * (1.0 + k1 * squared) for coordinate in (x, y))
    column = torch.round(x * K[0, 0] + K[0, 2])
    row = torch.round(y * K[1, 1] + K[1, 2])
    seen = ahead & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    index = torch.where(seen, (view.along * height + row) * width + column, 0.0).long()
    weight = view.weights * seen
    total = (view.strength.reshape(-1)[index] * weight).sum(-1) / weight.sum(-1).clamp(min=1e-6)
    return torch.where(seen.sum(-1) >= FEWEST_SEEN, total, torch.nan)


def ring() -> Tensor:
    """(R, 4, 4) rotations of the camera by :data:`RING_DEG`, all around."""
    turns = []
    for degrees in RING_DEG:
        for angle in 2 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND:
            axis = np.array([np.cos(angle), np.sin(angle), 0.0])
            turn = np.eye(4)
            turn[:3, :3] = cv2.Rodrigues(axis * np.radians(degrees))[0]
            turns.append(turn)
    return torch.from_numpy(np.stack(turns)).float()


def peak_height(
    views: Sequence[View], T: Tensor, K: Tensor | None = None, k1: float = 0.0
) -> float:
    """Standard deviations of a hypothesis above itself turned; NaN where few edges are seen."""
    turned = torch.cat([T[None], ring() @ T])
    table = torch.stack([agreement(view, turned, K, k1) for view in views]).numpy()
    table = table[np.isfinite(table[:, 0]) & (np.isfinite(table[:, 1:]).mean(1) > 0.5)]
    if not len(table):
        return float("nan")
    table = table - np.nanmean(table[:, 1:], 1, keepdims=True)
    total = np.where(np.isfinite(table), table, 0.0).mean(0)
    return float(total[0] / max(float(total[1:].std()), 1e-6))


def _camera(frame: Frame) -> tuple[Tensor, float]:
    """(1, C, H, W) at the size of comparison, and its scale."""
    if frame.image is None:
        assert frame.events is not None
        size = frame.events.size
        return Histogram(normalize=True)(frame.events, size, PixelMap.identity())[None], 1.0
    scale = min(1.0, WIDEST_PX / frame.image.shape[1])
    image = frame.image
    if scale < 1:
        image = np.asarray(
            cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        )
    return torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255.0, scale
