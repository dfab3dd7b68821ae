"""The rows of a multirun's dot plots: one per combination of swept values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uncal.geometry import DOF_NAMES
from uncal.reporting.figures.style import DOUBLE_COLUMN, SINGLE_COLUMN, new_figure, shared_legend
from uncal.reporting.figures.sweep_marks import Series, name_rows, numbered, of_dof
from uncal.reporting.figures.sweep_table import Spread, Sweep
from uncal.reporting.figures.sweep_words import key_name, sentence

_MARGIN, _PAGE_HEIGHT = 0.75, 9.2
"""Inches: what is not rows, and the most that fits a page."""


def row_figure(sweep: Sweep, columns: int, series: int) -> tuple[Figure, list[Axes]]:
    """Panels beside each other, with room for a row per combination of swept values.

    Args:
        sweep: the multirun.
        columns: of panels.
        series: dots of a row.
    """
    height = _MARGIN + max((0.16 + 0.07 * series) * len(sweep.groups), 0.6)
    height = min(height, _PAGE_HEIGHT)
    width = DOUBLE_COLUMN if columns > 1 else (SINGLE_COLUMN + DOUBLE_COLUMN) / 2
    return new_figure(1, columns, width=width, height=height, label=sweep.label)


def finish_rows(sweep: Sweep, figure: Figure, panels: list[Axes]) -> None:
    """Add what all panels need: the names of the rows and the legend.

    Args:
        sweep: the multirun.
        figure: of :func:`row_figure`.
        panels: drawn.
    """
    name_rows(panels, row_names(sweep))
    panels[0].set_ylabel(sentence(swept_words(sweep)))
    shared_legend(figure, panels)


def row_names(sweep: Sweep) -> list[str]:
    """The swept values of each row.

    Args:
        sweep: the multirun.
    """
    return [", ".join(group.values) or "all" for group in sweep.groups]


def swept_words(sweep: Sweep) -> str:
    """What the rows differ in.

    Args:
        sweep: the multirun.
    """
    return ", ".join(map(key_name, sweep.keys)) or sweep.repeated


def by_dof(sweep: Sweep, column: str, level: float) -> list[Series]:
    """A series for each DoF.

    Args:
        sweep: the multirun.
        column: of summary.csv.
        level: coverage asked for, percent.
    """
    return [of_dof(dof, _points(sweep, column, level, [dof])) for dof in DOF_NAMES]


def by_column(
    sweep: Sweep, columns: dict[str, str], level: float, dofs: Sequence[str] = DOF_NAMES
) -> list[Series]:
    """A series for each column that a job has.

    Args:
        sweep: the multirun.
        columns: of summary.csv → what they are called.
        level: coverage asked for, percent.
        dofs: over which to average.
    """
    return [
        numbered(k, name, _points(sweep, column, level, dofs))
        for k, (column, name) in enumerate(columns.items())
        if sweep.has(column)
    ]


def relative(series: Series) -> Series:
    """Divided by the first row; empty where that has none.

    Args:
        series: over rows.
    """
    unit = series.points.get(0.0)
    scaled = {
        row: spread.over(unit.mean) for row, spread in series.points.items() if unit and unit.mean
    }
    return replace(series, points=scaled)


def with_interval(sweep: Sweep, series: Series, column: str, level: float) -> Series:
    """The interval that each run gives itself, instead of the spread over several.

    Args:
        sweep: the multirun, without replicates.
        series: of a DoF.
        column: of summary.csv that it shows; two more say where the interval ends.
        level: coverage asked for, percent.
    """
    low, high = (
        _points(sweep, f"{column}_{end}", level, [series.label]) for end in ("low", "high")
    )
    points = {
        row: Spread(spread.mean, below.mean, above.mean, count=2)
        if (below := low[row]) and (above := high[row])
        else spread
        for row, spread in series.points.items()
    }
    return replace(series, points=points)


def differs(sweep: Sweep, series: Sequence[Series]) -> bool:
    """Whether there is anything to see: values, and not the same in every row.

    Args:
        sweep: the multirun.
        series: over its rows.
    """
    shown = [{spread.mean for spread in each.points.values()} for each in series]
    return any(shown) and (len(sweep.groups) == 1 or any(len(values) > 1 for values in shown))


def _points(
    sweep: Sweep, column: str, level: float, dofs: Sequence[str]
) -> dict[float, Spread | None]:
    return {float(row): group.spread(column, level, dofs) for row, group in enumerate(sweep.groups)}
