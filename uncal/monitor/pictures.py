"""Pictures on request: edges of the sweep on the image, before and after the correction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from uncal.data.dataset import Sample
from uncal.monitor.evidence import EvidenceReader
from uncal.monitor.extrinsic import after_step
from uncal.monitor.verdict import Verdict
from uncal.recordings.frame import Frame
from uncal.recordings.sensor_files import write_image
from uncal.reporting.overlay import draw_events, overlay_panel

WIDTH_PX = 1000
"""Least width of a picture; small images are enlarged to it."""


class Pictures:
    """A picture of every n-th usable frame.

    Args:
        folder: where they go.
        every: n.
        reader: has the frames' edges.
    """

    def __init__(self, folder: Path, every: int, reader: EvidenceReader) -> None:
        self.folder = folder
        self.every = every
        self.reader = reader

    def keep(self, number: int, frame: Frame | None, verdict: Verdict) -> None:
        """Draw a frame if its turn has come.

        Args:
            number: of the frame in the stream.
            frame: None: it could not be read.
            verdict: of the frame.
        """
        sample = self.reader.sample
        if number % self.every or frame is None or sample is None or sample.frame != frame.id:
            return
        T_before = sample.T_cam_lidar.double().numpy()
        extrinsics = {
            f"{verdict.frame}: extrinsic in use ({verdict.verdict})": T_before,
            "corrected by the estimate": after_step(T_before, verdict.correction),
        }
        image = shown(frame, sample, self.reader)
        scale = max(1, round(WIDTH_PX / image.shape[1]))
        points = sample.edges if len(sample.edges) else sample.points
        K = sample.K.double().numpy()
        self.folder.mkdir(parents=True, exist_ok=True)
        name = verdict.frame.replace("/", "_")
        panel = overlay_panel(image, points.numpy(), K, extrinsics, scale)
        write_image(self.folder / f"{name}.png", panel)

    def close(self) -> None:
        """Nothing is left to do."""


def shown(frame: Frame, sample: Sample, reader: EvidenceReader) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB at the network's size: the image, or the events as a picture.

    Args:
        frame: as it was read.
        sample: of the same frame.
        reader: knows how it was resized.
    """
    if sample.camera.dtype == torch.uint8:
        return np.ascontiguousarray(sample.camera.numpy().transpose(1, 2, 0))
    assert frame.events is not None
    size = (int(sample.camera.shape[1]), int(sample.camera.shape[2]))
    return draw_events(frame.events, size, reader.fit(frame).pixel_map)
