"""The jobs of a Hydra multirun, read back from the folders that they left."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import yaml  # type: ignore[import-untyped]

from uncal.errors import UncalError
from uncal.reporting.frames import CONTROL, JOINT, RESULTS, read_csv
from uncal.reporting.run import FAILED, Run, why_failed
from uncal.reporting.run_record import NAME, read_record

if TYPE_CHECKING:
    import pandas as pd

UNFINISHED = "no results.csv: still running, interrupted, or without callbacks.report"

REPLICATES = {"seed": "seeds", "mcd.seed": "mask seeds"}
"""Keys whose values repeat an experiment instead of changing it, and what those are called."""

STATE = (RESULTS.file, JOINT.file, CONTROL.file, NAME, FAILED, ".hydra/overrides.yaml")
"""The files of a job that a summary depends on."""


@dataclass(frozen=True)
class Job(Run):
    """One job of a multirun, named by its folder relative to the multirun's.

    Attributes:
        overrides: key → value, as on a command line; without the keys of Hydra itself.
        table: its results.csv, beside each row that of joint.csv (by level) and of control.csv (by
            DoF) where there are such files; None without results.
        failure: why there are no results; None if there are.
        failed: whether the job raised; a job without results that did not may be running.
    """

    overrides: Mapping[str, str] = field(default_factory=dict)
    table: pd.DataFrame | None = None
    failure: str | None = None
    failed: bool = False

    @property
    def seed(self) -> str | None:
        """The run's."""
        return self.entry("seed") or self.overrides.get("seed")


def read_jobs(folder: Path) -> list[Job]:
    """All jobs in a multirun's folder, finished or not, in the order of their folders' numbers.

    Files may be missing or half there, because other processes are at work on them: a job then
    counts as unfinished, and the next summary, after the change, has it right.
    """
    return [_read_job(path, path.relative_to(folder).as_posix()) for path in job_folders(folder)]


def job_folders(folder: Path) -> list[Path]:
    """Where jobs are, in the order of their numbers."""
    records = folder.glob("**/.hydra/overrides.yaml")
    return sorted((path.parent.parent for path in records), key=_numbers_as_numbers)


def swept_keys(jobs: Sequence[Job]) -> tuple[str, ...]:
    """The overrides whose value differs between the jobs, without :data:`REPLICATES`, in order.

    >>> swept_keys([Job(Path(n), {}, overrides={"a": n, "b": "1"}) for n in ("0", "1")])
    ('a',)
    """
    keys = dict.fromkeys(key for job in jobs for key in job.overrides if key not in REPLICATES)
    return tuple(key for key in keys if len({job.overrides.get(key) for job in jobs}) > 1)


def shown(overrides: Mapping[str, str], keys: Iterable[str]) -> str:
    """Some overrides in words; those that are not there are left out.

    >>> shown({"mcd.passes": "5", "seed": "1"}, ["mcd.passes", "model", "seed"])
    'mcd.passes=5, seed=1'
    """
    return ", ".join(f"{key}={overrides[key]}" for key in keys if key in overrides)


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


def _read_job(path: Path, name: str) -> Job:
    overrides = _overrides(path / ".hydra" / "overrides.yaml")
    job = Job(path, read_record(path) or {}, name, overrides=overrides)
    if (reason := why_failed(path)) is not None:  # it may have results of an earlier attempt
        return replace(job, failure=reason, failed=True)
    if not (path / RESULTS.file).is_file():
        return replace(job, failure=UNFINISHED)
    try:
        return replace(job, table=_results(path))
    except UncalError as error:
        return replace(job, failure=str(error))


def _results(path: Path) -> pd.DataFrame:
    table = read_csv(path / RESULTS.file, RESULTS)
    for schema, key in ((JOINT, "level"), (CONTROL, "dof")):
        if (path / schema.file).is_file():
            other = read_csv(path / schema.file, schema)
            new = [name for name in other.columns if name == key or name not in table.columns]
            table = table.merge(other[new], on=key, how="left")
    return table


def _overrides(path: Path) -> dict[str, str]:
    try:
        return as_mapping(yaml.safe_load(path.read_text(encoding="utf-8")) or [])
    except (OSError, yaml.YAMLError):  # Hydra is writing it just now
        return {}
