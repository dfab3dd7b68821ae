"""Pictures for TensorBoard and the run folder: decalibrated, estimated and true extrinsic."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import lightning
import numpy as np
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from numpy.typing import NDArray
from torch.utils.tensorboard import SummaryWriter

from uncal.data.datamodule import CalibrationDataModule
from uncal.data.dataset import Sample, collate
from uncal.geometry.decalibration import correct
from uncal.metrics.pose_error import pose_errors
from uncal.models.module import CalibrationModule
from uncal.recordings.sensor_files import write_image
from uncal.reporting.overlay import draw_events, overlay_panel
from uncal.reporting.tensorboard import add_png

WIDTH_PX = 1000
"""Least width of a picture; small images are enlarged to it."""


class Overlays(lightning.Callback):
    """Draws a few validation frames after each validation.

    Args:
        folder: where the PNGs go; each validation replaces those of the one before.
        frames: how many, spread evenly over the validation split.
        label: what the data are, such as "simulated"; stands in every picture.
    """

    def __init__(self, folder: str, frames: int, label: str) -> None:
        self.folder, self.frames, self.label = Path(folder), frames, label

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Estimate without dropout, draw, log."""
        data = getattr(trainer, "datamodule", None)
        if trainer.sanity_checking or not isinstance(data, CalibrationDataModule):
            return
        assert isinstance(pl_module, CalibrationModule)
        dataset = data.datasets["validation"]
        count = min(self.frames, len(dataset))
        for i in np.linspace(0, len(dataset) - 1, count).round().astype(int).tolist():
            sample = dataset[i][0]
            if isinstance(sample, Sample):
                name = str(sample.frame)
                path = self.folder / f"{name.replace('/', '_')}.png"
                extrinsics = self._extrinsics(trainer, pl_module, data, sample)
                keep_overlay(trainer, data, sample, extrinsics, path, f"overlay/{name}")

    def _extrinsics(
        self,
        trainer: Trainer,
        module: CalibrationModule,
        data: CalibrationDataModule,
        sample: Sample,
    ) -> dict[str, NDArray[np.float64]]:
        inputs = data.on_after_batch_transfer(collate([[sample]]).to(module.device), 0)
        assert inputs is not None
        with torch.inference_mode(), trainer.precision_plugin.forward_context():
            estimate = module(inputs).cpu()
        T_init = inputs.T_init[0].cpu().double()
        error = pose_errors(estimate, inputs.target.cpu(), 0)
        before = f"{error.translation_before:.1f} cm, {error.rotation_before:.2f} deg"
        after = f"{error.translation_after:.1f} cm, {error.rotation_after:.2f} deg"
        true = f"true extrinsic ({self.label}, rig {sample.frame.rig})"
        return {
            f"decalibrated: off by {before}": T_init.numpy(),
            f"estimated: off by {after}": correct(T_init, estimate[0].double()).numpy(),
            true: sample.T_cam_lidar.double().numpy(),
        }


def keep_overlay(
    trainer: Trainer,
    data: CalibrationDataModule,
    sample: Sample,
    extrinsics: Mapping[str, NDArray[np.float64]],
    path: Path,
    tag: str,
) -> None:
    """A sample's points on its image or events, as a PNG and in TensorBoard.

    One row of the picture per extrinsic (caption → (4, 4)); the PNG's folder is made if need be.
    """
    image = background(data, sample)
    scale = max(1, round(WIDTH_PX / image.shape[1]))
    K = sample.K.double().numpy()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, overlay_panel(image, sample.points.numpy(), K, extrinsics, scale))
    show_picture(trainer, path, tag)


def background(data: CalibrationDataModule, sample: Sample) -> NDArray[np.uint8]:
    """The (H, W, 3) uint8 RGB picture to draw points on: the image, or the events as a picture."""
    if sample.camera.dtype == torch.uint8:
        return np.ascontiguousarray(sample.camera.numpy().transpose(1, 2, 0))
    frame = data.recording.load(sample.frame)
    events = frame.events
    assert events is not None
    fit = data.datasets["test"].fit(events.size, frame.K)
    return draw_events(events, data.image_size, fit.pixel_map)


def show_picture(trainer: Trainer, path: Path, tag: str) -> None:
    """Show a PNG in TensorBoard, if there is such a logger."""
    for logger in trainer.loggers:
        if isinstance(logger, TensorBoardLogger) and isinstance(logger.experiment, SummaryWriter):
            add_png(logger.experiment, tag, path, trainer.global_step)
