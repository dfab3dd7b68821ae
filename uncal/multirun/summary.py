"""The summary of a multirun: summary.csv for programs, summary.md for people."""

from __future__ import annotations

import json
import math
import shlex
import statistics
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

import pandas as pd

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.multirun.folder import (
    FIGURES,
    RECORD,
    REPLICATES,
    STATE,
    SUMMARY,
    Multirun,
    Planned,
    job_folders,
    read_captions,
    shown,
    swept_keys,
)
from uncal.multirun.sweep import Quantity, Sweep
from uncal.reporting.layout import Grid, number, write_whole
from uncal.reporting.sections import Section

_WITHOUT_RESULTS = "Jobs without results"

Column: TypeAlias = tuple[str, int, Quantity]
"""Heading, digits, and what is averaged."""

KINDS = (("transl.", "cm", DOF_NAMES[:3]), ("rot.", "°", DOF_NAMES[3:]))
DIGITS = {"cm": 2, "°": 3}

LOWEST = "PICP, lowest DoF (%)"

_POSE = {"six at once": "together", "joint box": "joint", "Bonferroni": "bonferroni"}

_NOTES = (
    "MPIW: mean width of the intervals. PICP: empirical coverage. IS: interval score, the lower "
    "the better. after / before: mean over the DoF of mean absolute error after / before.",
    "`summary.csv` has the numbers unrounded, one row per job, level and DoF, with IS and MAE; "
    "the columns are those of `results.csv`, `joint.csv` and `control.csv` in the jobs' folders.",
)

_INFINITE = "∞: the uncertainty calibration set is too small for that level."

_JOINT = (
    "Six at once: how often all six intervals hold, which is not guaranteed. Joint box and "
    "Bonferroni: regions that hold all six DoF at the nominal level."
)

_CAMERA = (
    "(error with another frame's image - error) / decalibration, all mean absolute: what the "
    "camera contributes to the estimate. Near 0 the network calibrates blind."
)


def summary_tables(sweep: Sweep) -> list[Section]:
    """All DoF in one table, a table per level, errors and what the camera contributes."""
    first = sweep.levels[0]
    errors = "Mean absolute error of one pass without dropout and of the MC mean"
    infinite = sweep.frame["mpiw"].map(math.isinf).any()
    joint = "together" in sweep.frame.columns
    notes = [*_NOTES, *([_JOINT] if joint else []), *([_INFINITE] if infinite else [])]
    levels = [
        Section(f"{level:g}% intervals", _grid(sweep, _widths_and_coverage(level)))
        for level in sweep.levels
    ]
    levels[-1] = Section(levels[-1].title, levels[-1].grid, notes)
    sections = [
        Section(f"All DoF, {first:g}% intervals", _grid(sweep, _whole_pose(first))),
        *levels,
    ]
    if "contribution" in sweep.frame.columns:
        columns = _per_dof({"one pass": "mae_single", "MC mean": "mae_mean"}, first)
        camera = Section("What the camera contributes", _camera_grid(sweep), [_CAMERA])
        sections += [Section(errors, _grid(sweep, columns)), camera]
    return sections


def mean_and_deviation(values: Sequence[float], digits: int) -> str:
    """Mean ± standard deviation (n - 1) of finite values, the mean alone where there is none.

    >>> mean_and_deviation([1.0, 3.0], 2), mean_and_deviation([2.0, math.inf], 2)
    ('2.00 ± 1.41', '∞')
    """
    if not values:
        return number(None, digits)
    mean = number(sum(values) / len(values), digits)
    if len(values) < 2 or not all(map(math.isfinite, values)):
        return mean
    return f"{mean} ± {number(statistics.stdev(values), digits)}"


def _widths_and_coverage(level: float) -> list[Column]:
    coverage = [(f"{dof} PICP (%)", 1, ("picp", level, [dof])) for dof in DOF_NAMES]
    ratio = ("after / before", 3, ("ratio", level, DOF_NAMES))
    return [*_per_dof({"MPIW": "mpiw"}, level), *coverage, ratio]


