"""Interval methods whose scores remember which drive or rig they come from.

Arguments and errors are those of :class:`uncal.uncertainty.IntervalCalibrator`
where nothing else is said.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import ClassVar, Literal

import numpy as np
import torch
from torch import Tensor

from uncal.errors import ConfigurationError, UncertaintyError
from uncal.uncertainty.conformal.quantile import conformal_rank, samples_needed, warn_too_few
from uncal.uncertainty.conformal.split_conformal import ConformalCalibrator


def encode_labels(labels: Iterable[str]) -> Tensor:
    """Labels as bytes, for a buffer: UTF-8, a zero byte after each.

    Raises:
        UncertaintyError: a label with a zero character.

    >>> decode_labels(encode_labels(["rig Ä", ""]))
    ('rig Ä', '')
    """
    labels = tuple(labels)
    if bad := [label for label in labels if "\0" in label]:
        raise UncertaintyError(f"group {bad[0]!r} contains a zero character: choose another name.")
    content = "".join(f"{label}\0" for label in labels).encode()
    return torch.tensor(list(content), dtype=torch.uint8)


def decode_labels(content: Tensor) -> tuple[str, ...]:
    """The labels of :func:`encode_labels`."""
    return tuple(bytes(content.tolist()).decode().split("\0")[:-1])


class GroupedCalibrator(ConformalCalibrator):
    """Normalised scores |ŷ - y|/σ with the group of each; what a method does with them is open."""

    needs_groups: ClassVar[bool] = True

    labels: Tensor
    """uint8, the groups' labels in sorted order, see :func:`encode_labels`."""
    group_sizes: Tensor
    """(G,) int64, m_g."""
    score_groups: Tensor
    """(m, D) int64, index of the group that each sorted score belongs to."""
    joint_groups: Tensor
    """(m,) int64, the same for the joint scores."""

    def __init__(self, names: Sequence[str] | None = None, sigma_floor: float = 0.0) -> None:
        super().__init__(names, sigma_floor)
        self.register_buffer("labels", torch.empty(0, dtype=torch.uint8))
        self.register_buffer("group_sizes", torch.empty(0, dtype=torch.int64))
        self.register_buffer("score_groups", torch.empty(0, 0, dtype=torch.int64))
        self.register_buffer("joint_groups", torch.empty(0, dtype=torch.int64))

    @property
    def group_counts(self) -> dict[str, int]:
        """Samples of the uncertainty calibration set per group, by label."""
        sizes = self.group_sizes.tolist()
        return dict(zip(decode_labels(self.labels), sizes, strict=True))

    def _learn(self, scores: Tensor, groups: Sequence[str]) -> None:
        index = self._learn_groups(groups, scores.device)
        joint = self._joint(scores)
        order, joint_order = scores.argsort(dim=0), joint.argsort()
        self.scores, self.joint_scores = scores.gather(0, order), joint[joint_order]
        self.score_groups, self.joint_groups = index[order], index[joint_order]

    def _learn_groups(self, groups: Sequence[str], device: torch.device) -> Tensor:
        """Keep labels and sizes; (m,) the index of each sample's group."""
        known = {label: g for g, label in enumerate(sorted(set(groups)))}
        self.labels = encode_labels(known).to(device)
        index = torch.tensor([known[label] for label in groups], device=device)
        self.group_sizes = index.bincount(minlength=len(known))
        return index

    def _grouped_table(self, *, joint: bool) -> tuple[Tensor, Tensor]:
        """(m, C) sorted scores and the index of the group of each."""
        owners = self.joint_groups[:, None] if joint else self.score_groups
        return self._table(joint=joint), owners


class MondrianCalibrator(GroupedCalibrator):
    """Intervals that cover at least 1-α within every group, not only over all frames.

    Scores as :class:`ConformalCalibrator`; a frame of group g gets Q = s_(⌈(m_g+1)(1-α)⌉) of the
    m_g scores of that group (Vovk, Gammerman, Shafer 2005, section 4.5).

    Groups below N = ⌈(1-α)/α⌉ samples, the fewest that allow a finite quantile, and groups never
    seen share one category: their quantile is that of all groups of at most N samples together.
    This is exact as well: among the m+1 frames of the set and the new one, the category "groups of
    at most N frames" does not depend on which frame is the new one, so that these too are covered
    with probability at least 1-α, if only on the whole. The quantile over *all* frames would
    guarantee nothing here: large easy groups set it, and small hard ones miss it. Where even the
    shared category is too small the interval is infinite; for a rig never seen,
    :class:`HierarchicalCalibrator` is the tool. Either is said once per fit, level and group.

    >>> target = torch.cat([torch.arange(1.0, 10.0), 10 * torch.arange(1.0, 10.0)])[:, None]
    >>> zeros, ones = torch.zeros(18, 1), torch.ones(18, 1)
    >>> calibrator = MondrianCalibrator()
    >>> _ = calibrator.fit(zeros, ones, target, groups=["city"] * 9 + ["rural"] * 9)
    >>> calibrator.predict(zeros[:2], ones[:2], 0.9, groups=["rural", "city"]).upper
    tensor([[90.],
            [ 9.]])
    """

    kind: ClassVar[str] = "mondrian"

    def _pick(self, alpha: Fraction, *, joint: bool, groups: Sequence[str] | None) -> Tensor:
        """(n, C), a row per label."""
        groups = self._check.groups(groups)
        wanted = {label: i for i, label in enumerate(dict.fromkeys(groups))}
        rows = [self._group_quantile(label, alpha, joint=joint) for label in wanted]
        index = torch.tensor([wanted[label] for label in groups], dtype=torch.int64)
        if not rows:
            return self._table(joint=joint)[:0]
        return torch.stack(rows)[index.to(rows[0].device)]

    def _group_quantile(self, label: str, alpha: Fraction, *, joint: bool) -> Tensor:
        """(C,) the quantile of one group, or of the small groups together."""
        counts = self.group_counts
        needed, size = samples_needed(alpha), counts.get(label, 0)
        if size >= needed:
            members = [list(counts).index(label)]
        else:
            members = [g for g, other in enumerate(counts.values()) if other <= needed]
        table, owners = self._grouped_table(joint=joint)
        inside = torch.isin(owners, torch.tensor(members, dtype=torch.int64, device=owners.device))
        scores = table.T[inside.T].reshape(table.shape[1], -1)
        n_scores = scores.shape[1]
        finite = n_scores >= needed
        if size < needed and self._first_time(alpha, label):
            warnings.warn(
                f'group "{label}" has {size} samples in the uncertainty calibration set and a '
                f"{float(100 - 100 * alpha):g}% interval needs {needed}: it shares the quantile of "
                f"all {len(members)} groups of at most {needed}, {n_scores} samples"
                + ("." if finite else ", which are too few as well. The interval is infinite."),
                stacklevel=5,
            )
        if not finite:
            return torch.full_like(table[0], torch.inf)
        return scores[:, conformal_rank(n_scores, alpha) - 1]


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
        sigma_floor: smallest σ to divide by.
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
