"""Figures of a multirun for TensorBoard, beside those of its jobs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
from torch.utils.tensorboard import SummaryWriter


def show_in_tensorboard(pictures: Sequence[Path], folder: Path) -> None:
    """Write pictures into one TensorBoard file of their own, in place of an earlier one."""
    for earlier in folder.glob("events.out.tfevents.*"):
        earlier.unlink(missing_ok=True)
    with SummaryWriter(str(folder)) as writer:
        for path in pictures:
            picture = cv2.imread(str(path))
            if picture is not None:
                writer.add_image(f"multirun/{path.stem}", picture[:, :, ::-1], dataformats="HWC")
