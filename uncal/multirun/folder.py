"""A multirun's folder: its command, its plan, and its jobs as one tidy frame."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TypeAlias, cast

import pandas as pd
import yaml  # type: ignore[import-untyped]

from uncal.errors import UncalError
from uncal.reporting.frames import CONTROL, JOINT, RESULTS, read_csv
from uncal.reporting.layout import read_json
from uncal.reporting.run import FAILED, UNKNOWN, Run, why_failed
from uncal.reporting.run_record import NAME, read_record

SUMMARY = "summary.csv"

FIGURES = "figures"
CAPTIONS = "captions.csv"
"""In the folder of figures: name, title and caption of each, written when all are drawn."""

RECORD = "multirun.json"
"""Beside the summary: the command, and the jobs that were planned."""

COLUMNS: tuple[str, ...] = (
    *("dof", "unit", "level", "picp", "mpiw", "is", "ratio", "mae_after", "n_test"),
    *("n_calibration", "coverage_low", "coverage_high", "mae_before"),
)
"""What summary.csv takes from every job's results.csv."""

OPTIONAL: tuple[str, ...] = (
    *("together", "joint", "joint_low", "joint_high", "bonferroni"),
    *("mae_single", "mae_blind", "contribution", "contribution_low", "contribution_high"),
)
"""And from joint.csv (the same for all DoF of a level) and control.csv (for all levels of a DoF),
where there are such files."""

Planned: TypeAlias = Sequence[Mapping[str, str]] | None
"""The overrides of every job to come; None if unknown."""

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


@dataclass(frozen=True)
class Multirun:
    """A multirun's folder, read once, when its jobs are first asked for.

    Attributes:
        folder: ``hydra.sweep.dir``.
        command: the command line that started the multirun.
        planned: the overrides of every job to come; None if unknown. Folders of other jobs are
            those of an earlier multirun.
        name: such as "Run 2", by which a comparison refers to it.
    """

    folder: Path
    command: str
    planned: Planned = None
    name: str = ""

    @classmethod
    def read(cls, folder: Path, name: str) -> Multirun:
        """The multirun in a folder; its command may not be recorded."""
        record = read_json(folder / RECORD, "taken for missing") or {}
        unknown = f"command {UNKNOWN} (no {RECORD})"
        planned = cast(Planned, record.get("planned"))
        return cls(folder, str(record.get("command", unknown)), planned, name)

    @property
    def captions(self) -> Path:
        """The file of captions."""
        return self.folder / FIGURES / CAPTIONS

    @cached_property
    def found(self) -> list[Job]:
        """All jobs in the folder, finished or not."""
        return read_jobs(self.folder)

    @property
    def jobs(self) -> list[Job]:
        """Those of this multirun."""
        return [job for job in self.found if self.planned is None or job.overrides in self.planned]

    @property
    def finished(self) -> list[Job]:
        """Those with results."""
        return [job for job in self.jobs if job.table is not None]

    @cached_property
    def runs(self) -> list[Run]:
        """All with results in the folder, named after the multirun for a comparison."""
        keys = (*swept_keys(self.found), *REPLICATES)
        return [
            replace(
                job, name=f"{self.name}, job {job.name}", distinction=shown(job.overrides, keys)
            )
            for job in self.found
            if job.table is not None
        ]

    @property
    def label(self) -> str:
        """What the data of the runs are."""
        return ", ".join(dict.fromkeys(run.label for run in self.runs))

    @property
    def origin(self) -> str:
        """The command that started it, its seeds, commits and data."""
        seeds, commits = (
            ", ".join(dict.fromkeys(run.entry(key) or UNKNOWN for run in self.runs))
            for key in ("seed", "commit")
        )
        return f"{self.name}: {self.command} · seed {seeds} · commit {commits} · {self.label}"

    @cached_property
    def frame(self) -> pd.DataFrame | None:
        """The finished jobs' tables below each other, None without any; read-only.

        Swept keys, seeds, tables, then what is the job's: fingerprint of the weights, whether they
        were reused, label of the data, folder. All but the tables is text, "" where unset.
        """
        if not self.finished:
            return None
        parts = []
        for job in self.finished:
            before = {key: job.overrides.get(key, "") for key in swept_keys(self.jobs)}
            before |= {"seed": job.seed or "", "mcd.seed": job.overrides.get("mcd.seed", "")}
            own = {
                "weights": str(job.weights.get("fingerprint", "")),
                "reused": str(job.weights.get("reused", "")),
                "label": job.entry("label") or "",
                "folder": job.name,
            }
            assert job.table is not None
            table = job.table.assign(**before, **own)
            parts.append(table[[*before, *job.table.columns, *own]])
        frame: pd.DataFrame = pd.concat(parts, ignore_index=True)
        return frame

    def csv(self) -> str:
        """summary.csv: a row per job, level and DoF; columns that no job has are left out.

        Swept keys, seeds, :data:`COLUMNS`, :data:`OPTIONAL`, then what is the job's own. A cell is
        empty where a job has no such number, "nan" where it has and it is NaN.
        """
        frame = self.frame
        assert frame is not None
        before = list(frame.columns[: list(frame.columns).index("dof")])
        names = [*before, *COLUMNS, *OPTIONAL, "weights", "reused", "label", "folder"]
        text = frame[[name for name in names if name in frame.columns]].astype(object)
        text = text.map(lambda v: repr(float(v)) if isinstance(v, float) else v)
        if optional := [name for name in OPTIONAL if name in frame.columns]:
            by = [frame["folder"], frame["level"]]
            lacking = frame[optional].isna().groupby(by).transform("all")
            text[optional] = text[optional].mask(lacking, "")
        used = (text != "").any()
        # Empty for a checkpoint that the user named.
        used["weights"] |= any("fingerprint" in job.weights for job in self.jobs)
        kept: pd.DataFrame = text.loc[:, used]
        return kept.to_csv(index=False, lineterminator="\n")


def read_captions(folder: Path) -> list[list[str]]:
    """Name, title and caption of the figures in a multirun's folder."""
    path = folder / FIGURES / CAPTIONS
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    return list(csv.reader(text.splitlines()))[1:]
