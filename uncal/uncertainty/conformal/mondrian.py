"""Group-conditional ("Mondrian") conformal calibration: every drive or rig at its own quantile."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from fractions import Fraction
from typing import ClassVar

import torch
from torch import Tensor

from uncal.uncertainty.conformal.groups import GroupedCalibrator
from uncal.uncertainty.conformal.quantile import conformal_rank, samples_needed


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

    Args:
        names: the outputs' names in messages.
        sigma_floor: smallest σ to divide by, in the network's own units.

    Raises:
        ConfigurationError: a negative or non-finite floor.

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
