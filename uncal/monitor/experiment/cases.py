"""What is put before the monitor: drives at rest, drives in which the LiDAR moves, faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import cast

import numpy as np
from hydra.utils import instantiate
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf

from uncal.errors import ConfigurationError
from uncal.geometry.transforms import DOF_NAMES
from uncal.recordings.frame import Frame
from uncal.recordings.kitti import KittiRaw
from uncal.simulation.faults import Fault
from uncal.simulation.moved import ensure_moved
from uncal.simulation.sensors.mount_motion import read_truth
from uncal.simulation.settings import MotionSettings, SimulationSettings
from uncal.simulation.writer import ensure_simulated

STILL, STEP, FAULT, BLIND = "still", "step", "fault", "blind"

KEYS: tuple[str, ...] = tuple(f"{name.lower()}_cm" for name in DOF_NAMES[:3]) + tuple(
    f"{name.lower()}_deg" for name in DOF_NAMES[3:]
)
"""Keys of ``simulation.motion`` in the order of the DoF."""


@dataclass(frozen=True)
class Case:
    """One condition.

    Attributes:
        kind: still, step, fault, or the name of another motion.
        name: unique; also of the folder of its recordings.
        drives: how many.
        dof: of a step: which DoF; empty without.
        size: of a step: centimetres or degrees.
        motion: of the LiDAR; None: at rest.
        fault: of the stream; None: none.
    """

    kind: str
    name: str
    drives: int
    dof: str = ""
    size: float = 0.0
    motion: MotionSettings | None = None
    fault: Fault | None = None


@dataclass(frozen=True)
class Drive:
    """One drive of a case, loaded.

    Attributes:
        name: of its folder; drives of one name show the same street in all cases.
        frames: in order, without the fault; their extrinsic is the nominal one.
        truth: (F, 4, 4) true T_cam_lidar.
    """

    name: str
    frames: list[Frame]
    truth: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ExperimentSettings:
    """The group ``experiment`` of sweeps/monitor.yaml, which says what each key means."""

    root: str
    workers: int | None
    frames: int
    onset: int
    limit_cm: float
    limit_deg: float
    drives: Mapping[str, int]
    step_cm: list[float]
    step_deg: list[float]
    motions: Mapping[str, Mapping[str, float]]
    faults: Mapping[str, Mapping[str, object]]
    simulation: SimulationSettings

    @classmethod
    def of(cls, config: DictConfig) -> ExperimentSettings:
        """Read the group.

        Args:
            config: ``experiment``.

        Raises:
            ConfigurationError: a key is missing or unknown, or a value out of its range.
        """
        plain = cast("dict[str, object]", OmegaConf.to_container(config, resolve=True))
        names = [field.name for field in fields(cls)]
        if wrong := [*set(plain).symmetric_difference(names)]:
            raise ConfigurationError(
                f"experiment.{min(wrong)}: the experiment takes exactly {', '.join(names)}"
            )
        street = cast("dict[str, object]", plain.pop("simulation"))
        settings = cls(**plain, simulation=SimulationSettings.from_mapping(street))  # type: ignore[arg-type]
        settings._check()
        return settings

    def cases(self) -> list[Case]:
        """All of them; those at rest first, since they share most with the others."""
        made = [Case(STILL, STILL, self.drives[STILL])]
        for dof, key in zip(DOF_NAMES, KEYS, strict=True):
            for size in self.step_cm if key.endswith("cm") else self.step_deg:
                motion = self._motion({key: size})
                name = f"step_{key}_{size:g}"
                made.append(Case(STEP, name, self.drives[STEP], dof, float(size), motion))
        for name, keys in self.motions.items():
            made.append(Case(name, name, self.drives["motion"], motion=self._motion(keys)))
        for name, target in self.faults.items():
            fault = instantiate(dict(target), first=self.onset, last=self.frames - 1)
            made.append(Case(FAULT, name, self.drives[FAULT], fault=fault))
        return made

    def recorded(self, case: Case, number: int) -> Drive:
        """A drive of a case; its recordings are simulated if they are not there yet.

        Args:
            case: one of :meth:`cases`.
            number: of the drive, below ``case.drives``.
        """
        still = replace(self.simulation, n_rigs=self.drives[STILL])
        root = ensure_simulated(still, Path(self.root) / STILL, self.workers)
        if case.motion is not None:
            moving = replace(self.simulation, n_rigs=case.drives, motion=case.motion)
            root = ensure_moved(moving, root, Path(self.root) / case.name)
        recording = KittiRaw(root)
        places = dict.fromkeys((frame_id.rig, frame_id.drive) for frame_id in recording.frame_ids)
        rig, drive = list(places)[number]
        frames = [
            recording.load(frame_id)
            for frame_id in recording.frame_ids
            if (frame_id.rig, frame_id.drive) == (rig, drive)
        ][: self.frames]
        truth = np.stack([frame.T_cam_lidar for frame in frames])
        if case.motion is not None:
            truth = read_truth(root / rig / drive)[: len(frames)]
        return Drive(drive, frames, truth)

    def _motion(self, changes: Mapping[str, float]) -> MotionSettings:
        still = dict.fromkeys((*KEYS, "vibration_cm", "vibration_deg"), 0.0)
        rest = {"first_frame": self.onset, "ramp_frames": 1, "vibration_hz": 7.3}
        return MotionSettings.from_mapping({**still, **rest, **changes})

    def _check(self) -> None:
        needed = {STILL, STEP, "motion", FAULT, BLIND}
        if set(self.drives) != needed:
            raise ConfigurationError(f"experiment.drives takes exactly {', '.join(sorted(needed))}")
        for name, n in self.drives.items():
            if not 1 <= n <= self.drives[STILL]:
                raise ConfigurationError(
                    f"experiment.drives.{name}={n}: expected 1 to experiment.drives.{STILL}"
                    f"={self.drives[STILL]}, whose streets the others share"
                )
        if self.drives[BLIND] < 2 or self.drives[BLIND] > self.drives[STEP]:
            raise ConfigurationError(
                f"experiment.drives.{BLIND}={self.drives[BLIND]}: expected 2 to "
                f"experiment.drives.{STEP}={self.drives[STEP]}; images are exchanged among them"
            )
        if not 1 <= self.onset < self.frames <= self.simulation.frames_per_drive:
            raise ConfigurationError(
                f"experiment.onset={self.onset}, frames={self.frames}: expected 1 <= onset < "
                f"frames <= simulation.frames_per_drive={self.simulation.frames_per_drive}"
            )
