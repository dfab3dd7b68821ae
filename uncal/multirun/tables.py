"""The tables of a multirun's summary: swept values as rows, replicates taken together."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.multirun.frame import keys_of, replicates
from uncal.reporting.layout import Grid, number

if TYPE_CHECKING:
    import pandas as pd

    Columns: TypeAlias = Mapping[str, tuple[int, pd.Series[float] | None]]
    """Heading → digits, and the value per job (folder); None where no job has it."""

KINDS = (("transl.", "cm", DOF_NAMES[:3]), ("rot.", "°", DOF_NAMES[3:]))

_POSE = {"six at once": "together", "joint box": "joint", "Bonferroni": "bonferroni"}


def level_table(frame: pd.DataFrame, level: float) -> Grid:
    """MPIW per DoF, PICP per DoF, mean ratio, at one nominal coverage in percent."""
    at = frame[frame["level"] == level]
    columns = _per_dof(at, {"MPIW": "mpiw"})
    columns |= {f"{dof} PICP (%)": (1, _per_job(at, "picp", [dof])) for dof in DOF_NAMES}
    columns["after / before"] = (3, _per_job(at, "ratio"))
    return _grid(frame, columns)


def pose_table(frame: pd.DataFrame, level: float) -> Grid:
    """All DoF in one line: scores, widths and coverage at one nominal coverage in percent."""
    at = frame[frame["level"] == level]
    columns: dict[str, tuple[int, pd.Series[float] | None]] = {}
    for name, column in (("IS", "is"), ("MPIW", "mpiw")):
        for kind, unit, dofs in KINDS:
            columns[f"{name} {kind} ({unit})"] = (_digits(unit), _per_job(at, column, dofs))
    columns["PICP, mean (%)"] = (1, _per_job(at, "picp"))
    columns["PICP, lowest DoF (%)"] = (1, at.groupby("folder")["picp"].min())
    columns |= {f"{name} (%)": (1, _per_job(at, column)) for name, column in _POSE.items()}
    columns["after / before"] = (3, _per_job(at, "ratio"))
    return _grid(frame, columns)


def error_table(frame: pd.DataFrame) -> Grid:
    """Mean absolute error of one pass without dropout and of the MC mean, per DoF."""
    return _grid(frame, _per_dof(frame, {"one pass": "mae_single", "MC mean": "mae_mean"}))


def camera_table(frame: pd.DataFrame) -> Grid:
    """What the camera contributes per DoF, with its interval where nothing was repeated."""
    columns = {f"{dof} (%)": (0, _per_job(frame, "contribution", [dof])) for dof in DOF_NAMES}
    grid = _grid(frame, columns)
    ends = [frame.pivot_table(index="folder", columns="dof", values=f"contribution_{end}")
            for end in ("low", "high")]  # fmt: skip
    for line, folders in zip(grid[1:], groups(frame).values(), strict=True):
        for index, heading in enumerate(grid[0]):
            dof = heading.removesuffix(" (%)")
            if dof in DOF_NAMES and len(folders) == 1 and line[index] != "–":
                low, high = (end.loc[folders[0], dof] for end in ends)
                line[index] += f" [{low:.0f}, {high:.0f}]"
    return grid


def groups(frame: pd.DataFrame) -> dict[tuple[str, ...], list[str]]:
    """Swept values → folders of the jobs that differ only in seeds, in the order of the jobs."""
    # Without a swept key the folder tells jobs apart, unless it is a seed that does.
    keys = keys_of(frame) or ([] if replicates(frame) else ["folder"])
    found: dict[tuple[str, ...], list[str]] = {}
    for row in frame.drop_duplicates("folder")[[*keys, "folder"]].itertuples(index=False):
        found.setdefault(tuple(map(str, row[: len(keys)])) or ("all",), []).append(str(row[-1]))
    return found


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


def _per_dof(
    frame: pd.DataFrame, quantities: Mapping[str, str]
) -> dict[str, tuple[int, pd.Series[float] | None]]:
    return {
        f"{dof} {name} ({unit})": (_digits(unit), _per_job(frame, column, [dof]))
        for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
        for name, column in quantities.items()
    }


def _per_job(
    frame: pd.DataFrame, column: str, dofs: Sequence[str] = DOF_NAMES
) -> pd.Series[float] | None:
    """Mean over the DoF that have it; a DoF without decalibration has NaN."""
    if column not in frame.columns:
        return None
    means: pd.Series[float] = frame[frame["dof"].isin(dofs)].groupby("folder")[column].mean()
    return means


def _grid(frame: pd.DataFrame, columns: Columns) -> Grid:
    """A line per group; columns that no job has are left out."""
    members, repeated = groups(frame), replicates(frame)
    header = [*(keys_of(frame) or ["job"]), *([" × ".join(repeated)] if repeated else [])]
    lines = [
        [*values, *([str(len(folders))] if repeated else [])] for values, folders in members.items()
    ]
    for heading, (digits, per_job) in columns.items():
        if per_job is None:
            continue
        cells = [
            mean_and_deviation(per_job.reindex(folders).dropna().tolist(), digits)
            for folders in members.values()
        ]
        if set(cells) != {"–"}:
            header.append(heading)
            for line, cell in zip(lines, cells, strict=True):
                line.append(cell)
    return [header, *lines]


def _digits(unit: str) -> int:
    """Tenths of a millimetre, thousandths of a degree."""
    return 2 if unit == "cm" else 3
