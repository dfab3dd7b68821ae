"""The monitor's estimates as curves for TensorBoard."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from torch.utils.tensorboard import SummaryWriter

from uncal.geometry.transforms import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.monitor.verdict import VERDICTS, Verdict
from uncal.recordings.frame import Frame

PARTS = ("correction", "lower", "upper", "sigma")
"""Attributes of a verdict that are curves of each DoF, centimetres and degrees."""


class Curves:
    """Six corrections with their bounds and σ, verdict and wealth against the frame's number.

    Args:
        folder: of the event file.
        begun: number of frames that an earlier part of the run has shown.
    """

    def __init__(self, folder: Path, begun: int) -> None:
        self.writer = SummaryWriter(str(folder), purge_step=begun)
        margins = {
            f"{dof} ({unit})": ["Margin", [f"{part}/{dof}" for part in PARTS[:3]]]
            for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
        }
        self.writer.add_custom_scalars({"extrinsic": margins})

    def keep(self, number: int, frame: Frame | None, verdict: Verdict) -> None:
        """Add a point to each curve; bounds that are not finite have none.

        Args:
            number: of the frame in the stream.
            frame: not looked at.
            verdict: of the frame.
        """
        for part in PARTS:
            values = getattr(verdict, part) * DOF_SCALE
            for dof, value in zip(DOF_NAMES, values, strict=True):
                if np.isfinite(value):
                    self.writer.add_scalar(f"{part}/{dof}", value, number)
        self.writer.add_scalar("verdict", VERDICTS.index(verdict.verdict), number)
        self.writer.add_scalar("frames in the window", verdict.frames, number)
        self.writer.add_scalar("wealth of the martingale", verdict.wealth, number)

    def close(self) -> None:
        """Write what is waiting."""
        self.writer.close()
