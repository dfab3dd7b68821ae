"""From the folders on a command line to the runs and multiruns in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from uncal.errors import UncalError
from uncal.multirun.folder import Multirun
from uncal.reporting.frames import RESULTS
from uncal.reporting.run import Run, read_run

MOST_JOBS = 8
"""A multirun of more jobs is shown by its summary; a row per job would bury the paper's."""


@dataclass(frozen=True)
class Gathered:
    """Everything to compare with the paper: runs and multiruns, each given by its folder."""

    single: tuple[Run, ...]
    multiruns: tuple[Multirun, ...]

    @property
    def runs(self) -> tuple[Run, ...]:
        """All that stand in the tables one by one."""
        return (*self.single, *(run for each in self.multiruns if shown(each) for run in each.runs))

    @property
    def all_runs(self) -> tuple[Run, ...]:
        """All, for the CSV."""
        return (*self.single, *(run for each in self.multiruns for run in each.runs))


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
        multirun = Multirun.read(folder, name)
        if (folder / RESULTS.file).is_file() or all(job.name == "." for job in multirun.found):
            single.append(read_run(folder, name))
            continue
        if not multirun.runs:
            reasons = "; ".join(f"{job.name}: {job.failure}" for job in multirun.found)
            raise UncalError(
                f"{folder}: none of the {len(multirun.found)} jobs of this multirun has results "
                f"({reasons}). Run its command again; finished jobs are kept."
            )
        for run in multirun.runs:
            _ = run.tables  # a damaged one is named here
        multiruns.append(multirun)
    return Gathered(tuple(single), tuple(multiruns))


def shown(multirun: Multirun) -> bool:
    """Whether the jobs of a multirun stand in the tables one by one."""
    return len(multirun.runs) <= MOST_JOBS
