"""The experiment's figure: what is noticed of a step, and what is left of it."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
from matplotlib.axes import Axes

from uncal.geometry import DOF_NAMES
from uncal.monitor.experiment.cases import STEP
from uncal.monitor.experiment.summary import WATCHERS
from uncal.reporting.figures.style import (
    BLUE,
    ORANGE,
    REFERENCE,
    VERMILION,
    NamedFigure,
    new_figure,
    paper_style,
    shared_legend,
)

NAME = "monitor_steps"

_KINDS = (("Translations", "cm", DOF_NAMES[:3]), ("Rotations", "°", DOF_NAMES[3:]))
_MARKS = ((BLUE, "o", "-"), (VERMILION, "s", "--"), (ORANGE, "^", "-."))
_LOOKS = dict(zip(WATCHERS, _MARKS, strict=True))
_CAPTION = (
    "Steps of one DoF in simulated drives. Above: share of the drives in which the step is "
    "noticed before the drive ends. Below: error of that DoF over the last window; dotted: of the "
    "extrinsic that nobody corrects. Lines: mean over the three DoF; small marks: each of them."
)


def steps_figure(tables: Mapping[str, pd.DataFrame]) -> NamedFigure | None:
    """Detection and error against the size of the step, of the monitor and the plainer watchers.

    Args:
        tables: by name, as :meth:`uncal.monitor.experiment.summary.Experiment.tables`.

    Returns:
        The figure; None where no drive has had a step yet.
    """
    detection, error = (_steps(tables[name]) for name in ("detection", "error"))
    if detection.empty or error.empty:
        return None
    with paper_style():
        figure, panels = new_figure(2, 2, height=4.0, label="simulated street-scene")
        for column, (kind, unit, dofs) in enumerate(_KINDS):
            noticed, left = panels[column], panels[2 + column]
            for watcher, label in WATCHERS.items():
                _line(noticed, detection, dofs, f"{watcher}_detected", watcher, label)
                _line(left, error, dofs, f"{watcher}_dof", watcher, label)
            ends = [0.0, float(error[error["dof"].isin(dofs)]["size"].max())]
            left.plot(ends, ends, label="nothing done", **REFERENCE)
            for panel in (noticed, left):
                panel.set_xlim(0.0, 1.05 * ends[1])
            noticed.set(title=kind, ylim=(-5, 105), ylabel="Steps noticed (%)")
            left.set(xlabel=f"Size of the step ({unit})", ylabel=f"Error at the end ({unit})")
        shared_legend(figure, panels)
    return NamedFigure(NAME, "Steps: noticed, and what is left of them", _CAPTION, figure)


def _steps(table: pd.DataFrame) -> pd.DataFrame:
    return table[table["case"] == STEP] if len(table) else table


def _line(
    panel: Axes, table: pd.DataFrame, dofs: tuple[str, ...], column: str, watcher: str, label: str
) -> None:
    """Mean over the DoF against the size, and each DoF as a small mark."""
    colour, marker, line = _LOOKS[watcher]
    rows = table[table["dof"].isin(dofs)]
    mean = rows.groupby("size")[column].mean()
    panel.plot(mean.index, mean, color=colour, marker=marker, linestyle=line, label=label)
    panel.plot(rows["size"], rows[column], marker, color=colour, markersize=2, alpha=0.4)
