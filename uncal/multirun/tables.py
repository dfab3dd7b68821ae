"""The tables of a multirun's summary: swept values as rows, replicates taken together."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from typing import TypeAlias

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.multirun.sweep import Quantity, Sweep
from uncal.reporting.layout import Grid, number
from uncal.reporting.sections import Section

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