def _whole_pose(level: float) -> list[Column]:
    lengths = [
        (f"{name} {kind} ({unit})", DIGITS[unit], (column, level, dofs))
        for name, column in (("IS", "is"), ("MPIW", "mpiw"))
        for kind, unit, dofs in KINDS
    ]
    shares = {"PICP, mean (%)": "picp", LOWEST: "picp"}
    shares |= {f"{name} (%)": column for name, column in _POSE.items()}
    coverage = [(name, 1, (column, level, DOF_NAMES)) for name, column in shares.items()]
    return [*lengths, *coverage, ("after / before", 3, ("ratio", level, DOF_NAMES))]


def _per_dof(quantities: dict[str, str], level: float) -> list[Column]:
    return [
        (f"{dof} {name} ({unit})", DIGITS[unit], (column, level, [dof]))
        for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
        for name, column in quantities.items()
    ]


def _camera_grid(sweep: Sweep) -> Grid:
    """Per DoF, with its interval where nothing was repeated."""
    level = sweep.levels[0]
    headings = {f"{dof} (%)": dof for dof in DOF_NAMES}
    columns = [(text, 0, ("contribution", level, [dof])) for text, dof in headings.items()]
    grid = _grid(sweep, columns)
    for index, heading in enumerate(grid[0]):
        dofs = [headings[heading]] if heading in headings else []
        low, high = (sweep.per_job((f"contribution_{end}", level, dofs)) for end in ("low", "high"))
        for line, (folder, *more) in zip(grid[1:], sweep.groups.values(), strict=True):
            if dofs and not more and line[index] != "–":
                line[index] += f" [{low[folder]:.0f}, {high[folder]:.0f}]"
    return grid


def _grid(sweep: Sweep, columns: Iterable[Column]) -> Grid:
    """A line per group; columns that no job has are left out."""
    repeated = sweep.repeated
    header = [*(sweep.keys or ["job"]), *([" × ".join(repeated)] if repeated else [])]
    lines = [
        [*values, *([str(len(folders))] if repeated else [])]
        for values, folders in sweep.groups.items()
    ]
    for heading, digits, quantity in columns:
        per_job = sweep.per_job(quantity, "min" if heading == LOWEST else "mean")
        cells = [
            mean_and_deviation(per_job.reindex(folders).dropna().tolist(), digits)
            for folders in sweep.groups.values()
        ]
        if set(cells) != {"–"}:
            header.append(heading)
            for line, cell in zip(lines, cells, strict=True):
                line.append(cell)
    return [header, *lines]


def write_summary(folder: Path, command: str, planned: Planned = None) -> Multirun:
    """Write ``summary.md`` and, once a job has results, ``summary.csv`` into a multirun's folder.

    Jobs that run in parallel call this at the same time. Who reads early may write late, so each
    looks again after writing, and starts over if a job has changed meanwhile.
    The arguments are those of :class:`Multirun`.
    """
    record = json.dumps({"command": command, "planned": planned}, indent=1, ensure_ascii=False)
    write_whole(folder / RECORD, f"{record}\n")
    for _ in range(10):  # enough for everyone, and an end in any case
        before = _state(folder)
        multirun = Multirun(folder, command, planned)
        if not multirun.finished:
            (folder / SUMMARY).unlink(missing_ok=True)
        else:
            text, path = multirun.csv(), folder / SUMMARY
            # Its time tells whether the figures show what is in it.
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                write_whole(path, text)
        write_whole(folder / "summary.md", summary_markdown(multirun))
        if _state(folder) == before:
            break
    return multirun


def summary_markdown(multirun: Multirun) -> str:
    """The sections as Markdown, with the figures that lie in the multirun's folder."""
    known = {job.entry("label"): None for job in multirun.found if job.table is not None}
    labels = " and ".join(label for label in known if label)
    jobs, *others = summary_sections(multirun)
    figures = [
        f"![{title}]({FIGURES}/{name}.png)\n\n{caption}"
        for name, title, caption in read_captions(multirun.folder)
    ]
    paragraphs = [f"# Multirun on {labels} data" if labels else "# Multirun"]
    paragraphs += [f"    {multirun.command}", *jobs.notes]
    for section in others:
        if section.title == _WITHOUT_RESULTS and figures:
            paragraphs += ["## Figures", *figures]
            figures = []
        paragraphs += section.markdown()
    paragraphs += ["## Figures", *figures] if figures else []
    return "\n\n".join(paragraphs) + "\n"


