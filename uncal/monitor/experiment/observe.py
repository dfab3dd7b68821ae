"""A monitor, and plainer watchers beside it, on the frames of one drive: a row per frame."""

from __future__ import annotations

import copy
import hashlib
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from uncal.geometry.transforms import DOF_NAMES, matrix_to_pose
from uncal.monitor.evidence import Evidence, EvidenceReader
from uncal.monitor.experiment.cases import Case, Drive
from uncal.monitor.extrinsic import after_step
from uncal.monitor.monitor import Monitor
from uncal.monitor.verdict import DRIFTING, RECALIBRATE, UNTRUSTED, Verdict
from uncal.recordings.frame import Frame

Vector = NDArray[np.float64]
Row = dict[str, object]

VECTORS: tuple[str, ...] = ("nominal", "before", "after", "inside", "single", "mean")
"""Of six columns each, ``<name> <DoF>``:

nominal, before, after: decalibration, metres and radians, of the nominal extrinsic and of the one
in use before and after the frame; inside: whether ``before`` lies in the monitor's interval;
single, mean: the decalibration of the nominal extrinsic as the frame alone estimates it, and the
mean of the last ones."""


class RememberingReader(EvidenceReader):
    """Reads no frame twice under one extrinsic: cases share streets, and watchers frames.

    Args:
        reader: the weights.

    Attributes:
        last: the evidence asked for last; None after :meth:`forget_last`.
    """

    def __init__(self, reader: EvidenceReader) -> None:
        vars(self).update(vars(reader))
        self.kept: dict[bytes, Evidence] = {}
        self.last: Evidence | None = None

    def evidence(self, frame: Frame, T_assumed: Vector, *rest: object) -> Evidence:
        """As the reader's own."""
        digest = hashlib.blake2b(str(frame.id).encode())
        for array in (frame.points, frame.image, T_assumed):
            digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
        key = digest.digest()
        if key not in self.kept:
            self.kept[key] = super().evidence(frame, T_assumed, *rest)  # type: ignore[arg-type]
        self.last = self.kept[key]
        return self.last


def fresh(monitor: Monitor, apply: bool = True) -> Monitor:
    """A monitor that has seen nothing, with the weights of another.

    Args:
        monitor: that has seen nothing either.
        apply: whether it may move the extrinsic in use.
    """
    shared = (monitor.reader, monitor.references)
    made = copy.deepcopy(monitor, {id(part): part for part in shared})
    update = replace(monitor.settings.update, apply=apply)
    made.settings = replace(monitor.settings, update=update)
    return made


def observe(
    monitor: Monitor, drive: Drive, case: Case, frames: Iterable[Frame], watcher: str
) -> Iterator[Row]:
    """Run a monitor over a drive.

    The plainer watchers get the same evidence: the frame alone, solved under the prior.

    Args:
        monitor: a fresh one, with a :class:`RememberingReader`.
        drive: for the truth.
        case: for the names.
        frames: as the monitor gets them.
        watcher: name of the monitor.

    Yields:
        What the columns say; without evidence, the plainer watchers' are NaN.
    """
    reader = monitor.reader
    assert isinstance(reader, RememberingReader)
    recent: deque[Vector] = deque(maxlen=monitor.settings.window)
    nominal = drive.frames[0].T_cam_lidar
    in_use = nominal
    for number, (frame, truth) in enumerate(zip(frames, drive.truth, strict=True)):
        reader.last = None
        said = monitor.update(frame)
        single = np.full(6, np.nan)
        if reader.last is not None:
            estimate = after_step(in_use, reader.solve(reader.last.equations).mean)
            single = decalibration_of(nominal, estimate)
            recent.append(single)
        before = decalibration_of(in_use, truth)
        vectors = {
            "nominal": decalibration_of(nominal, truth),
            "before": before,
            "after": decalibration_of(said.extrinsic, truth),
            "inside": (said.lower <= before) & (before <= said.upper),
            "single": single,
            "mean": np.mean(recent, axis=0) if recent else np.full(6, np.nan),
        }
        joint = (said.joint_lower <= before) & (before <= said.joint_upper)
        in_use = said.extrinsic
        yield {
            **{"watcher": watcher, "kind": case.kind, "case": case.name, "dof": case.dof},
            **{"size": case.size, "drive": drive.name, "number": number},
            **{"verdict": said.verdict, "reason": said.reason, "updated": said.updated},
            **{"full": said.frames == monitor.settings.window, "joint": bool(joint.all())},
            "alarm": says_moved(said, monitor.settings.limits.correction),
            "untrusted": said.verdict == UNTRUSTED,
            **{
                f"{name} {dof}": values[j]
                for name, values in vectors.items()
                for j, dof in enumerate(DOF_NAMES)
            },
        }


def says_moved(said: Verdict, limit: Vector) -> bool:
    """Whether a verdict says that the extrinsic in use is wrong, and not only uncertain.

    Args:
        said: of one frame.
        limit: (6,) largest correction.
    """
    beyond = bool((np.abs(said.correction) > limit).any())
    return said.verdict == DRIFTING or (said.verdict == RECALIBRATE and beyond)


def decalibration_of(T_assumed: Vector, T_true: Vector) -> Vector:
    """(6,) D of ``T_assumed = T_true · D``, metres and radians.

    >>> decalibration_of(np.eye(4), np.eye(4)).tolist()
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """
    D = torch.from_numpy(np.linalg.inv(T_true) @ T_assumed)
    return np.asarray(matrix_to_pose(D).numpy() + 0.0)


def exchanged(drive: Drive, other: Drive) -> list[Frame]:
    """A drive with the images of another one: what no camera can have helped with.

    Args:
        drive: that is to be watched.
        other: as long.
    """
    return [
        replace(frame, image=elsewhere.image, events=elsewhere.events)
        for frame, elsewhere in zip(drive.frames, other.frames, strict=True)
    ]
