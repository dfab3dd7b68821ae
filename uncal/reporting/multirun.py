"""What a multirun says as a whole: summary.csv for programs, summary.md for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from uncal.reporting.layout import csv_text, write_whole
from uncal.reporting.multirun_jobs import (
    REPLICATES,
    STATE,
    Job,
    job_folders,
    read_jobs,
    swept_keys,
)
from uncal.reporting.multirun_markdown import summary_markdown

COLUMNS: tuple[str, ...] = (
    "dof",
    "unit",
    "level",
    "picp",
    "mpiw",
    "is",
    "ratio",
    "mae_after",
    "n_test",
    "n_calibration",
    "coverage_low",
    "coverage_high",
    "mae_before",
)
"""What summary.csv takes from every job's results.csv, unchanged."""

JOINT_COLUMNS = ("together", "joint", "joint_low", "joint_high", "bonferroni")
"""What it takes from joint.csv, where there is one: the same for all DoF of a level."""

CONTROL_COLUMNS = (
    "mae_single",
    "mae_blind",
    "contribution",
    "contribution_low",
    "contribution_high",
)
"""What it takes from control.csv, where there is one: the same for all levels of a DoF."""


def write_summary(
    folder: Path, command: str, planned: Sequence[Mapping[str, str]] | None = None
) -> list[Job]:
    """Write ``summary.md`` and, once a job has results, ``summary.csv`` into a multirun's folder.

    Jobs that run in parallel call this at the same time. Who reads early may write late, so each
    looks again after writing, and starts over if a job has changed meanwhile.

    Args:
        folder: ``hydra.sweep.dir``.
        command: the command line that started the multirun.
        planned: the overrides of every job to come; None if unknown. Folders of other jobs, of
            an earlier multirun, are then counted and left out.

    Returns:
        The jobs found there.
    """
    for _ in range(10):  # enough for everyone, and an end in any case
        before = _state(folder)
        found = read_jobs(folder)
        jobs = [job for job in found if planned is None or job.overrides in planned]
        if any(job.rows for job in jobs):
            _write_changed(folder / "summary.csv", summary_csv(jobs))
        else:
            (folder / "summary.csv").unlink(missing_ok=True)
        text = summary_markdown(
            jobs,
            command,
            folder=folder,
            planned=planned,
            leftover=[job.folder for job in found if job not in jobs],
        )
        write_whole(folder / "summary.md", text)
        if _state(folder) == before:
            break
    return jobs


def summary_csv(jobs: Sequence[Job]) -> str:
    """One row per job, level and DoF; columns that no job has are left out.

    Swept keys, ``seed`` and ``mcd.seed``, :data:`COLUMNS`, :data:`JOINT_COLUMNS`,
    :data:`CONTROL_COLUMNS`, the fingerprint of the weights and whether they were found instead of
    trained, what the data are, the job's folder.

    Args:
        jobs: of one multirun, at least one with results.
    """
    keys = swept_keys(jobs)
    rows: list[list[object]] = []
    for job in jobs:
        for row in job.rows:
            joint = job.joint.get(float(row["level"]), {})
            control = job.control.get(row["dof"], {})
            rows.append(
                [
                    *(*(job.overrides.get(key) for key in keys), job.seed, job.mask_seed),
                    *(row[column] for column in COLUMNS),
                    *(joint.get(column) for column in JOINT_COLUMNS),
                    *(control.get(column) for column in CONTROL_COLUMNS),
                    *(job.weights, job.reused, job.label, job.folder),
                ]
            )
    own = ("weights", "reused", "label", "folder")
    header = [*keys, *REPLICATES, *COLUMNS, *JOINT_COLUMNS, *CONTROL_COLUMNS, *own]
    return csv_text(header, rows)


def _write_changed(path: Path, text: str) -> None:
    """The file's time then tells whether the figures show what is in it."""
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        write_whole(path, text)


def _state(folder: Path) -> set[tuple[str, int, int]]:
    """What there is and when it was written."""
    found = set()
    for job in job_folders(folder):
        for name in STATE:
            try:
                stat = (job / name).stat()
            except FileNotFoundError:
                continue
            found.add((f"{job}/{name}", stat.st_mtime_ns, stat.st_size))
    return found
