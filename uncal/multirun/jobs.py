"""The jobs of a Hydra multirun, read back from the folders that they left."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import yaml  # type: ignore[import-untyped]

from uncal.errors import UncalError
from uncal.reporting.frames import CONTROL, JOINT, RESULTS, read_csv, read_numbers
from uncal.reporting.run import FAILED
from uncal.reporting.run_record import NAME, read_record

if TYPE_CHECKING:
    import pandas as pd

UNFINISHED = "no results.csv: still running, interrupted, or without callbacks.report"

REPLICATES = {"seed": "seeds", "mcd.seed": "mask seeds"}
"""Keys whose values repeat an experiment instead of changing it, and what those are called."""

STATE = (RESULTS.file, JOINT.file, CONTROL.file, NAME, FAILED, ".hydra/overrides.yaml")
"""The files of a job that a summary depends on."""


@dataclass(frozen=True)
class Job:
    """One job of a multirun.

    Attributes:
        folder: the job's, relative to the multirun's.
        overrides: key → value, as on a command line; without the keys of Hydra itself.
        table: its results.csv, beside each row that of joint.csv (by level) and of control.csv (by
            DoF) where there are such files; None without results.
        failure: why there are no results; None if there are.
        record: content of run.json; empty without one that can be read.
        failed: whether the job raised; a job without results that did not may be running.
    """

    folder: str
    overrides: Mapping[str, str]
    table: pd.DataFrame | None = None
    failure: str | None = None
    record: Mapping[str, object] = field(default_factory=dict)
    failed: bool = False

    @property
    def label(self) -> str | None:
        """What the data are."""
        label = self.record.get("label")
        return str(label) if label else None

    @property
    def seed(self) -> str | None:
        """The run's."""
        seed = self.record.get("seed", self.overrides.get("seed"))
        return None if seed is None else str(seed)

    @property
    def mask_seed(self) -> str | None:
        """``mcd.seed`` if it was set; else it follows the seed."""
        return self.overrides.get("mcd.seed")

    @property
    def weights(self) -> Mapping[str, object]:
        """Fingerprint of the trained weights, and whether they were found instead of trained."""
        weights = self.record.get("weights")
        return weights if isinstance(weights, dict) else {}


def read_jobs(folder: Path) -> list[Job]:
    """All jobs below a multirun's folder, in the order of their folders' numbers.

    Files may be missing or half there, because other processes are at work on them: a job then
    counts as unfinished, and the next summary, after the change, has it right.

    Returns:
        Finished, failed and unfinished jobs; a folder without Hydra's record is no job's.
    """
    return [_read_job(path, path.relative_to(folder).as_posix()) for path in job_folders(folder)]


def job_folders(folder: Path) -> list[Path]:
    """Where jobs are, in the order of their numbers."""
    records = folder.glob("**/.hydra/overrides.yaml")
    return sorted((path.parent.parent for path in records), key=_numbers_as_numbers)


def swept_keys(jobs: Sequence[Job]) -> tuple[str, ...]:
    """The overrides whose value differs between the jobs, without :data:`REPLICATES`, in order.

    >>> swept_keys([Job(n, {"a": n, "b": "1"}) for n in ("0", "1")])
    ('a',)
    """
    keys = dict.fromkeys(key for job in jobs for key in job.overrides if key not in REPLICATES)
    return tuple(key for key in keys if len({job.overrides.get(key) for job in jobs}) > 1)


def as_mapping(overrides: Iterable[object]) -> dict[str, str]:
    """Overrides as key → value.

    >>> as_mapping(["+sweeps=passes", "mcd.passes=5", "~logger"])
    {'sweeps': 'passes', 'mcd.passes': '5', 'logger': ''}
    """
    pairs = (str(item).partition("=") for item in overrides)
    return {key.lstrip("+~"): value for key, _, value in pairs}


def _numbers_as_numbers(path: Path) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", path.as_posix())
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def _read_job(path: Path, folder: str) -> Job:
    overrides = _overrides(path / ".hydra" / "overrides.yaml")
    record = read_record(path) or {}
    if (path / FAILED).is_file():  # it may have results of an earlier attempt
        reason = " ".join((path / FAILED).read_text(encoding="utf-8").split())
        reason = reason or "for a reason unknown"
        return Job(folder, overrides, failure=reason, record=record, failed=True)
    if not (path / RESULTS.file).is_file():
        return Job(folder, overrides, failure=UNFINISHED, record=record)
    try:
        return Job(folder, overrides, _results(path), record=record)
    except UncalError as error:
        return Job(folder, overrides, failure=str(error), record=record)


def _results(path: Path) -> pd.DataFrame:
    table = read_csv(path / RESULTS.file, RESULTS)
    for schema, key in ((JOINT, "level"), (CONTROL, "dof")):
        if (path / schema.file).is_file():
            text = ("dof", "unit", "groups", "joint_in_band")
            other = read_numbers(path / schema.file, text)
            new = [name for name in other.columns if name == key or name not in table.columns]
            table = table.merge(other[new], on=key, how="left")
    return table


def _overrides(path: Path) -> dict[str, str]:
    try:
        listed = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError):  # Hydra is writing it just now
        listed = None
    return as_mapping(listed or [])
