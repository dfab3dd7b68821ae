"""The tables of a multirun's summary: swept values as rows, replicates taken together."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.reporting.layout import number
from uncal.reporting.multirun_jobs import Job, swept_keys

Grid: TypeAlias = list[list[str]]

TRANSLATIONS, ROTATIONS = DOF_NAMES[:3], DOF_NAMES[3:]


@dataclass(frozen=True)
class Groups:
    """Jobs with results, those of the same swept values together.

    Attributes:
        header: of the columns that name a group.
        members: cells of those columns → the jobs, in the order of the jobs.
    """

    header: tuple[str, ...]
    members: Mapping[tuple[str, ...], Sequence[Job]]


def grouped(jobs: Sequence[Job]) -> Groups:
    """Take together what differs only in seeds.

    Args:
        jobs: of one multirun, those without results too.
    """
    keys = swept_keys(jobs)
    repeated = replicates(jobs)
    groups: dict[tuple[str, ...], list[Job]] = {}
    for job in jobs:
        if job.rows:
            # Without a swept key the folder tells jobs apart, unless it is a seed that does.
            values = tuple(job.overrides.get(key, "") for key in keys)
            alone = ("all",) if repeated else (job.folder,)
            groups.setdefault(values or alone, []).append(job)
    header = (*(keys or ("job",)), *([" × ".join(repeated)] if repeated else []))
    members = {
        (*values, *([str(len(group))] if repeated else [])): group
        for values, group in groups.items()
    }
    return Groups(header, members)


def replicates(jobs: Sequence[Job]) -> dict[str, list[str]]:
    """What repeats the experiment: "seeds", "mask seeds" or both, with the values.

    Args:
        jobs: of one multirun.
    """
    found = {
        "seeds": list(dict.fromkeys(job.seed for job in jobs if job.seed is not None)),
        "mask seeds": list(dict.fromkeys(job.mask_seed for job in jobs if job.mask_seed)),
    }
    return {name: values for name, values in found.items() if len(values) > 1}


def level_table(groups: Groups, level: float) -> Grid:
    """MPIW per DoF, PICP per DoF, mean ratio, at one level.

    Args:
        groups: of the jobs.
        level: coverage asked for, percent.
    """
    columns: dict[str, _Column] = {}
    for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True):
        columns[f"{dof} MPIW ({unit})"] = _Column(_digits(unit), _mean("mpiw", level, (dof,)))
    for dof in DOF_NAMES:
        columns[f"{dof} PICP (%)"] = _Column(1, _mean("picp", level, (dof,)))
    columns["after / before"] = _Column(3, _mean("ratio", level))
    return _grid(groups, columns)


def whole_table(groups: Groups, level: float) -> Grid:
    """All DoF in one line: scores, widths and coverage at one level.

    Args:
        groups: of the jobs.
        level: coverage asked for, percent.
    """
    columns: dict[str, _Column] = {}
    for name, column in (("IS", "is"), ("MPIW", "mpiw")):
        for kind, unit, dofs in (("transl.", "cm", TRANSLATIONS), ("rot.", "°", ROTATIONS)):
            columns[f"{name} {kind} ({unit})"] = _Column(_digits(unit), _mean(column, level, dofs))
    columns["PICP, mean (%)"] = _Column(1, _mean("picp", level))
    columns["PICP, lowest DoF (%)"] = _Column(1, _lowest(level))
    for name, column in (
        ("six at once (%)", "together"),
        ("joint box (%)", "joint"),
        ("Bonferroni (%)", "bonferroni"),
    ):
        columns[name] = _Column(1, _joint(column, level))
    columns["after / before"] = _Column(3, _mean("ratio", level))
    return _grid(groups, columns)


def error_table(groups: Groups) -> Grid:
    """Mean absolute error of one pass without dropout and of the MC mean, per DoF.

    Args:
        groups: of the jobs.
    """
    columns = {
        f"{dof} {name} ({unit})": _Column(_digits(unit), _control(column, dof))
        for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
        for name, column in (("one pass", "mae_single"), ("MC mean", "mae_mean"))
    }
    return _grid(groups, columns)


def camera_table(groups: Groups) -> Grid:
    """What the camera contributes per DoF, with its interval where nothing was repeated.

    Args:
        groups: of the jobs.
    """
    columns = {f"{dof} (%)": _Column(0, _control("contribution", dof)) for dof in DOF_NAMES}
    grid = _grid(groups, columns)
    shown = [DOF_NAMES.index(cell.split()[0]) for cell in grid[0][len(groups.header) :]]
    for line, members in zip(grid[1:], groups.members.values(), strict=True):
        if len(members) == 1:
            for place, dof in enumerate(shown, len(groups.header)):
                line[place] += _interval(members[0].control.get(DOF_NAMES[dof], {}))
    return grid


def mean_and_deviation(values: Sequence[float], digits: int) -> str:
    """Mean ± standard deviation (n - 1) of finite values, the mean alone where there is none.

    Args:
        values: of the replicates; "–" if there are none.
        digits: after the point.

    >>> mean_and_deviation([1.0, 3.0], 2), mean_and_deviation([2.0, math.inf], 2)
    ('2.00 ± 1.41', '∞')
    """
    if not values:
        return number(None, digits)
    mean = number(sum(values) / len(values), digits)
    if len(values) < 2 or not all(map(math.isfinite, values)):
        return mean
    return f"{mean} ± {number(statistics.stdev(values), digits)}"


@dataclass(frozen=True)
class _Column:
    digits: int
    value: Callable[[Job], float]
    """NaN where the job does not have it."""


def _grid(groups: Groups, columns: Mapping[str, _Column]) -> Grid:
    """Columns that no job has are left out."""
    cells = {
        name: [_cell(column, members) for members in groups.members.values()]
        for name, column in columns.items()
    }
    kept = {name: lines for name, lines in cells.items() if set(lines) - {"–"}}
    names = [[*named] for named in groups.members]
    body = [[*name, *(kept[key][i] for key in kept)] for i, name in enumerate(names)]
    return [[*groups.header, *kept], *body]


def _cell(column: _Column, members: Sequence[Job]) -> str:
    values = [column.value(job) for job in members]
    return mean_and_deviation([v for v in values if not math.isnan(v)], column.digits)


def _at(job: Job, level: float) -> list[Mapping[str, str]]:
    return [row for row in job.rows if float(row["level"]) == level]


def _mean(column: str, level: float, dofs: Sequence[str] = DOF_NAMES) -> Callable[[Job], float]:
    """NaN, of a DoF without decalibration, says nothing and is left out."""

    def value(job: Job) -> float:
        values = [float(row[column]) for row in _at(job, level) if row["dof"] in dofs]
        kept = [v for v in values if not math.isnan(v)]
        return sum(kept) / len(kept) if kept else math.nan

    return value


def _lowest(level: float) -> Callable[[Job], float]:
    return lambda job: min((float(row["picp"]) for row in _at(job, level)), default=math.nan)


def _joint(column: str, level: float) -> Callable[[Job], float]:
    return lambda job: float(job.joint.get(level, {}).get(column) or math.nan)


def _control(column: str, dof: str) -> Callable[[Job], float]:
    return lambda job: float(job.control.get(dof, {}).get(column) or math.nan)


def _interval(row: Mapping[str, str]) -> str:
    low, high = (row.get(f"contribution_{end}") for end in ("low", "high"))
    return f" [{float(low):.0f}, {float(high):.0f}]" if low and high else ""


def _digits(unit: str) -> int:
    """Tenths of a millimetre, thousandths of a degree."""
    return 2 if unit == "cm" else 3
