"""A run folder, read whole: results, record, and what it does not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from uncal.errors import UncalError
from uncal.geometry import DOF_NAMES, DOF_SCALE
from uncal.reporting.comparison.record import UNKNOWN, Record, read_record
from uncal.reporting.conditional_rows import ConditionalRow
from uncal.reporting.control_rows import ControlRow
from uncal.reporting.csv_rows import Row, read_rows
from uncal.reporting.curve_rows import CurveRow
from uncal.reporting.joint_rows import JointRow
from uncal.reporting.multirun_jobs import FAILED
from uncal.reporting.prediction_rows import read_predictions
from uncal.reporting.rows import ResultRow, Summary, summarise

_OFFERS: Mapping[str, str] = {
    "run.json": "command, commit and what was reused",
    "joint.csv": "the joint coverage",
    "conditional.csv": "the coverage by σ and by size of the decalibration",
    "calibration_curve.csv": "the calibration curve",
    "control.csv": "the image-blind control and the error without dropout",
    "predictions.csv": "the error of the whole pose and the ordered intervals",
}
"""What a run may lack, and what the report then cannot say."""


@dataclass(frozen=True)
class Run:
    """One run to put beside the paper.

    Attributes:
        name: such as "Run 2" or "Run 3, job 0", by which tables refer to it.
        told_by: what tells it from other jobs of its multirun, such as "mcd.passes=5".
        folder: where it is.
        record: what it was.
        rows: of results.csv.
        joint: of joint.csv; empty, as all that follow, if the file is not there.
        conditional: of conditional.csv.
        curve: of calibration_curve.csv.
        control: of control.csv.
        whole: errors of the whole pose, from predictions.csv; None without it.
        missing: one sentence for each file that is not there.
    """

    name: str
    told_by: str
    folder: Path
    record: Record
    rows: tuple[ResultRow, ...]
    joint: tuple[JointRow, ...]
    conditional: tuple[ConditionalRow, ...]
    curve: tuple[CurveRow, ...]
    control: tuple[ControlRow, ...]
    whole: Summary | None
    missing: tuple[str, ...]

    @property
    def label(self) -> str:
        """What the data are."""
        return self.record.label or f"data {UNKNOWN}"

    @property
    def source(self) -> str:
        """Name, data and method in one cell."""
        told = f" ({self.told_by})" if self.told_by else ""
        return f"{self.name}{told}: {self.label}; {self.record.method}"

    @property
    def made_by(self) -> str:
        """The command that made the run, its seed, commit and data."""
        command = self.record.command
        made = command or f"command {UNKNOWN} (no run.json, as of earlier versions)"
        seed = self.record.seed or UNKNOWN
        commit = self.record.commit or UNKNOWN
        return f"{self.name}: {made} · seed {seed} · commit {commit} · {self.label}"


def read_run_folder(folder: Path, name: str, told_by: str = "") -> Run:
    """Read what a run has left; only results.csv must be there.

    Args:
        folder: of the run.
        name: to refer to it by.
        told_by: what tells it from other jobs of its multirun.

    Raises:
        UncalError: there are no results, or a file is damaged.
    """
    if (folder / FAILED).is_file():
        reason = " ".join((folder / FAILED).read_text(encoding="utf-8").split())
        raise UncalError(
            f"{folder}: this run failed ({reason}), so it has nothing to compare. Run it again, "
            "or leave it out."
        )
    if not (folder / "results.csv").is_file():
        raise UncalError(
            f"{folder}: no results.csv, so this is no folder of a finished run. Expected a folder "
            "that python -m uncal.train or uncal.evaluate has written and named at its end, or a "
            "multirun's folder with such folders in it."
        )
    record = read_record(folder)
    missing = [file for file in _OFFERS if not (folder / file).is_file()]
    if not record.recorded and "run.json" not in missing:
        missing.insert(0, "run.json that can be read")
    rows = read_rows(folder / "results.csv", ResultRow)
    return Run(
        name=name,
        told_by=told_by,
        folder=folder,
        record=record,
        rows=rows,
        joint=_optional(folder / "joint.csv", JointRow),
        conditional=_optional(folder / "conditional.csv", ConditionalRow),
        curve=_optional(folder / "calibration_curve.csv", CurveRow),
        control=_optional(folder / "control.csv", ControlRow),
        whole=_whole(folder / "predictions.csv", rows),
        missing=tuple(f"no {file}, hence without {_OFFERS[file.split()[0]]}" for file in missing),
    )


def _optional(path: Path, kind: type[Row]) -> tuple[Row, ...]:
    return read_rows(path, kind) if path.is_file() else ()


def _whole(path: Path, rows: Sequence[ResultRow]) -> Summary | None:
    """Length and angle of the errors, which need all six DoF of each frame."""
    if not path.is_file():
        return None
    predictions = read_predictions(path)
    scale = torch.tensor(DOF_SCALE, dtype=torch.float64)
    truth, estimate = (
        torch.tensor(values, dtype=torch.float64).reshape(-1, len(DOF_NAMES)) / scale
        for values in (
            [row.truth for row in predictions],
            [row.estimate for row in predictions],
        )
    )
    return summarise(estimate, truth, rows[0].n_calibration)
