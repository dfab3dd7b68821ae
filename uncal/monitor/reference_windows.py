"""References of the monitor in the making, frame by frame.

Every stretch of ``window`` consecutive frames is decalibrated at random, and the windowed estimator
itself is run on it, exactly as on a stream.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from uncal.errors import FrameError, RecordingError
from uncal.geometry.transforms import pose_to_matrix
from uncal.monitor.evidence import Estimate, EvidenceReader
from uncal.monitor.references import References, fingerprint
from uncal.monitor.settings import MonitorSettings
from uncal.monitor.statistics import SensorCheck
from uncal.monitor.window import Window
from uncal.recordings.frame import Frame, FrameId, Recording
from uncal.system.progress import watched

log = logging.getLogger(__name__)

Vector = NDArray[np.float64]


def make_references(
    recording: Recording, reader: EvidenceReader, settings: MonitorSettings, label: str
) -> References:
    """Run the windowed estimator over recordings whose extrinsic is trusted.

    Args:
        recording: of them.
        reader: the weights.
        settings: of the monitor.
        label: which recordings, for people.

    Returns:
        The references; what is left of a drive after its last full window is not used.

    Raises:
        RecordingError: no drive has a full window of usable frames.
    """
    windows = ReferenceWindows(reader, settings)
    for frame_id in watched(recording.frame_ids, "references"):
        try:
            windows.take(frame_id, recording.load(frame_id))
        except FrameError as error:
            windows.take(frame_id, error)
    return windows.references(label)


class ReferenceWindows:
    """References in the making, frame by frame.

    Args:
        reader: the weights.
        settings: of the monitor.
    """

    def __init__(self, reader: EvidenceReader, settings: MonitorSettings) -> None:
        self._reader = reader
        self._settings = settings
        self._check = SensorCheck(settings.sensors)
        self._stretches: list[_Stretch] = []
        self._seen = self._skipped = 0

    def take(self, frame_id: FrameId, frame: Frame | FrameError) -> None:
        """Add the next frame of the recordings, or why it cannot be read."""
        self._seen += 1
        last = self._stretches[-1] if self._stretches else None
        if last is None or last.full or last.drive != f"{frame_id.rig}/{frame_id.drive}":
            self._stretches = [stretch for stretch in self._stretches if stretch.full]
            self._stretches.append(last := _Stretch(frame_id, self._reader, self._settings))
        try:
            if isinstance(frame, FrameError):
                raise frame
            fault = self._check.fault(frame)
            if fault is not None:
                raise FrameError(fault)
            last.take(frame)
        except FrameError as error:
            log.warning("skipped %s: %s", frame_id, error)
            self._skipped += 1

    def references(self, label: str) -> References:
        """Those of all full windows; ``label`` says which recordings, for people.

        Raises:
            RecordingError: there is none.
        """
        full = [stretch for stretch in self._stretches if stretch.full]
        if not full:
            raise RecordingError(
                f"calibrate: no drive has window={self._settings.window} usable frames "
                f"({self._seen} frames, {self._skipped} of them skipped)"
            )
        return References(
            made_with=fingerprint(self._reader, self._settings),
            label=label,
            drives=[stretch.drive for stretch in full],
            error=np.stack([stretch.error for stretch in full]),
            std=np.stack([stretch.std for stretch in full]),
            frames=np.stack([stretch.frames for stretch in full]),
            windows=np.stack([stretch.window_statistics for stretch in full]),
            jumps=np.array([stretch.jump for stretch in full]),
        )


class _Stretch:
    """Consecutive frames of a drive under one decalibration, until a window is full.

    Args:
        first: its first frame.
        reader: the weights.
        settings: of the monitor.
    """

    def __init__(self, first: FrameId, reader: EvidenceReader, settings: MonitorSettings) -> None:
        self.drive = f"{first.rig}/{first.drive}"
        self.decalibration = reader.range.draw_for(settings.seed, str(first))
        self.reader = reader
        self.settings = settings
        self.window = Window(settings.window, settings.forgetting)
        self.estimates: list[Estimate] = []
        self.seen: list[Vector] = []
        self.window_statistics = np.empty(0)
        self.jump = 0.0

    @property
    def full(self) -> bool:
        """Whether it has all its frames."""
        return len(self.estimates) == self.settings.window

    @property
    def error(self) -> Vector:
        """(W, 6)."""
        truth = self.decalibration.double().numpy()
        return np.stack([estimate.mean - truth for estimate in self.estimates])

    @property
    def std(self) -> Vector:
        """(W, 6)."""
        return np.stack([estimate.std for estimate in self.estimates])

    @property
    def frames(self) -> Vector:
        """(W, K)."""
        return np.stack(self.seen)

    def take(self, frame: Frame) -> None:
        """Add a frame's evidence.

        Args:
            frame: the next usable one.

        Raises:
            FrameError: it is not usable.
        """
        D = pose_to_matrix(self.decalibration.double()).numpy()
        evidence = self.reader.evidence(frame, frame.T_cam_lidar @ D, self.settings.sensors)
        self.window.add(evidence)
        self.jump = max(self.jump, self.window.jump())
        estimate = self.reader.solve(self.window.total())
        self.estimates.append(estimate)
        self.seen.append(evidence.statistics)
        if self.full:
            self.window_statistics = self.window.statistics(estimate, self.reader)
            self.window.clear()
