"""Scores that remember which drive or rig they come from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from uncal.errors import UncertaintyError
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
    """Normalised scores |ŷ - y|/σ with the group of each; what a method does with them is open.

    Args:
        names: the outputs' names in messages.
        sigma_floor: smallest σ to divide by, in the network's own units.

    Raises:
        ConfigurationError: a negative or non-finite floor.
    """

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
        """Make an unfitted calibrator."""
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
