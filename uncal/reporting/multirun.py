"""What a multirun says as a whole: summary.csv for programs, summary.md for people."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

from uncal.geometry import DOF_NAMES
from uncal.reporting.layout import csv_text, markdown_lines, number, write_whole
from uncal.reporting.multirun_jobs import Job, read_jobs, swept_keys

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
)
"""What summary.csv takes from every job's results.csv, unchanged."""

_NOTES = (
    "MPIW: mean width of the intervals. PICP: coverage found. after / before: mean over the DoF "
    "of mean absolute error after / before.",
    "`summary.csv` has the numbers unrounded, one row per job, level and DoF, with IS and MAE; "
    "the columns are those of `results.csv` in the jobs' folders.",
)

_INFINITE = "∞: the uncertainty calibration set is too small for that level."


def write_summary(folder: Path, command: str) -> list[Job]:
    """Write ``summary.md`` and, once a job has results, ``summary.csv`` into a multirun's folder.

    Args:
        folder: ``hydra.sweep.dir``.
        command: the command line that started the multirun.

    Returns:
        The jobs found there.
    """
    jobs = read_jobs(folder)
    if any(job.rows for job in jobs):
        write_whole(folder / "summary.csv", summary_csv(jobs))
    else:
        (folder / "summary.csv").unlink(missing_ok=True)
    write_whole(folder / "summary.md", summary_markdown(jobs, command))
    return jobs


def summary_csv(jobs: Sequence[Job]) -> str:
    """One row per job, level and DoF: swept keys, seed, :data:`COLUMNS`, the job's folder.

    Args:
        jobs: of one multirun, at least one with results.
    """
    keys = swept_keys(jobs)
    rows = [
        [*(job.overrides.get(key) for key in keys), job.seed]
        + [row[column] for column in COLUMNS]
        + [job.folder]
        for job in jobs
        for row in job.rows
    ]
    return csv_text([*keys, "seed", *COLUMNS, "folder"], rows)


def summary_markdown(jobs: Sequence[Job], command: str) -> str:
    """A table per level, swept values as rows, seeds taken together; then the jobs that failed.

    Args:
        jobs: of one multirun.
        command: the command line that started it.
    """
    finished = [job for job in jobs if job.rows]
    labels = dict.fromkeys(job.label for job in finished if job.label)
    heading = f"# Multirun on {' and '.join(labels)} data" if labels else "# Multirun"
    lines = [heading, "", f"    {command}", "", _counts(jobs, finished)]
    levels = sorted({float(row["level"]) for job in finished for row in job.rows})
    for level in levels:
        lines += ["", f"## {level:g}% intervals", ""]
        lines += markdown_lines(_grid(jobs, level))
    if finished:
        infinite = any(math.isinf(float(row["mpiw"])) for job in finished for row in job.rows)
        lines += ["", *(f"- {note}" for note in (*_NOTES, *([_INFINITE] if infinite else [])))]
    if len(finished) < len(jobs):
        lines += ["", "## Jobs without results", ""]
        lines += [f"- {_name(job, jobs)}: {job.failure}" for job in jobs if not job.rows]
    return "\n".join(lines) + "\n"


def mean_and_deviation(values: Sequence[float], digits: int) -> str:
    """Mean ± standard deviation (n - 1) of finite values, the mean alone where there is none.

    Args:
        values: at least one.
        digits: after the point.

    >>> mean_and_deviation([1.0, 3.0], 2), mean_and_deviation([2.0, math.inf], 2)
    ('2.00 ± 1.41', '∞')
    """
    mean = number(sum(values) / len(values), digits)
    if len(values) < 2 or not all(map(math.isfinite, values)):
        return mean
    return f"{mean} ± {number(statistics.stdev(values), digits)}"


def _counts(jobs: Sequence[Job], finished: Sequence[Job]) -> str:
    text = f"Jobs: {len(jobs)}, with results: {len(finished)}."
    rows = [row for job in finished for row in job.rows]
    if rows:
        text += (
            f" {_range(rows, 'n_test')} frames in the test set, "
            f"{_range(rows, 'n_calibration')} in the uncertainty calibration set."
        )
    seeds = list(dict.fromkeys(job.seed for job in finished if job.seed is not None))
    if len(seeds) > 1:
        text += f" Mean ± standard deviation over the seeds {', '.join(seeds)}."
    elif seeds:
        text += f" Seed {seeds[0]}."
    return text


def _name(job: Job, jobs: Sequence[Job]) -> str:
    """Folder and what tells the job from the others; the command has the rest."""
    told = [key for key in (*swept_keys(jobs), "seed") if key in job.overrides]
    settings = ", ".join(f"{key}={job.overrides[key]}" for key in told)
    return f"`{job.folder}` ({settings})" if settings else f"`{job.folder}`"


def _range(rows: Sequence[Mapping[str, str]], column: str) -> str:
    values = sorted({int(row[column]) for row in rows})
    return f"{values[0]}" if len(values) == 1 else f"{values[0]}-{values[-1]}"


def _grid(jobs: Sequence[Job], level: float) -> list[list[str]]:
    """Swept values, MPIW per DoF, PICP per DoF, mean ratio; in the order of the jobs."""
    keys = swept_keys(jobs)
    several = len({job.seed for job in jobs}) > 1
    groups: dict[tuple[str, ...], list[list[Mapping[str, str]]]] = {}
    for job in jobs:
        rows = [row for row in job.rows if float(row["level"]) == level]
        if rows:
            # Without a swept key the folder tells jobs apart, unless it is the seed that does.
            values = tuple(job.overrides.get(key, "") for key in keys)
            alone = (job.folder,) if not several else ("all",)
            groups.setdefault(values or alone, []).append(rows)
    units = {row["dof"]: row["unit"] for runs in groups.values() for row in runs[0]}
    header = [*(keys or ("job",)), *(["seeds"] if several else [])]
    header += [f"{dof} MPIW ({units[dof]})" for dof in DOF_NAMES]
    header += [f"{dof} PICP (%)" for dof in DOF_NAMES]
    grid = [[*header, "after / before"]]
    for values, runs in groups.items():
        line = [*values, *([str(len(runs))] if several else [])]
        for dof in DOF_NAMES:
            line.append(_cell(runs, dof, "mpiw", 2 if units[dof] == "cm" else 3))
        line += [_cell(runs, dof, "picp", 1) for dof in DOF_NAMES]
        grid.append([*line, mean_and_deviation([_mean_ratio(rows) for rows in runs], 3)])
    return grid


def _cell(runs: Sequence[Sequence[Mapping[str, str]]], dof: str, column: str, digits: int) -> str:
    values = [float(row[column]) for rows in runs for row in rows if row["dof"] == dof]
    return mean_and_deviation(values, digits)


def _mean_ratio(rows: Sequence[Mapping[str, str]]) -> float:
    """NaN, of a DoF without decalibration, says nothing and is left out."""
    ratios = [ratio for row in rows if not math.isnan(ratio := float(row["ratio"]))]
    return sum(ratios) / len(ratios) if ratios else math.nan
