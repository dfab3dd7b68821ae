"""The tables of a multirun's summary: swept values as rows, replicates taken together."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from typing import TypeAlias

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.multirun.sweep import Quantity, Sweep
from uncal.reporting.layout import Grid, number

Column: TypeAlias = tuple[str, int, Quantity]
"""Heading, digits, and what is averaged."""

KINDS = (("transl.", "cm", DOF_NAMES[:3]), ("rot.", "°", DOF_NAMES[3:]))

LOWEST = "PICP, lowest DoF (%)"

_POSE = {"six at once": "together", "joint box": "joint", "Bonferroni": "bonferroni"}


def level_table(sweep: Sweep, level: float) -> Grid:
    """MPIW per DoF, PICP per DoF, mean ratio, at one nominal coverage in percent."""
    coverage = [(f"{dof} PICP (%)", 1, ("picp", level, [dof])) for dof in DOF_NAMES]
    ratio = ("after / before", 3, ("ratio", level, DOF_NAMES))
    return _grid(sweep, [*_per_dof({"MPIW": "mpiw"}, level), *coverage, ratio])


def pose_table(sweep: Sweep, level: float) -> Grid:
    """All DoF in one line: scores, widths and coverage at one nominal coverage in percent."""
    lengths = [
        (f"{name} {kind} ({unit})", _digits(unit), (column, level, dofs))
        for name, column in (("IS", "is"), ("MPIW", "mpiw"))
        for kind, unit, dofs in KINDS
    ]
    shares = {"PICP, mean (%)": "picp", LOWEST: "picp"}
    shares |= {f"{name} (%)": column for name, column in _POSE.items()}
    coverage = [(name, 1, (column, level, DOF_NAMES)) for name, column in shares.items()]
    return _grid(sweep, [*lengths, *coverage, ("after / before", 3, ("ratio", level, DOF_NAMES))])


def error_table(sweep: Sweep) -> Grid:
    """Mean absolute error of one pass without dropout and of the MC mean, per DoF."""
    errors = {"one pass": "mae_single", "MC mean": "mae_mean"}
    return _grid(sweep, _per_dof(errors, sweep.levels[0]))


def camera_table(sweep: Sweep) -> Grid:
    """What the camera contributes per DoF, with its interval where nothing was repeated."""
    level = sweep.levels[0]
    grid = _grid(sweep, [(f"{dof} (%)", 0, ("contribution", level, [dof])) for dof in DOF_NAMES])
    for dof in DOF_NAMES:
        if f"{dof} (%)" not in grid[0]:
            continue
        index = grid[0].index(f"{dof} (%)")
        low, high = (
            sweep.per_job((f"contribution_{end}", level, [dof])) for end in ("low", "high")
        )
        for line, folders in zip(grid[1:], sweep.groups.values(), strict=True):
            if len(folders) == 1 and line[index] != "–":
                line[index] += f" [{low[folders[0]]:.0f}, {high[folders[0]]:.0f}]"
    return grid


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


def _per_dof(quantities: dict[str, str], level: float) -> list[Column]:
    return [
        (f"{dof} {name} ({unit})", _digits(unit), (column, level, [dof]))
        for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
        for name, column in quantities.items()
    ]


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


def _digits(unit: str) -> int:
    """Tenths of a millimetre, thousandths of a degree."""
    return 2 if unit == "cm" else 3
