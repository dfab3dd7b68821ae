"""The evidence of the last frames, added up with forgetting."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uncal.edges.evidence import unpack
from uncal.models.alignment import PRIOR
from uncal.monitor.evidence import Estimate, Evidence, EvidenceReader

Vector = NDArray[np.float64]

RECENT = 2
"""So many frames in a row must contradict those before, lest one bad frame empty a window."""


@dataclass(frozen=True)
class Entry:
    """One frame's share of a window.

    Attributes:
        number: of the frame in the stream, unusable ones counted.
        evidence: of it.
        trusted: whether its inputs were like those of the references.
    """

    number: int
    evidence: Evidence
    trusted: bool


class Window:
    """At most so many frames, none of them older than so many frames.

    Args:
        frames: how many.
        forgetting: weight of a frame relative to the next usable one.
    """

    def __init__(self, frames: int, forgetting: float) -> None:
        self.frames = frames
        self.forgetting = forgetting
        self.entries: deque[Entry] = deque()
        self.number = 0

    def __len__(self) -> int:
        """Number of frames with evidence."""
        return len(self.entries)

    def add(self, evidence: Evidence | None, trusted: bool = True) -> None:
        """Take in the next frame of the stream.

        Args:
            evidence: of it; None where it has none.
            trusted: whether its inputs were like those of the references.
        """
        self.number += 1
        if evidence is not None:
            kept = evidence._replace(glimpse=None)  # which is large, and needed no longer
            self.entries.append(Entry(self.number, kept, trusted))
        while self.entries and self.entries[0].number <= self.number - self.frames:
            self.entries.popleft()

    def clear(self) -> None:
        """Forget all, as before the first frame of a drive."""
        self.entries.clear()

    def keep_last(self, frames: int) -> None:
        """Forget all but the last frames.

        Args:
            frames: with evidence, to keep.
        """
        while len(self.entries) > frames:
            self.entries.popleft()

    def jump(self) -> float:
        """How much each of the last frames contradicts those before, as the least of them does.

        With poses x and covariances C of a frame alone and of the frames before the last
        :data:`RECENT`, (x₁ - x₂)ᵀ (C₁ + C₂)⁻¹ (x₁ - x₂) / 6. Errors of frames are dependent and σ
        is not exact, so that no χ² distribution is assumed: references say what is usual.

        Returns:
            At least 0; 0 where not as many frames stand against the last ones.
        """
        if len(self.entries) < 2 * RECENT:
            return 0.0
        ages = torch.arange(len(self.entries) - RECENT - 1, -1, -1)
        rows = torch.stack([entry.evidence.equations.mean(0) for entry in self.entries]).double()
        weights = (self.forgetting**ages).to(rows)
        before = (rows[:-RECENT] * weights[:, None]).sum(0)
        normal, right = unpack(torch.cat([before[None], rows[-RECENT:]]))
        covariance = torch.linalg.inv(normal + PRIOR * torch.eye(6).to(normal))
        pose = (covariance @ right[..., None]).squeeze(-1)
        apart = pose[1:] - pose[0]
        squared = (apart * torch.linalg.solve(covariance[1:] + covariance[0], apart)).sum(-1)
        return float(squared.min() / 6)

    @property
    def trusted(self) -> bool:
        """Whether all of it may be acted upon."""
        return all(entry.trusted for entry in self.entries)

    def total(self) -> Tensor:
        """(N, 27) weighted sum of the evidence; of at least one frame."""
        rows = torch.stack([entry.evidence.equations for entry in self.entries])
        ages = torch.arange(len(rows) - 1, -1, -1, device=rows.device)
        return (rows * (self.forgetting**ages).to(rows)[:, None, None]).sum(0)

    def rebase(self, reader: EvidenceReader, step: Vector) -> None:
        """Make the evidence that of the extrinsic after a step.

        Args:
            reader: knows the units.
            step: (6,) decalibration taken out, metres and radians.
        """
        self.entries = deque(
            Entry(
                entry.number,
                entry.evidence._replace(equations=reader.rebase(entry.evidence.equations, step)),
                entry.trusted,
            )
            for entry in self.entries
        )

    def statistics(self, estimate: Estimate, reader: EvidenceReader) -> Vector:
        """(K,) :data:`uncal.monitor.statistics.WINDOWED`.

        Args:
            estimate: of this window.
            reader: knows the units.
        """
        means = np.mean([entry.evidence.statistics for entry in self.entries], axis=0)
        log_sigma = float(np.log(estimate.std).mean())
        return np.array([*means, log_sigma, self._disagreement(estimate, reader)])

    def _disagreement(self, estimate: Estimate, reader: EvidenceReader) -> float:
        """Log of the mean squared distance of single frames from the window, in their own σ."""
        rows = torch.stack([entry.evidence.equations.mean(0) for entry in self.entries]).double()
        normal, right = unpack(rows)
        pose = torch.from_numpy(estimate.mean / reader.bounds).to(rows)
        left = right - normal @ pose
        known = normal + PRIOR * torch.eye(6).to(rows)
        squared = (left * torch.linalg.solve(known, left)).sum(-1)
        return float(torch.log(squared.mean() / 6 + 1e-9))
