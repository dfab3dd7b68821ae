"""What overlays have in common: the background, the panel, the file and TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import torch
from lightning import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from numpy.typing import NDArray

from uncal.data.datamodule import CalibrationDataModule
from uncal.data.dataset import Sample
from uncal.recordings.sensor_files import write_image
from uncal.reporting.overlay import draw_events, overlay_panel

WIDTH_PX = 1000
"""Least width of a picture; small images are enlarged to it."""


def keep_overlay(
    trainer: Trainer,
    data: CalibrationDataModule,
    sample: Sample,
    extrinsics: Mapping[str, NDArray[np.float64]],
    path: Path,
    tag: str,
) -> None:
    """A sample's points on its image or events, as a PNG and in TensorBoard.

    Args:
        trainer: with the loggers.
        data: of the sample.
        sample: whose points and image.
        extrinsics: caption → (4, 4), one row of the picture each.
        path: of the PNG; its folder is made if it is not there.
        tag: in TensorBoard.
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
    return draw_events(
        events, data.image_size, data.datasets["test"].fit(events.size, frame.K).pixel_map
    )


def show_picture(trainer: Trainer, path: Path, tag: str) -> None:
    """Show a PNG in TensorBoard, if there is such a logger."""
    for logger in trainer.loggers:
        if isinstance(logger, TensorBoardLogger) and (picture := cv2.imread(str(path))) is not None:
            rgb, step = picture[:, :, ::-1], trainer.global_step
            logger.experiment.add_image(tag, rgb, step, dataformats="HWC")
