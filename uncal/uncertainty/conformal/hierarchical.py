"""Conformal calibration for a frame of a new drive or rig, none of which the fit has seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import ClassVar, Literal

import numpy as np
import torch
from torch import Tensor

from uncal.errors import ConfigurationError
from uncal.uncertainty.conformal.groups import GroupedCalibrator
from uncal.uncertainty.conformal.quantile import samples_needed, warn_too_few


class HierarchicalCalibrator(GroupedCalibrator):
    """Intervals that hold a frame of a *new* group with probability at least 1-α.

    Frames of one group (drive, rig) are alike, so that a new group's frame is not exchangeable with
    those of the fit; but whole groups are exchangeable with one another, and frames within one.
    The sample size that counts is then K, the number of groups. Scores as
    :class:`ConformalCalibrator`; n_k frames in group k.

    ``weighted`` (Lee, Barber, Willett 2023, arXiv 2306.06342): each group weighs 1/(K+1), shared
    evenly by its frames, and +∞ weighs 1/(K+1). Q is the (1-α)-quantile of that law: the smallest
    score s with Σ_k #{i: s_ki ≤ s}/n_k ≥ (K+1)(1-α). Counted in integers, L/n_k each with
    L = lcm(n_1…n_K), so that no rounding decides.

    ``subsampling`` (Dunn, Wasserman, Ramdas 2018, arXiv 1809.07441): draw one frame per group,
    which makes K+1 exchangeable frames; repeat B times. With the p-values
    p_b(s) = (1 + #{k: s_bk ≥ s})/(K+1), the interval holds all y with mean_b p_b > α/c, c = 1 for
    B = 1 and c = 2 for B > 1: twice an average of p-values is a p-value, the average itself is not.
    With N(s) = #{(b, k): s_bk ≥ s} the condition reads N(s) > B((K+1)α/c - 1), so that Q is the
    ⌈B(K+1)(1 - α/c)⌉-th smallest of all B·K draws. ``repeats=1`` covers with probability exactly
    ⌈(K+1)(1-α)⌉/(K+1) if there are no ties, but depends on the seed; many repeats hardly do, and
    cost the factor 2.

    A K too small, below ⌈(1-α)/α⌉ (of α/2 for B > 1), gives infinite intervals and a warning.
    The ``groups`` of new predictions do not matter and may be left out.

    Args:
        names: the outputs' names in messages.
        sigma_floor: smallest σ to divide by, in the network's own units.
        method: "weighted" or "subsampling". A loaded state brings its own.
        repeats: B of the subsampling.
        seed: of the draws, which look at no score.

    Raises:
        ConfigurationError: another method, ``repeats`` below 1, or a floor out of range.

    >>> rigs = [rig for rig in "abcdefghi" for _ in range(2)]
    >>> zeros, target = torch.zeros(18, 1), torch.arange(1.0, 19.0)[:, None]
    >>> calibrator = HierarchicalCalibrator().fit(zeros, zeros + 1, target, groups=rigs)
    >>> calibrator.quantile(0.8).item()  # of total weight 9 of 10: 8 groups = 16 frames
    16.0
    """

    kind: ClassVar[str] = "hierarchical"

    repeats: Tensor
    """B, int64; 0 for the weighted method."""

    def __init__(
        self,
        names: Sequence[str] | None = None,
        sigma_floor: float = 0.0,
        method: Literal["weighted", "subsampling"] = "weighted",
        repeats: int = 1,
        seed: int = 0,
    ) -> None:
        """Make an unfitted calibrator."""
        super().__init__(names, sigma_floor)
        if method not in ("weighted", "subsampling"):
            raise ConfigurationError(f'method = "{method}"; choose "weighted" or "subsampling".')
        if repeats < 1:
            raise ConfigurationError(f"repeats = {repeats}; draw at least one frame per group.")
        self.seed = seed
        self.register_buffer("repeats", torch.tensor(repeats if method == "subsampling" else 0))

    def _learn(self, scores: Tensor, groups: Sequence[str]) -> None:
        if int(self.repeats) == 0:
            super()._learn(scores, groups)
            return
        drawn = scores[self._draws(self._learn_groups(groups, scores.device))]
        self.scores, self.joint_scores = drawn.sort(dim=0).values, self._joint(drawn).sort().values
        self.score_groups = self.score_groups.new_empty(0, 0)
        self.joint_groups = self.joint_groups.new_empty(0)
        self.repeats = self.repeats.to(scores.device)

    def _draws(self, index: Tensor) -> Tensor:
        """(B·K,) sample numbers, B of each group with replacement."""
        generator = torch.Generator().manual_seed(self.seed)
        by_group = torch.split(index.cpu().argsort(stable=True), self.group_sizes.tolist())
        drawn = [
            members[torch.randint(len(members), (int(self.repeats),), generator=generator)]
            for members in by_group
        ]
        return torch.cat(drawn).to(index.device)

    def _pick(self, alpha: Fraction, *, joint: bool, groups: Sequence[str] | None) -> Tensor:
        table = self._table(joint=joint)
        n_groups, repeats = len(self.group_sizes), int(self.repeats)
        effective = alpha / 2 if repeats > 1 else alpha
        if n_groups < (needed := samples_needed(effective)):
            if self._first_time(alpha):
                what = "groups in the uncertainty calibration set"
                warn_too_few(n_groups, alpha, stacklevel=4, what=what, needed=needed)
            return torch.full_like(table[0], torch.inf)
        if repeats:
            return table[math.ceil(repeats * (n_groups + 1) * (1 - effective)) - 1].clone()
        rows = self._weighted_rows(alpha, joint=joint)
        return table.gather(0, rows[None])[0]

    def _weighted_rows(self, alpha: Fraction, *, joint: bool) -> Tensor:
        """(C,) row of each column at which the groups' weights reach (K+1)(1-α)."""
        table, owners = self._grouped_table(joint=joint)
        sizes = self.group_sizes.tolist()
        whole = math.lcm(*sizes)
        target = math.ceil(whole * (len(sizes) + 1) * (1 - alpha))
        # Python's own integers where the least common multiple of many sizes is astronomical.
        dtype = np.int64 if whole * (len(sizes) + 1) < 2**63 else np.object_
        weights = np.array([whole // size for size in sizes], dtype=dtype)
        below = np.cumsum(weights[owners.cpu().numpy()], axis=0) < target
        return torch.from_numpy(below.sum(0).astype(np.int64)).to(table.device)
