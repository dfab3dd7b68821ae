"""The extrinsic whose sweep edges lie best on image edges, from a guess degrees and decimetres off.

Nothing is learnt here. A search looks at the whole range, coarse blur first; a refinement climbs
from one extrinsic to the nearest maximum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize  # type: ignore[import-untyped]
from torch import Tensor

from uncal.data.network_input import NetworkInput
from uncal.edges.image import blurred
from uncal.geometry.decalibration import correct
from uncal.models.edge_alignment import EdgeAlignment, score
from uncal.models.pose_search import LogLikelihood, SearchSettings, search

Matrix = NDArray[np.float64]

KINDS: tuple[float, ...] = (1.0, 0.5, 0.25, 1.0, 0.35, 0.25)
"""Weights of the kinds of edges, as in ``model=edges``."""

SHARPNESS = 0.3
"""Log-likelihood by score, as in ``model=edges``."""

WIDE_BLUR_DEG: tuple[float, ...] = (2.0, 1.2, 0.75, 0.45)
"""Of the search, coarse to fine."""

ALL_BLUR_DEG: tuple[float, ...] = (2.0, 1.0, 0.4, 0.2, 0.12)
"""Of a refinement that begins at a guess."""

FINE_BLUR_DEG: tuple[float, ...] = (0.4, 0.2, 0.12)
"""Of the refinement of what a search has found."""

ROUNDS = 4
"""Of the search at each blur."""

STEP = np.array([0.1] * 3 + [0.01] * 3)
"""Units that the refinement counts in, metres and radians: of like effect on the image."""


class EdgeField:
    """Frames of one rig, ready to score extrinsics.

    Args:
        batch: B frames of one unit, with edges.
        window: half the side of the area that image edges are normalised in, pixels.
        camera_channels: of the network's input.
        image_edges: what image gradients are taken of.
    """

    def __init__(
        self, batch: NetworkInput, window: int, camera_channels: int, image_edges: str
    ) -> None:
        one = (1.0,)
        network = EdgeAlignment(
            batch.x.shape[1], camera_channels, image_edges, window, KINDS, one, (1,), one
        )
        with torch.no_grad():
            self.maps = network.maps(batch.x.float())
            self.weights = network.weigh(batch.edges, batch.T_init)
        self.edges = batch.edges.nan_to_num()
        self.K = batch.K

    def fewer(self, edges: int) -> EdgeField:
        """The same with fewer edges a frame, of which any first part is a fair sample."""
        smaller = copy(self)
        smaller.edges, smaller.weights = self.edges[:, :edges], self.weights[:, :edges]
        return smaller

    def strength(self, blur_deg: float) -> Tensor:
        """(B, 2, H, W) edge strength above the image's mean, blurred by degrees at its centre."""
        sigma = float(np.radians(blur_deg)) * self.K[:, 0, 0]
        strength = blurred(self.maps, sigma)
        return SHARPNESS * (strength - strength.mean((2, 3), keepdim=True))

    def total(self, strength: Tensor, T: Tensor) -> Tensor:
        """(P,) sum of all frames' scores of (P, 4, 4) extrinsics, on what :meth:`strength` gave."""
        of_frames = [  # one by one, since all poses of all frames would fill the memory
            score(s[None], e[None], w[None], k[None], T[None])[0]
            for s, e, w, k in zip(strength, self.edges, self.weights, self.K, strict=True)
        ]
        return torch.stack(of_frames).sum(0)


def search_wide(
    field: EdgeField,
    T_guess: Matrix,  # (4, 4) LiDAR to camera
    bounds: Matrix,  # (6,) how far the guess may be off, metres and radians
    settings: SearchSettings,  # of each search
    starts: int,  # searches with other quasi-random poses
) -> Matrix:
    """The best of several searches over the whole range.

    Returns:
        (4, 4).
    """
    guess, scale = torch.from_numpy(T_guess).float(), torch.from_numpy(bounds).float()
    fields = [field.strength(blur) for blur in WIDE_BLUR_DEG]

    def likelihood(strength: Tensor) -> LogLikelihood:
        return lambda pose: field.total(strength, correct(guess, pose[0] * scale))[None]

    rounds = [f for strength in fields for f in [likelihood(strength)] * ROUNDS]
    found = []
    with torch.no_grad():
        for start in range(starts):
            other = replace(settings, seed=settings.seed + 1000 * start)
            found.append(correct(guess, search(rounds, 1, other).pose[0] * scale))
        best = field.total(fields[-1], torch.stack(found)).argmax()
    return found[int(best)].double().numpy()


def refine(field: EdgeField, T_start: Matrix, blur_deg: Sequence[float] = FINE_BLUR_DEG) -> Matrix:
    """Climb from (4, 4) to the nearest maximum, coarse blur first (L-BFGS, exact gradient)."""
    T = torch.from_numpy(T_start)
    for blur in blur_deg:
        value = _objective(field, field.strength(blur), T)
        step = minimize(
            value, np.zeros(6), jac=True, method="L-BFGS-B", options={"maxiter": 40, "ftol": 1e-7}
        )
        T = correct(T, torch.from_numpy(step.x * STEP))
    return T.numpy()


def _objective(
    field: EdgeField, strength: Tensor, T: Tensor
) -> Callable[[Matrix], tuple[float, Matrix]]:
    def value(x: Matrix) -> tuple[float, Matrix]:
        at = torch.from_numpy(x).requires_grad_()
        moved = correct(T, at * torch.from_numpy(STEP)).float()
        # Per edge, so that the optimiser's tolerances suit any number of frames.
        lost = -field.total(strength, moved[None])[0] / field.weights.sum()
        (gradient,) = torch.autograd.grad(lost, at)
        return float(lost.detach()), gradient.numpy()

    return value
