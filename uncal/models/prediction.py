"""Predictions of a whole split, and the seeds that make them repeatable."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from uncal.data.network_input import NetworkInput
from uncal.errors import RecordingError
from uncal.recordings.frame import FrameId
from uncal.uncertainty.gather import gather_by_id
from uncal.uncertainty.mc_dropout import Prediction


@dataclass(frozen=True)
class SplitPrediction:
    """Predictions of some frames of a split.

    Attributes:
        place: (n,) int64 numbers of the frames in their split.
        mean: (n, 6) mean of the stochastic passes, metres and radians.
        std: (n, 6) their standard deviation.
        target: (n, 6) the true decalibrations.
        bounds: lower and upper quantiles, each (n, 6), of a network that has such a head.
    """

    place: Tensor
    mean: Tensor
    std: Tensor
    target: Tensor
    bounds: tuple[Tensor, Tensor] | None = None

    @classmethod
    def of(cls, prediction: Prediction, batch: NetworkInput) -> SplitPrediction:
        """One batch's; of 18 outputs the first six are the pose, the others its quantiles."""
        mean, *rest = torch.split(prediction.mean, 6, dim=1)
        bounds = (rest[0], rest[1]) if rest else None
        return cls(batch.place, mean, prediction.std[:, :6], batch.target, bounds)

    def groups(self, frames: Sequence[FrameId], by: str) -> list[str]:
        """What the frames belong to.

        Args:
            frames: of the split.
            by: ``rig`` or ``drive``.
        """
        chosen = [frames[i] for i in self.place.tolist()]
        return [f.rig if by == "rig" else f"{f.rig}/{f.drive}" for f in chosen]


def frame_seed(seed: int, split: str, frame: FrameId) -> int:
    """Seed of a frame's dropout masks: the same in any batch, on any process, in any order.

    Args:
        seed: the run's.
        split: name of the split.
        frame: the frame.

    Returns:
        63-bit seed.
    """
    digest = hashlib.sha256(f"{seed}|{split}|{frame}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def join_predictions(parts: Sequence[SplitPrediction], split: str) -> SplitPrediction:
    """Predictions of a split's batches as one, those of all processes together.

    Samples that a distributed sampler repeated are dropped; the order is the split's.

    Args:
        parts: this process's, one per batch.
        split: its name, for the message.

    Returns:
        All of them, on the CPU, the same on every process.

    Raises:
        RecordingError: there is none.
    """
    if parts:
        columns = [torch.cat([_columns(part)[i] for part in parts]) for i in range(2)]
    else:
        columns = [torch.empty(0, dtype=torch.int64), torch.empty(0, 0)]
    place, values = gather_by_id(columns[0], columns[1])
    if len(place) == 0:
        raise RecordingError(
            f"no frame of the {split} split could be read; see the skipped frames listed above"
        )
    mean, std, target, *bounds = torch.split(values.cpu(), 6, dim=1)
    pair = (bounds[0], bounds[1]) if bounds else None
    return SplitPrediction(place.cpu(), mean, std, target, pair)


def _columns(part: SplitPrediction) -> tuple[Tensor, Tensor]:
    return part.place, torch.cat([part.mean, part.std, part.target, *(part.bounds or ())], 1)
