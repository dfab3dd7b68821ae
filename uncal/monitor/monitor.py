"""The monitor as a library: one frame in, one verdict out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import NormalDist

import numpy as np
import torch
from numpy.typing import NDArray

from uncal.errors import ConfigurationError, FrameError
from uncal.geometry.transforms import matrix_to_pose
from uncal.monitor.adaptive import Quantiles, make_quantiles, scores_of
from uncal.monitor.alarm import Alarm
from uncal.monitor.decision import Interval, decide
from uncal.monitor.evidence import Estimate, Evidence, EvidenceReader
from uncal.monitor.extrinsic import Change, ExtrinsicInUse, after_step
from uncal.monitor.known_good import (
    level_of_drifts,
    own_calibrator,
    references_of,
    without_references,
)
from uncal.monitor.pairing import PairingCheck
from uncal.monitor.references import FLOOR, SIMULATED, References
from uncal.monitor.settings import MonitorSettings
from uncal.monitor.statistics import SensorCheck
from uncal.monitor.verdict import OK, UNTRUSTED, Verdict
from uncal.monitor.window import RECENT, Window
from uncal.recordings.frame import Frame, FrameId
from uncal.recordings.static_transform import StaticTransform
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.weights.shipped import find_weights

Vector = NDArray[np.float64]


class Monitor:
    """Watches the extrinsic of one rig, frame by frame.

    Args:
        weights: name or file of shipped weights, or a checkpoint of ``uncal.train`` (.ckpt).
        references: what the windowed estimator was calibrated on: a file that ``calibrate=`` wrote,
            or References; None: the file beside the weights (``NAME.monitor.npz``), and where there
            is none the weights' own calibration, which is of single frames.
        settings: None: those of conf/monitor.yaml.
        device: where the network runs; ``auto``: a GPU if there is one.

    Attributes:
        settings: as used; ``window`` is 1 without references, and ``update.apply`` is decided.
        notes: sentences that a user must know.

    Raises:
        ConfigurationError: weights or references cannot be used.
    """

    def __init__(
        self,
        weights: str | Path,
        *,
        references: str | Path | References | None = None,
        settings: MonitorSettings | None = None,
        device: str = "auto",
    ) -> None:
        settings = MonitorSettings.shipped() if settings is None else settings
        path = find_weights(str(weights))
        where = "cuda" if device == "auto" and torch.cuda.is_available() else device
        self.reader = EvidenceReader(
            path, torch.device("cpu" if where == "auto" else where), settings.seed
        )
        self.notes: list[str] = []
        self.references = references_of(references, path, self.reader, settings)
        self.reader.counts_start = self.references is not None
        if self.references is None:
            self.notes.append(without_references(path))
            settings = replace(settings, window=1)
            calibrators: list[IntervalCalibrator] = [own_calibrator(self.reader, path)]
        else:
            self.references.check_level(settings.level, settings.exchangeable)
            calibrators = list(self.references.calibrators(settings.exchangeable))
            level, note = level_of_drifts(settings, self.references)
            settings = replace(settings, drift=replace(settings.drift, level=level))
            self.notes += [] if note is None else [note]
        simulated = self.references is None or self.references.label.startswith(SIMULATED)
        if settings.update.apply is None:
            settings = replace(settings, update=replace(settings.update, apply=not simulated))
        if self.references is not None and simulated:
            self.notes.append(
                "The references are of simulated rigs: on real frames intervals are too narrow and "
                "drifts may be found where there are none. python -m uncal.monitor "
                "calibrate=FOLDER makes references from recordings with trusted extrinsics; until "
                "then the extrinsic in use moves only with update.apply=true."
            )
        self.settings = settings
        self.quantiles: Quantiles = make_quantiles(settings.adapt, calibrators, settings.level)
        self.drift = make_quantiles(settings.adapt, calibrators, settings.drift.level)
        self.window = Window(settings.window, settings.forgetting)
        self.check = SensorCheck(settings.sensors)
        self.pairing = PairingCheck(settings.sensors.pairing)
        self.alarm = (
            None
            if self.references is None
            else Alarm(self.references.windows, settings.alarm, settings.seed)
        )
        self.rig: str | None = None
        self.drive: str | None = None
        self.in_use: ExtrinsicInUse | None = None

    @property
    def extrinsic(self) -> Vector:
        """(4, 4) T_cam_lidar in use.

        Raises:
            ConfigurationError: before the first frame.
        """
        return np.array(self._extrinsic.current)

    @property
    def history(self) -> list[Change]:
        """Changes of the extrinsic in use, oldest first."""
        return [] if self.in_use is None else list(self.in_use.history)

    def update(self, frame: Frame, reference: Vector | None = None) -> Verdict:
        """Take in the next frame of the stream.

        Args:
            frame: its ``T_cam_lidar`` is the nominal extrinsic, which the monitor begins with at
                the first frame of a rig; later it goes by the extrinsic in use.
            reference: (4, 4) true extrinsic, where one arrives; adjusts the intervals (``adapt``).

        Returns:
            What is to be said of it; an unusable frame is ``untrusted`` and adds no evidence.
        """
        self._meet(frame.id, frame.T_cam_lidar)
        doubts = []
        evidence: Evidence | None = None
        fault = self.check.fault(frame)
        if fault is None:
            try:
                evidence = self.reader.evidence(
                    frame, self._extrinsic.current, self.settings.sensors
                )
            except FrameError as error:
                fault = str(error)
        if fault is not None:
            doubts.append(fault)
        elif evidence is not None:
            doubts += self._unlike(evidence)
        self.window.add(evidence, trusted=not doubts)
        if self.references is not None and not doubts and evidence is not None:
            self._forget_what_is_contradicted(self.references.jump)
        return self._say(str(frame.id), frame.time, doubts, reference)

    def missing(self, frame_id: FrameId, reason: str, time: float = float("nan")) -> Verdict:
        """Take in that a frame of the stream could not be read.

        Args:
            frame_id: which.
            reason: for people.
            time: of the frame, seconds.

        Returns:
            ``untrusted``; before the first readable frame with an extrinsic of NaN.
        """
        if (frame_id.rig, frame_id.drive) != (self.rig, self.drive):
            self._begin_drive()
        self.window.add(None)
        return self._say(str(frame_id), time, [reason], None)

    def revert(self, changes: int = 1) -> Vector:
        """Take back the last changes of the extrinsic in use, and forget the window.

        Args:
            changes: how many.

        Returns:
            (4, 4) T_cam_lidar in use from now on.

        Raises:
            ConfigurationError: there are not so many.
        """
        self._extrinsic.revert("revert", changes)
        self.window.clear()
        return self.extrinsic

    def static_transform(self) -> StaticTransform | None:
        """The extrinsic as it is estimated now, for ROS; None without evidence.

        The covariance has the solver's correlations, and the size that the intervals say: a normal
        law with such intervals at their level.
        """
        n = len(self.window)
        if n == 0:
            return None
        prior = None if self.references else self.window.entries[-1].evidence.prior
        estimate = self.reader.solve(self.window.total(), prior)
        half = self.quantiles.of(n)[:6]
        if not np.isfinite(half).all():
            return None
        scale = half / NormalDist().inv_cdf((1 + self.settings.level) / 2)
        about = (
            f"Estimate of uncal.monitor at the last of {n} frame(s) of {self.rig}/{self.drive}; "
            f"covariance of a normal law with its {self.settings.level:.0%} intervals."
        )
        T = after_step(self.extrinsic, estimate.mean)
        return StaticTransform(T, estimate.covariance * np.outer(scale, scale), about)

    @property
    def _extrinsic(self) -> ExtrinsicInUse:
        if self.in_use is None:
            raise ConfigurationError("the monitor has not seen a frame yet: call update first")
        return self.in_use

    def _meet(self, frame_id: FrameId, nominal: Vector) -> None:
        """Begin anew with another rig, and with an empty window in another drive."""
        if frame_id.rig != self.rig:
            self.in_use = ExtrinsicInUse(nominal, self.settings.update)
        if (frame_id.rig, frame_id.drive) != (self.rig, self.drive):
            self._begin_drive()
        self.rig, self.drive = frame_id.rig, frame_id.drive

    def _begin_drive(self) -> None:
        self.window.clear()
        self.pairing.clear()
        if self.in_use is not None:
            self.in_use.agreed = 0

    def _unlike(self, evidence: Evidence) -> list[str]:
        """What of a frame is unlike the references, or wrongly paired."""
        found = [self.reader.doubt(self.pairing, evidence, self._extrinsic.current)]
        if self.references is not None:
            margin = self.settings.sensors.margin
            found.append(self.references.unlike(evidence.statistics, margin))
        return [reason for reason in found if reason is not None]

    def _forget_what_is_contradicted(self, usual: float) -> None:
        """After a step the window is a mixture of both sides of it, and of use for neither."""
        if usual > 0 and self.window.jump() > self.settings.drift.jump * usual:
            self.window.keep_last(RECENT)

    def _say(self, name: str, time: float, doubts: list[str], reference: Vector | None) -> Verdict:
        interval = drift = Interval.unknown()
        sigma = np.full(6, np.inf)
        n = len(self.window)
        if n > 0:
            # The weights' own calibration is of what the module estimates, prior included.
            prior = None if self.references else self.window.entries[-1].evidence.prior
            estimate = self.reader.solve(self.window.total(), prior)
            sigma = estimate.std
            interval = Interval.around(estimate.mean, sigma, self.quantiles.of(n))
            drift = Interval.around(estimate.mean, sigma, self.drift.of(n))
            if self.alarm is not None:
                self.alarm.watch(self.window, estimate, self.reader)
            if reference is not None:
                self._learn(estimate, n, reference)
        if self.alarm is not None and self.alarm.reason is not None:
            doubts = [*doubts, self.alarm.reason]
        verdict, reason = decide(
            interval,
            self.settings.limits,
            drift,
            self.settings.drift,
            doubts,
            n,
            self.settings.window,
        )
        full = n == self.settings.window
        # Not on what is no drift: a region may exclude zero and still come next to it.
        trusted = verdict not in (OK, UNTRUSTED) and self.window.trusted and full
        step = None
        if self.in_use is not None:
            step = self.in_use.consider(name, drift, trusted)
        if step is not None:
            self.window.rebase(self.reader, step)
        return Verdict(
            frame=name,
            time=time,
            correction=interval.correction,
            lower=interval.lower,
            upper=interval.upper,
            sigma=sigma,
            joint_lower=interval.joint_lower,
            joint_upper=interval.joint_upper,
            verdict=verdict,
            reason=reason,
            extrinsic=np.full((4, 4), np.nan) if self.in_use is None else self.extrinsic,
            updated=step is not None,
            frames=n,
            wealth=1.0 if self.alarm is None else self.alarm.martingale.wealth,
        )

    def _learn(self, estimate: Estimate, frames: int, reference: Vector) -> None:
        D = np.linalg.inv(reference) @ self._extrinsic.current
        truth = matrix_to_pose(torch.from_numpy(D)).numpy()
        scores = scores_of(estimate.mean, estimate.std, truth, FLOOR)
        for quantiles in (self.quantiles, self.drift):
            quantiles.observe(frames, scores)
