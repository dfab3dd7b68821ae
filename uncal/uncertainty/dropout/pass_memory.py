"""Stochastic passes kept on disk: a run of 50 also answers for 5, 10 and 25."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

log = logging.getLogger(__name__)


class PassMemory:
    """Remembers N passes of trained weights, and of no others, in a folder, frame by frame.

    Passes are a pure function of (seed, split, frame, number of the pass), so that the first n of N
    are the passes that an engine of n would have run; up to rounding, since other rows may go
    through the network together.
    """

    def __init__(self, folder: Path, passes: int) -> None:
        self.folder = folder
        self.passes = passes
        self.recalled: dict[str, int] = {}
        self.computed: dict[str, int] = {}
        self._known: dict[str, dict[str, Tensor]] = {}
        self._new: set[str] = set()

    def recall(self, split: str, frames: Sequence[str]) -> Tensor | None:
        """(n, B, D): of B frames the first n ≤ N passes that all have; None if one has none."""
        known = self._of(split)
        found = [known[frame] for frame in frames if frame in known]
        if len(found) < len(frames):
            return None
        passes = min(self.passes, *map(len, found))
        if passes == self.passes:
            self.recalled[split] = self.recalled.get(split, 0) + len(frames)
        return torch.stack([samples[:passes] for samples in found], dim=1)

    def remember(self, split: str, frames: Sequence[str], samples: Tensor) -> None:
        """Take note of the (N, B, D) passes of B frames; :meth:`save` writes them."""
        self.computed[split] = self.computed.get(split, 0) + len(frames)
        kept = samples.detach().cpu().unbind(1)
        self._of(split).update(zip(frames, kept, strict=True))
        self._new.add(split)

    def forget(self) -> None:
        """Let go what is kept, so that everything is computed again."""
        for path in self.folder.glob("*.pt"):
            path.unlink(missing_ok=True)
        self._known.clear()

    def save(self) -> None:
        """Write what is new; what others wrote meanwhile and had more passes stays."""
        for split in sorted(self._new):
            self.folder.mkdir(parents=True, exist_ok=True)
            mine = self._known[split]
            for frame, samples in _load(self._path(split)).items():
                if len(samples) > len(mine.get(frame, ())):
                    mine[frame] = samples
            partial = self._path(split).with_suffix(f".{os.getpid()}.partial")
            try:
                torch.save(mine, partial)
                partial.replace(self._path(split))
            finally:
                partial.unlink(missing_ok=True)
        self._new.clear()

    def origin(self, split: str) -> str:
        """How the passes of a split were come by: "computed", "reused" or "partly reused"."""
        if not self.recalled.get(split):
            return "computed"
        return "partly reused" if self.computed.get(split) else "reused"

    def _of(self, split: str) -> dict[str, Tensor]:
        if split not in self._known:
            self._known[split] = _load(self._path(split))
        return self._known[split]

    def _path(self, split: str) -> Path:
        return self.folder / f"{split}.pt"


def _load(path: Path) -> dict[str, Tensor]:
    if not path.is_file():
        return {}
    try:
        content: dict[str, Tensor] = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged file: what it held is computed again
        log.warning("%s cannot be read (%s): its passes are computed again", path, error)
        return {}
    return content
