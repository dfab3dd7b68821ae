"""Pictures for TensorBoard and the run folder: decalibrated, estimated and true extrinsic."""

from __future__ import annotations

from pathlib import Path

import cv2
import lightning
import numpy as np
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from numpy.typing import NDArray

from uncal.data.datamodule import CalibrationDataModule
from uncal.data.dataset import Sample, collate
from uncal.data.image_size import fit
from uncal.decalibration import correct
from uncal.metrics.pose_error import pose_errors
from uncal.models.module import CalibrationModule
from uncal.reporting.overlay import draw_events, overlay_panel

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
        self.folder = Path(folder)
        self.frames = frames
        self.label = label

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Estimate without dropout, draw, log."""
        data = getattr(trainer, "datamodule", None)
        if trainer.sanity_checking or not isinstance(data, CalibrationDataModule):
            return
        assert isinstance(pl_module, CalibrationModule)
        dataset = data.datasets["validation"]
        count = min(self.frames, len(dataset))
        for i in np.linspace(0, len(dataset) - 1, count).round().astype(int).tolist():
            sample = dataset[i]
            if isinstance(sample, Sample):
                picture = self._draw(trainer, pl_module, data, sample)
                self._keep(trainer, picture, str(sample.frame))

    def _draw(
        self,
        trainer: Trainer,
        module: CalibrationModule,
        data: CalibrationDataModule,
        sample: Sample,
    ) -> NDArray[np.uint8]:
        inputs = data.on_after_batch_transfer(collate([sample]).to(module.device), 0)
        assert inputs is not None
        with torch.inference_mode(), trainer.precision_plugin.forward_context():
            estimate = module(inputs)
        T_true = sample.T_cam_lidar.double()
        T_init = inputs.T_init[0].cpu().double()
        T_estimated = correct(T_init, estimate[0].cpu().double())
        error = pose_errors(estimate.cpu(), inputs.target.cpu(), 0)
        before = f"{error.translation_before:.1f} cm, {error.rotation_before:.2f} deg"
        after = f"{error.translation_after:.1f} cm, {error.rotation_after:.2f} deg"
        extrinsics = {
            f"decalibrated: off by {before}": T_init.numpy(),
            f"estimated: off by {after}": T_estimated.numpy(),
            f"true extrinsic ({self.label}, rig {sample.frame.rig})": T_true.numpy(),
        }
        image = background(data, sample)
        scale = max(1, round(WIDTH_PX / image.shape[1]))
        return overlay_panel(
            image, sample.points.numpy(), sample.K.double().numpy(), extrinsics, scale
        )

    def _keep(self, trainer: Trainer, picture: NDArray[np.uint8], frame: str) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / f"{frame.replace('/', '_')}.png"
        cv2.imwrite(str(path), picture[:, :, ::-1])
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger):
                logger.experiment.add_image(
                    f"overlay/{frame}", picture, trainer.global_step, dataformats="HWC"
                )


def background(data: CalibrationDataModule, sample: Sample) -> NDArray[np.uint8]:
    """What to draw points on: the image, or the events however the network is shown them.

    Args:
        data: where the sample comes from.
        sample: one of its samples.

    Returns:
        (H, W, 3) uint8 RGB, of the network's size.
    """
    if sample.camera.dtype == torch.uint8:
        return np.ascontiguousarray(sample.camera.numpy().transpose(1, 2, 0))
    events = data.recording.load(sample.frame).events
    assert events is not None
    return draw_events(events, data.image_size, fit(events.size, data.image_size).pixel_map)
