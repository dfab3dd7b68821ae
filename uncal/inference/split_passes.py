"""Predictions of a whole split, outside Lightning's own loops: MC dropout's, and the control's.

The image-blind control is the same test, fed with what the camera saw in another frame.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence

import torch
from lightning import Trainer
from torch import Tensor

from uncal.data.datamodule import CalibrationDataModule
from uncal.data.dataset import Batch, FrameDataset, Sample
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import (
    ControlPrediction,
    SplitPrediction,
    frame_seed,
    join_predictions,
)
from uncal.recordings.frame import FrameId
from uncal.system.progress import watched
from uncal.uncertainty.dropout.layers import only_active
from uncal.uncertainty.gather import gather_by_id

log = logging.getLogger(__name__)


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


def control_order(frames: Sequence[FrameId], seed: int) -> list[int]:
    """Numbers of the frames in a pseudo-random order, the same on every process and machine.

    A frame gets the image of the one before it. In the order of time that would be its neighbour,
    which shows nearly the same.

    >>> control_order([FrameId("rig", "drive", i) for i in range(6)], seed=0)
    [2, 1, 4, 0, 5, 3]
    """
    return sorted(range(len(frames)), key=lambda i: frame_seed(seed, "image-blind", frames[i]))


def image_blind_control(
    trainer: Trainer, module: CalibrationModule, data: CalibrationDataModule, split: str = "test"
) -> ControlPrediction | None:
    """Estimate every frame with its own image and with another frame's, without dropout.

    In a pseudo-random order each readable frame gets the image (or the events) of the readable
    one before it, the first that of the last. So no frame keeps its own, whatever cannot be read,
    and which image a frame gets does not depend on batch size or number of processes.

    Returns:
        The estimates of all readable frames, the same on every process; None if fewer than two
        can be read.

    Raises:
        ValueError: the training split, whose decalibrations are drawn anew for every batch.
    """
    if split == "train":
        raise ValueError("the control compares two estimates of one decalibration: not of train.")
    order = control_order(data.named(split), data.seed)
    rank, processes = trainer.global_rank, trainer.world_size
    mine = order[len(order) * rank // processes : len(order) * (rank + 1) // processes]
    parts = _estimate(trainer, module, data, split, order, mine)
    data.share_skipped()
    columns = [torch.empty(0, dtype=torch.int64), torch.empty(0, 0)]
    if parts:
        columns = [torch.cat(column) for column in zip(*parts, strict=True)]
    index, values = (column.cpu() for column in gather_by_id(*columns))
    if len(index) == 0:
        if trainer.is_global_zero:
            log.warning(
                "no image-blind control: it gives each frame the image of another one, and fewer "
                "than two of the %d frames of the %s split can be read",
                len(order),
                split,
            )
        return None
    frames = tuple(data.named(split)[i] for i in index.tolist())
    return ControlPrediction(index, frames, *torch.split(values, 6, dim=1))


def _estimate(
    trainer: Trainer,
    module: CalibrationModule,
    data: CalibrationDataModule,
    split: str,
    order: Sequence[int],
    mine: Sequence[int],
) -> list[tuple[Tensor, Tensor]]:
    """Places (B,) and both estimates beside the target (B, 18), per batch of this process."""
    parts: list[tuple[Tensor, Tensor]] = []
    loader = data.loader_of(split, order=mine)
    bar = watched(loader, f"image-blind, {split}", quiet=not trainer.is_global_zero)
    before: Tensor | None = None
    with torch.inference_mode(), only_active(module, []):
        for loaded in bar:
            batch = loaded.to(module.device)
            own = data.on_after_batch_transfer(batch, 0)
            if own is None:
                continue
            if before is None:
                before = _camera_before(data.datasets[split], order, int(batch.unit_index[0]))
            if before is None:  # the only readable unit of the split
                continue
            cameras = _of_units_before(before.to(batch.camera.device), batch)
            before = batch.camera[batch.unit == batch.unit[-1]]
            other = data.on_after_batch_transfer(batch._replace(camera=cameras), 0)
            assert other is not None
            with trainer.precision_plugin.forward_context():
                estimates = module(own).float(), module(other).float()
            parts.append((batch.unit_index, torch.cat([*estimates, own.target], 1)))
    return parts


def _camera_before(dataset: FrameDataset, order: Sequence[int], unit: int) -> Tensor | None:
    """(W, C, H, W) cameras of the last readable unit before one in a cyclic order.

    It is read here a second time, as another process or a later batch has it.
    """
    at = order.index(unit)
    for index in (*reversed(order[:at]), *reversed(order[at + 1 :])):
        cameras = [frame.camera for frame in dataset[index] if isinstance(frame, Sample)]
        if cameras:
            return torch.stack(cameras)
    return None


def _of_units_before(before: Tensor, batch: Batch) -> Tensor:
    """(B, C, H, W) of the unit before, frame by frame; (W, C, H, W) before the first unit."""
    cameras = []
    for unit in range(len(batch.unit_index)):
        own = batch.camera[batch.unit == unit]
        # A window with a frame that could not be read is shorter than its neighbour.
        cameras.append(before[torch.arange(len(own), device=own.device) % len(before)])
        before = own
    return torch.cat(cameras)
