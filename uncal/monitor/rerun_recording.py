"""What the monitor sees and says, as a recording for the rerun viewer (extra ``uncal[rerun]``)."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from uncal.errors import ConfigurationError
from uncal.geometry.transforms import DOF_NAMES, DOF_SCALE
from uncal.monitor.evidence import EvidenceReader
from uncal.monitor.extrinsic import after_step
from uncal.monitor.pictures import shown
from uncal.monitor.verdict import Verdict
from uncal.recordings.frame import Frame

LEVELS = {"ok": "INFO", "drifting": "WARN", "recalibrate": "ERROR", "untrusted": "WARN"}
"""Verdict → level of the viewer's text log."""


class RerunRecording:
    """Image, edges as the extrinsic in use and as the estimate puts them, sweep and curves.

    Args:
        path: the .rrd file.
        reader: has the frames' edges.

    Raises:
        ConfigurationError: rerun is not installed.
    """

    def __init__(self, path: Path, reader: EvidenceReader) -> None:
        try:
            self.rr: Any = import_module("rerun")
        except ImportError as error:
            raise ConfigurationError(
                f"rerun=true: the rerun SDK is not installed ({error}): pip install 'uncal[rerun]'"
            ) from error
        self.reader = reader
        self.stream: Any = self.rr.RecordingStream("uncal.monitor")
        path.parent.mkdir(parents=True, exist_ok=True)
        self.stream.save(str(path))

    def keep(self, number: int, frame: Frame | None, verdict: Verdict) -> None:
        """Log a frame and what is said of it.

        Args:
            number: of the frame in the stream.
            frame: None: it could not be read.
            verdict: of the frame.
        """
        rr, stream = self.rr, self.stream
        stream.set_time("frame", sequence=number)
        level = getattr(rr.TextLogLevel, LEVELS[verdict.verdict])
        stream.log("verdict", rr.TextLog(f"{verdict.verdict}: {verdict.reason}", level=level))
        for part in ("correction", "lower", "upper"):
            for dof, value in zip(DOF_NAMES, getattr(verdict, part) * DOF_SCALE, strict=True):
                if np.isfinite(value):
                    stream.log(f"{dof}/{part}", rr.Scalars(value))
        sample = self.reader.sample
        if frame is None or sample is None or sample.frame != frame.id:
            return
        stream.log("camera/image", rr.Image(shown(frame, sample, self.reader)))
        edges, K = sample.edges.numpy()[:, :3].astype(float), sample.K.double().numpy()
        T_before = sample.T_cam_lidar.double().numpy()
        after = after_step(T_before, verdict.correction)
        for name, T, colour in (
            ("in use", T_before, (220, 60, 60)),
            ("corrected", after, (60, 200, 90)),
        ):
            q = edges @ T[:3, :3].T + T[:3, 3]
            q = q[q[:, 2] > 0.5] @ K.T
            pixels = q[:, :2] / q[:, 2:]
            stream.log(f"camera/image/edges {name}", rr.Points2D(pixels, colors=colour))
        stream.log("sweep", rr.Points3D(frame.points[::4, :3]))

    def close(self) -> None:
        """Write what is waiting."""
        self.stream.flush()
        self.stream.disconnect()
