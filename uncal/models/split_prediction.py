"""Predictions of a whole split, and the seeds that make them repeatable."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from uncal.data.network_input import NetworkInput
from uncal.errors import ConfigurationError, RecordingError
from uncal.models.answer import Answer
from uncal.recordings.frame import FrameId
from uncal.uncertainty.gather import gather_by_id

SPREADS: tuple[str, ...] = ("dropout", "solver", "total")
"""What σ is: that of the stochastic passes (the paper's), that of the least-squares solver, which
knows how many edges it had and where, or both, added in quadrature."""


@dataclass(frozen=True)
class SplitPrediction:
    """Predictions of some frames of a split.

    Attributes:
        index: (n,) int64 numbers of the units (frames or windows) in their split.
        mean: (n, 6) mean of the stochastic passes, metres and radians.
        std: (n, 6) σ, as the chosen spread makes it.
        target: (n, 6) the true decalibrations.
        covariance: (n, 6, 6) of the error, as the chosen spread makes it.
        bounds: lower and upper quantiles, each (n, 6), of a network that has such a head.
    """

    index: Tensor
    mean: Tensor
    std: Tensor
    target: Tensor
    covariance: Tensor
    bounds: tuple[Tensor, Tensor] | None = None

    @classmethod
    def of(cls, answer: Answer, batch: NetworkInput, spread: str) -> SplitPrediction:
        """One batch's; of 18 outputs the first six are the pose, the others its quantiles.

        Raises:
            ConfigurationError: the solver's covariance of a network without a solver.
        """
        mean, *rest = torch.split(answer.samples.mean(0), 6, dim=1)
        bounds = (rest[0], rest[1]) if rest else None
        std, covariance = spread_of(answer, spread)
        return cls(batch.unit_index, mean, std, batch.target, covariance, bounds)

    def to(self, device: torch.device | str) -> SplitPrediction:
        """The same on another device, where ``trainer.predict`` moves what it collects."""
        moved = {
            field.name: getattr(self, field.name).to(device)
            for field in fields(self)
            if field.name != "bounds"
        }
        bounds = self.bounds and (self.bounds[0].to(device), self.bounds[1].to(device))
        return SplitPrediction(**moved, bounds=bounds)

    def groups(self, frames: Sequence[FrameId], by: str) -> list[str]:
        """The ``rig`` or ``drive`` of each, from all frames of the split."""
        chosen = [frames[i] for i in self.index.tolist()]
        return [f.rig if by == "rig" else f"{f.rig}/{f.drive}" for f in chosen]


@dataclass(frozen=True)
class ControlPrediction:
    """Estimates with the camera's data of the frame itself, and of another frame.

    Attributes:
        index: (n,) int64 numbers of the frames in their split, ascending.
        frames: the n frames.
        single: (n, 6) one pass without dropout, metres and radians.
        blind: (n, 6) the same with the same points and decalibration, but another frame's image.
        target: (n, 6) the true decalibrations.
    """

    index: Tensor
    frames: tuple[FrameId, ...]
    single: Tensor
    blind: Tensor
    target: Tensor

    def among(self, index: Tensor) -> ControlPrediction | None:
        """The part of it with (m,) int64 numbers in the split, or None if fewer than two."""
        kept = torch.isin(self.index, index)
        if int(kept.sum()) < 2:
            return None
        frames = tuple(f for f, keep in zip(self.frames, kept.tolist(), strict=True) if keep)
        columns = (self.single, self.blind, self.target)
        return ControlPrediction(self.index[kept], frames, *(each[kept] for each in columns))


def spread_of(answer: Answer, spread: str) -> tuple[Tensor, Tensor]:
    """(n, 6) σ and (n, 6, 6) covariance of the error, m and rad, by one of :data:`SPREADS`.

    Raises:
        ConfigurationError: the solver's covariance of a network without a solver.
    """
    passes = answer.samples[..., :6]
    if spread == "dropout":
        return passes.std(0, correction=0), _covariance(passes)
    if answer.covariance is None:
        raise ConfigurationError(
            f"mcd.spread={spread} needs the covariance of a solver, which this network "
            "has not: use mcd.spread=dropout, or model/backbone=edges"
        )
    covariance = answer.covariance
    if spread == "total":
        covariance = covariance + _covariance(passes)
    return covariance.diagonal(dim1=1, dim2=2).sqrt(), covariance


def frame_seed(seed: int, split: str, frame: FrameId) -> int:
    """63-bit seed of a frame's masks: the same in any batch, on any process, in any order."""
    digest = hashlib.sha256(f"{seed}|{split}|{frame}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def pass_names(batch: NetworkInput) -> list[str]:
    """B names under which the passes of a batch's frames are remembered: the frame's own.

    In a window all its frames' names follow, on whose evidence, added up, the passes depend.
    """
    names = [str(frame) for frame in batch.frames]
    unit = batch.unit.tolist()
    windows = {u: [name for name, of in zip(names, unit, strict=True) if of == u] for u in unit}
    return [
        name if len(windows[u]) == 1 else f"{name} in {' '.join(windows[u])}"
        for name, u in zip(names, unit, strict=True)
    ]


def join_predictions(parts: Sequence[SplitPrediction], split: str) -> SplitPrediction:
    """Predictions of a split's batches as one, those of all processes together.

    Samples that a distributed sampler repeated are dropped; the order is the split's. All are on
    the CPU, the same on every process; it is an error if there is none.
    """
    if parts:
        columns = [torch.cat([_columns(part)[i] for part in parts]) for i in range(2)]
    else:
        columns = [torch.empty(0, dtype=torch.int64), torch.empty(0, 0)]
    index, values = gather_by_id(columns[0], columns[1])
    if len(index) == 0:
        raise RecordingError(
            f"no frame of the {split} split could be read; see the skipped frames listed above"
        )
    mean, std, target, *rest = torch.split(values.cpu(), 6, dim=1)
    covariance = torch.stack(rest[:6], 1)
    pair = (rest[6], rest[7]) if rest[6:] else None
    return SplitPrediction(index.cpu(), mean, std, target, covariance, pair)


def _columns(part: SplitPrediction) -> tuple[Tensor, Tensor]:
    columns = [part.mean, part.std, part.target, part.covariance.flatten(1), *(part.bounds or ())]
    return part.index, torch.cat(columns, 1)


def _covariance(samples: Tensor) -> Tensor:
    """(n, D, D) covariance of (N, n, D) samples, with 1/N as in the paper."""
    centred = (samples - samples.mean(0)).transpose(0, 1)
    return centred.transpose(1, 2) @ centred / len(samples)