def summary_sections(multirun: Multirun) -> list[Section]:
    """The jobs in words; all DoF in one table, a table per level, errors; jobs without results."""
    sweep = None if multirun.frame is None else Sweep(multirun.frame)
    sections = [] if sweep is None else summary_tables(sweep)
    if without := _without_results(multirun):
        sections.append(Section(_WITHOUT_RESULTS, [], without))
    return [Section("Jobs", [], _job_notes(multirun, sweep)), *sections]


def continuation(command: str, folder: Path) -> str:
    """The command that resumes a multirun: the same, with its folder.

    >>> continuation("python -m uncal.train -m mcd.passes=5,10", Path("outputs/many"))
    'python -m uncal.train -m mcd.passes=5,10 hydra.sweep.dir=outputs/many'
    """
    if any(part.startswith("hydra.sweep.dir=") for part in shlex.split(command)):
        return command
    return f"{command} {shlex.quote(f'hydra.sweep.dir={folder}')}"


def _job_notes(multirun: Multirun, sweep: Sweep | None) -> list[str]:
    finished = multirun.finished
    total = max(len(multirun.jobs), len(multirun.planned or ()))
    text = f"Jobs: {total}, with results: {len(finished)}."
    if sweep is not None:
        text += (
            f" {_range(sweep.frame['n_test'])} frames in the test set, "
            f"{_range(sweep.frame['n_calibration'])} in the uncertainty calibration set."
        )
        if sweep.repeated:
            over = (f"the {name} {', '.join(values)}" for name, values in sweep.repeated.items())
            text += f" Mean ± standard deviation over {' and '.join(over)}."
    seeds = dict.fromkeys(job.seed for job in finished if job.seed is not None)
    if len(seeds) == 1:
        text += f" Seed {next(iter(seeds))}."
    known = [job.weights["reused"] for job in finished if "reused" in job.weights]
    if known:
        text += f" {known.count(False)} of {len(known)} jobs trained, "
        text += f"{known.count(True)} reused weights."
    notes = [text]
    leftover = [f"`{job.name}`" for job in multirun.found if job not in multirun.jobs]
    if leftover:
        folders = "folder" if len(leftover) == 1 else "folders"
        listed = ", ".join(leftover)
        notes.append(f"Left out: {len(leftover)} {folders} of an earlier multirun ({listed}).")
    if len(finished) < total:
        notes.append("If it is no longer running, this command resumes it:")
        notes.append(f"    {continuation(multirun.command, multirun.folder)}")
    return notes


def _range(sizes: pd.Series[int]) -> str:
    low, high = sizes.min(), sizes.max()
    return f"{low}" if low == high else f"{low}-{high}"


def _without_results(multirun: Multirun) -> list[str]:
    def settings(overrides: Mapping[str, str], keys: Iterable[str]) -> str:
        """What sets a job apart; the command has the rest."""
        pairs = shown(overrides, keys)
        return f" ({pairs})" if pairs else ""

    jobs, planned = multirun.jobs, multirun.planned or ()
    keys = [*swept_keys(jobs), *REPLICATES]
    lines = [
        f"`{job.name}`{settings(job.overrides, keys)}: {job.failure}"
        for job in jobs
        if job.table is None
    ]
    begun = [job.overrides for job in jobs]
    differ = [key for key in (planned or [{}])[0] if len({each.get(key) for each in planned}) > 1]
    return lines + [f"not started{settings(p, differ)}" for p in planned if p not in begun]


def _state(folder: Path) -> set[tuple[str, int, int]]:
    """What there is and when it was written."""
    found = set()
    for path in (job / name for job in job_folders(folder) for name in STATE):
        with suppress(FileNotFoundError):
            stat = path.stat()
            found.add((str(path), stat.st_mtime_ns, stat.st_size))
    return found
