"""Predictions of a whole split, and the seeds that make them repeatable."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import torch
from torch import Tensor

from uncal.errors import RecordingError


class SplitPrediction(NamedTuple):
    """Predictions of a split, in the order of its frames, on the CPU.

    Attributes:
        mean: (n, 6) mean of the stochastic passes, metres and radians.
        std: (n, 6) their standard deviation.
        target: (n, 6) the true decalibrations.
    """

    mean: Tensor
    std: Tensor
    target: Tensor


def pass_seed(seed: int, split: str, batch: int) -> int:
    """Seed of the dropout masks of one batch, so that an evaluation can be repeated bit for bit.

    Args:
        seed: the run's.
        split: name of the split.
        batch: number of the batch within it.

    Returns:
        63-bit seed.
    """
    digest = hashlib.sha256(f"{seed}|{split}|{batch}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def join_predictions(parts: list[SplitPrediction], split: str) -> SplitPrediction:
    """Predictions of a split's batches, as one.

    Args:
        parts: one per batch.
        split: its name, for the message.

    Returns:
        All of them.

    Raises:
        RecordingError: there is none.
    """
    if not parts:
        raise RecordingError(
            f"no frame of the {split} split could be read; see the skipped frames listed above"
        )
    return SplitPrediction(*(torch.cat(column) for column in zip(*parts, strict=True)))
