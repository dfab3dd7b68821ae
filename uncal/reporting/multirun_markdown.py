"""A multirun's summary for people: tables, figures, and how it goes on."""

from __future__ import annotations

import csv
import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from uncal.reporting.layout import markdown_lines
from uncal.reporting.multirun_jobs import REPLICATES, Job, swept_keys
from uncal.reporting.multirun_tables import (
    camera_table,
    error_table,
    grouped,
    level_table,
    replicates,
    whole_table,
)

FIGURES = "figures"
CAPTIONS = "captions.csv"
"""In the folder of figures: name, title and caption of each."""

_NOTES = (
    "MPIW: mean width of the intervals. PICP: coverage found. IS: interval score, the lower the "
    "better. after / before: mean over the DoF of mean absolute error after / before.",
    "`summary.csv` has the numbers unrounded, one row per job, level and DoF, with IS and MAE; "
    "the columns are those of `results.csv`, `joint.csv` and `control.csv` in the jobs' folders.",
)

_INFINITE = "∞: the uncertainty calibration set is too small for that level."

_JOINT = (
    "Six at once: how often all six intervals hold, which nobody promises. Joint box and "
    "Bonferroni: boxes made to hold all six at the level asked."
)

_CAMERA = (
    "(error with another frame's image - error) / decalibration, all mean absolute: what the "
    "estimate owes to the camera. Near 0 the network calibrates blind."
)


def summary_markdown(
    jobs: Sequence[Job],
    command: str,
    *,
    folder: Path | None = None,
    planned: Sequence[Mapping[str, str]] | None = None,
    leftover: Sequence[str] = (),
) -> str:
    """All DoF in one table, a table per level, errors, figures; then the jobs without results.

    Args:
        jobs: of one multirun.
        command: the command line that started it.
        folder: ``hydra.sweep.dir``, to say how it goes on and to show figures.
        planned: the overrides of every job to come; None if unknown.
        leftover: folders of jobs of an earlier multirun.
    """
    finished = [job for job in jobs if job.rows]
    labels = dict.fromkeys(job.label for job in finished if job.label)
    heading = f"# Multirun on {' and '.join(labels)} data" if labels else "# Multirun"
    lines = [heading, "", f"    {command}", "", _counts(jobs, finished, planned)]
    if leftover:
        listed = ", ".join(f"`{name}`" for name in leftover)
        folders = "folder" if len(leftover) == 1 else "folders"
        lines += ["", f"Left out: {len(leftover)} {folders} of an earlier multirun ({listed})."]
    if folder and (len(finished) < max(len(jobs), len(planned or ()))):
        says = "Should it not be running any more, it goes on where it stopped with"
        lines += ["", f"{says}", "", f"    {continuation(command, folder)}"]
    lines += _tables(jobs, finished)
    lines += _figures(folder) if folder and finished else []
    lines += _without_results(jobs, planned or ())
    return "\n".join(lines) + "\n"


def continuation(command: str, folder: Path) -> str:
    """The command that goes on with a multirun: the same, told where it has been.

    Args:
        command: that started it.
        folder: ``hydra.sweep.dir``.

    >>> continuation("python -m uncal.train -m mcd.passes=5,10", Path("outputs/many"))
    'python -m uncal.train -m mcd.passes=5,10 hydra.sweep.dir=outputs/many'
    """
    if any(part.startswith("hydra.sweep.dir=") for part in shlex.split(command)):
        return command
    return f"{command} {shlex.quote(f'hydra.sweep.dir={folder}')}"


def _tables(jobs: Sequence[Job], finished: Sequence[Job]) -> list[str]:
    levels = sorted({float(row["level"]) for job in finished for row in job.rows})
    if not levels:
        return []
    groups = grouped(jobs)
    lines = ["", f"## All DoF, {levels[0]:g}% intervals", ""]
    lines += markdown_lines(whole_table(groups, levels[0]))
    for level in levels:
        lines += ["", f"## {level:g}% intervals", "", *markdown_lines(level_table(groups, level))]
    infinite = any(math.isinf(float(row["mpiw"])) for job in finished for row in job.rows)
    joint = any(job.joint for job in finished)
    notes = [*_NOTES, *([_JOINT] if joint else []), *([_INFINITE] if infinite else [])]
    lines += ["", *(f"- {note}" for note in notes)]
    if any(job.control for job in finished):
        lines += ["", "## Mean absolute error of one pass without dropout and of the MC mean", ""]
        lines += markdown_lines(error_table(groups))
        lines += ["", "## What the camera contributes", "", *markdown_lines(camera_table(groups))]
        lines += ["", f"- {_CAMERA}"]
    return lines


def _counts(
    jobs: Sequence[Job], finished: Sequence[Job], planned: Sequence[Mapping[str, str]] | None
) -> str:
    text = f"Jobs: {max(len(jobs), len(planned or ()))}, with results: {len(finished)}."
    rows = [row for job in finished for row in job.rows]
    if rows:
        text += (
            f" {_range(rows, 'n_test')} frames in the test set, "
            f"{_range(rows, 'n_calibration')} in the uncertainty calibration set."
        )
    repeated = replicates(finished)
    if repeated:
        over = " and ".join(f"the {name} {', '.join(seeds)}" for name, seeds in repeated.items())
        text += f" Mean ± standard deviation over {over}."
    seeds = dict.fromkeys(job.seed for job in finished if job.seed is not None)
    if len(seeds) == 1:
        text += f" Seed {next(iter(seeds))}."
    known = [job.reused for job in finished if job.reused is not None]
    if known:
        text += f" {known.count(False)} of {len(known)} jobs trained, "
        text += f"{known.count(True)} reused weights."
    return text


def _range(rows: Sequence[Mapping[str, str]], column: str) -> str:
    values = sorted({int(row[column]) for row in rows})
    return f"{values[0]}" if len(values) == 1 else f"{values[0]}-{values[-1]}"


def _figures(folder: Path) -> list[str]:
    listed = folder / FIGURES / CAPTIONS
    if not listed.is_file():
        return []
    lines = ["", "## Figures"]
    for row in csv.DictReader(listed.read_text(encoding="utf-8").splitlines()):
        lines += ["", f"![{row['title']}]({FIGURES}/{row['name']}.png)", "", row["caption"]]
    return lines


def _without_results(jobs: Sequence[Job], planned: Sequence[Mapping[str, str]]) -> list[str]:
    told = [*swept_keys(jobs), *REPLICATES]
    lines = [
        f"- `{job.folder}`{_settings(job.overrides, told)}: {job.failure}"
        for job in jobs
        if not job.rows
    ]
    begun = [job.overrides for job in jobs]
    differ = [key for key in (planned or [{}])[0] if len({each.get(key) for each in planned}) > 1]
    lines += [f"- not started{_settings(each, differ)}" for each in planned if each not in begun]
    return ["", "## Jobs without results", "", *lines] if lines else []


def _settings(overrides: Mapping[str, str], keys: Iterable[str]) -> str:
    """What tells a job from the others; the command has the rest."""
    told = ", ".join(f"{key}={overrides[key]}" for key in keys if key in overrides)
    return f" ({told})" if told else ""
