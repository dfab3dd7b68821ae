"""From the folders on a command line to the runs and multiruns in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from uncal.errors import UncalError
from uncal.multirun.jobs import REPLICATES, Job, read_jobs, swept_keys
from uncal.multirun.summary import MultirunRecord
from uncal.reporting.run import UNKNOWN, Run, read_run

MOST_JOBS = 8
"""A multirun of more jobs is shown by its summary; a row per job would bury the paper's."""


@dataclass(frozen=True)
class Multirun:
    """A multirun's folder.

    Attributes:
        name: such as "Run 2", by which tables refer to it.
        folder: where it is.
        jobs: found there, finished or not.
        runs: the finished jobs.
        record: its command and plan.
    """

    name: str
    folder: Path
    jobs: tuple[Job, ...]
    runs: tuple[Run, ...]
    record: MultirunRecord

    @property
    def shown(self) -> bool:
        """Whether the jobs stand in the tables one by one."""
        return len(self.runs) <= MOST_JOBS

    @property
    def origin(self) -> str:
        """The command that started it, its seeds, commits and data."""
        seeds, commits = (
            ", ".join(dict.fromkeys(run.entry(key) or UNKNOWN for run in self.runs))
            for key in ("seed", "commit")
        )
        labels = ", ".join(dict.fromkeys(run.label for run in self.runs))
        return f"{self.name}: {self.record.command} · seed {seeds} · commit {commits} · {labels}"


@dataclass(frozen=True)
class Gathered:
    """Everything to compare with the paper: runs and multiruns, each given by its folder."""

    single: tuple[Run, ...]
    multiruns: tuple[Multirun, ...]

    @property
    def runs(self) -> tuple[Run, ...]:
        """All that stand in the tables one by one."""
        jobs = [run for multirun in self.multiruns if multirun.shown for run in multirun.runs]
        return (*self.single, *jobs)

    @property
    def all_runs(self) -> tuple[Run, ...]:
        """All, for the CSV."""
        return (*self.single, *(run for each in self.multiruns for run in each.runs))

    @property
    def labels(self) -> tuple[str, ...]:
        """What data the runs used, each once."""
        return tuple(dict.fromkeys(run.label for run in self.all_runs))


def gather(folders: Sequence[Path]) -> Gathered:
    """Read run folders and multirun folders, in the order given.

    Raises:
        UncalError: a folder is not there, is given twice, holds no results, or holds damaged ones.
    """
    single: list[Run] = []
    multiruns: list[Multirun] = []
    seen: set[Path] = set()
    for number, folder in enumerate(folders, start=1):
        name = f"Run {number}"
        if not folder.is_dir():
            found = "it is a file" if folder.exists() else "there is no such folder"
            raise UncalError(
                f"{folder}: {found}. Expected the folder of a run, such as outputs/demo/<time>, or "
                "of a multirun, such as outputs/multirun/<time>; the run printed it at its end."
            )
        if folder.resolve() in seen:
            raise UncalError(f"{folder} is given twice; give each run once.")
        seen.add(folder.resolve())
        jobs = () if (folder / "results.csv").is_file() else tuple(read_jobs(folder))
        if any(job.folder != "." for job in jobs):
            multiruns.append(_multirun(folder, name, jobs))
        else:
            single.append(read_run(folder, name))
    return Gathered(tuple(single), tuple(multiruns))


def _multirun(folder: Path, name: str, jobs: tuple[Job, ...]) -> Multirun:
    keys = (*swept_keys(jobs), *REPLICATES)
    runs = []
    for job in jobs:
        if job.table is not None:
            swept = ", ".join(f"{key}={job.overrides[key]}" for key in keys if key in job.overrides)
            runs.append(read_run(folder / job.folder, f"{name}, job {job.folder}", swept))
    if not runs:
        reasons = "; ".join(f"{job.folder}: {job.failure}" for job in jobs)
        raise UncalError(
            f"{folder}: none of the {len(jobs)} jobs of this multirun has results ({reasons}). "
            "Run its command again; finished jobs are kept."
        )
    unknown = MultirunRecord(f"command {UNKNOWN} (no multirun.json)")
    record = MultirunRecord.read(folder) or unknown
    return Multirun(name, folder, jobs, tuple(runs), record)
