"""MC-dropout predictions of a whole split, outside Lightning's own loops."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from lightning import Trainer

from uncal.data.datamodule import CalibrationDataModule
from uncal.data.dataset import Batch
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import SplitPrediction, join_predictions
from uncal.system.progress import watched


def predict_split(
    trainer: Trainer,
    module: CalibrationModule,
    data: CalibrationDataModule,
    split: str,
    most: int | None = None,
) -> SplitPrediction:
    """Run the stochastic passes over a split, shared out among the trainer's processes.

    Returns:
        Predictions of all readable frames, the same on every process.

    Raises:
        RecordingError: no frame of the split could be read.
    """
    loader = data.loader_of(split, most, share=(trainer.global_rank, trainer.world_size))
    quiet = not trainer.is_global_zero
    bar = watched(loader, f"MC dropout, {split}", quiet=quiet)
    return predict_batches(trainer, module, data, split, bar)


def predict_batches(
    trainer: Trainer,
    module: CalibrationModule,
    data: CalibrationDataModule,
    split: str,
    batches: Iterable[Batch],
) -> SplitPrediction:
    """The same for the batches of a split, wherever they come from.

    Raises:
        RecordingError: no frame of them could be read.
    """
    parts: list[SplitPrediction] = []
    with torch.inference_mode():
        for batch in batches:
            inputs = data.on_after_batch_transfer(batch.to(module.device), 0)
            if inputs is None:
                continue
            with trainer.precision_plugin.forward_context():
                parts.append(module.stochastic(inputs, split))
    data.share_skipped()
    return join_predictions(parts, split)
