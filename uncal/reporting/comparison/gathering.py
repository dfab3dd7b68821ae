"""From the folders on a command line to the runs and multiruns in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from uncal.errors import UncalError
from uncal.reporting.comparison.run_folder import Run, read_run_folder
from uncal.reporting.multirun_jobs import REPLICATES, Job, read_jobs, swept_keys

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
    """

    name: str
    folder: Path
    jobs: tuple[Job, ...]
    runs: tuple[Run, ...]

    @property
    def shown(self) -> bool:
        """Whether the jobs stand in the tables one by one; without a summary they must."""
        return len(self.runs) <= MOST_JOBS or not (self.folder / "summary.md").is_file()


@dataclass(frozen=True)
class Gathered:
    """Everything to put beside the paper.

    Attributes:
        single: runs given by their own folder.
        multiruns: given by the folder of all their jobs.
    """

    single: tuple[Run, ...]
    multiruns: tuple[Multirun, ...]

    @property
    def runs(self) -> tuple[Run, ...]:
        """All that stand in the tables one by one."""
        jobs = [run for multirun in self.multiruns if multirun.shown for run in multirun.runs]
        return (*self.single, *jobs)

    @property
    def all_runs(self) -> tuple[Run, ...]:
        """All, for the csv."""
        return (*self.single, *(run for each in self.multiruns for run in each.runs))

    @property
    def labels(self) -> tuple[str, ...]:
        """What data the runs used, each once."""
        return tuple(dict.fromkeys(run.label for run in self.all_runs))


def gather(folders: Sequence[Path]) -> Gathered:
    """Read run folders and multirun folders, in the order given.

    Args:
        folders: at least one.

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
            single.append(read_run_folder(folder, name))
    return Gathered(tuple(single), tuple(multiruns))


def _multirun(folder: Path, name: str, jobs: tuple[Job, ...]) -> Multirun:
    keys = (*swept_keys(jobs), *REPLICATES)
    runs = []
    for job in jobs:
        if job.failure is None:
            settings = [f"{key}={job.overrides[key]}" for key in keys if key in job.overrides]
            runs.append(
                read_run_folder(
                    folder / job.folder, f"{name}, job {job.folder}", ", ".join(settings)
                )
            )
    if not runs:
        reasons = "; ".join(f"{job.folder}: {job.failure}" for job in jobs)
        raise UncalError(
            f"{folder}: none of the {len(jobs)} jobs of this multirun has results ({reasons}). "
            "Run its command again; finished jobs are kept."
        )
    return Multirun(name, folder, jobs, tuple(runs))
