"""How figures of a multirun show series: lines over a number, or a row of dots per name.

Seaborn takes replicates together: means, and bands or bars from the lowest to the highest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import pandas as pd
import seaborn as sns
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uncal.geometry import DOF_NAMES
from uncal.multirun.sweep import Quantity, Sweep, key_name, sentence
from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.figures.style import (
    BAND_GREY,
    BLACK,
    BLUE,
    DOUBLE_COLUMN,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SINGLE_COLUMN,
    SKY,
    VERMILION,
    dof_style,
    light_grid,
    new_figure,
    shared_legend,
)

COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, GREY)
"""Of series that are no DoF; more than these nobody tells apart."""

PAPERS_CHOICE = {"mcd.passes": 25.0}
"""Marked by a thin line."""

_LINES, _MARKERS = ("-", "--", "-.", ":"), "os^Dvp*X"
_DOTTED: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": ":"}
_BAND: dict[str, Any] = {
    "color": BAND_GREY,
    "linewidth": 0,
    "label": f"{100 * BAND_CONFIDENCE:g} % reference band (Beta-Binomial)",
}
_MOST_TICKS = 10


@dataclass(frozen=True)
class Panel:
    """One panel of a figure.

    Attributes:
        title: what tells it from its neighbours.
        axis: what the values are.
        series: label → what is drawn; a DoF has its own look. One without a label is split by the
            other swept keys.
        reference: a dotted line at this value.
        law: whether to shade the reference band at the nominal coverage ``reference``.
        relative: whether each series is divided by its value in the first row.
    """

    title: str
    axis: str
    series: Mapping[str, Quantity]
    reference: float | None = None
    law: bool = False
    relative: bool = False


def lines(sweep: Sweep, panels: Sequence[Panel], columns: int) -> Figure:
    """Panels over the swept number, a row of them at a time."""
    rows = len(panels) // columns
    height = 0.7 + 1.6 * rows
    figure, axes = new_figure(rows, columns, height=height, label=sweep.label, sharex=True)
    light_grid(axes)
    for index, (axis, panel) in enumerate(zip(axes, panels, strict=True)):
        if panel.reference is not None:
            axis.axhline(panel.reference, **_DOTTED)
        if panel.law and panel.reference is not None:
            low, high = sweep.band(panel.reference, "x")
            axis.fill_between(low.index, low, high, **_BAND)
        # The bands of six DoF would hide each other.
        errorbar = ("pi", 100) if sweep.replicates > 1 and len(panel.series) < 6 else None
        for look, values in _drawn(sweep, panel):
            edge = {"markeredgecolor": look["color"]}
            sns.lineplot(
                values, x="x", y="value", ax=axis, errorbar=errorbar, legend=False, **look, **edge
            )
        axis.set_title(panel.title)
        axis.set_ylabel(panel.axis if index % columns == 0 or columns == 2 else "")
    _finish_x(sweep, axes, columns)
    if axes[0].get_legend_handles_labels()[1]:
        legend = shared_legend(figure, axes)
        if sweep.others:
            others = ", ".join(key_name(key) for key in sweep.keys if key != sweep.over)
            legend.set_title(sentence(others))
    return figure


def dots(sweep: Sweep, panels: Sequence[Panel], *, own_bars: bool = False) -> Figure:
    """Panels side by side, with a row per combination of swept values."""
    most = max(len(panel.series) for panel in panels)
    height = min(0.75 + max((0.16 + 0.07 * most) * len(sweep.groups), 0.6), 9.2)
    width = DOUBLE_COLUMN if len(panels) > 1 else (SINGLE_COLUMN + DOUBLE_COLUMN) / 2
    figure, axes = new_figure(1, len(panels), width=width, height=height, label=sweep.label)
    for axis, panel in zip(axes, panels, strict=True):
        if panel.law and panel.reference is not None:
            low, high = sweep.band(panel.reference, "row")
            for row in low.index:
                band = _BAND if row == low.index[0] else {**_BAND, "label": None}
                axis.fill_betweenx([row - 0.5, row + 0.5], low[row], high[row], **band)
        if panel.reference is not None:
            axis.axvline(panel.reference, **_DOTTED)
        drawn = _drawn(sweep, panel)
        for k, (look, values) in enumerate(drawn):
            shift = 0.7 / max(len(drawn), len(DOF_NAMES)) * (k - (len(drawn) - 1) / 2)
            if panel.relative:
                unit = values.loc[values["row"] == 0, "value"].mean()
                values = values.assign(value=values["value"] / unit)
            if own_bars:  # the interval that each run gives itself
                column, level, dofs = panel.series[look["label"]]
                low, high = (
                    values["folder"].map(sweep.per_job((f"{column}_{end}", level, dofs)))
                    for end in ("low", "high")
                )
                rows = values["row"] + shift
                axis.plot([low, high], [rows, rows], color=look["color"], linewidth=1)
            _dot_series(axis, values.assign(row=values["row"] + shift), look, sweep.replicates)
        axis.set_xlabel(f"{panel.axis}\n{panel.title}".strip())
        axis.set_ylabel("")
    _name_rows(sweep, axes)
    shared_legend(figure, axes)
    return figure


def _drawn(sweep: Sweep, panel: Panel) -> list[tuple[dict[str, Any], pd.DataFrame]]:
    """Look and values of each series."""
    parts: list[tuple[str, pd.DataFrame]] = []
    for label, quantity in panel.series.items():
        values = sweep.values(quantity)
        split = sweep.others if not label else []
        parts += [(other, values[values["others"] == other]) for other in split] or [
            (label, values)
        ]
    looks = zip(parts, COLOURS, _MARKERS, cycle(_LINES), strict=False)
    return [
        (
            dof_style(label)
            if label in DOF_NAMES
            else {"label": label, "color": colour, "marker": marker, "linestyle": line},
            values,
        )
        for (label, values), colour, marker, line in looks
        if len(values)
    ]


def _dot_series(axis: Axes, values: pd.DataFrame, look: Mapping[str, Any], replicates: int) -> None:
    sns.pointplot(
        values,
        x="value",
        y="row",
        orient="h",
        native_scale=True,
        errorbar=("pi", 100) if replicates > 1 else None,
        err_kws={"linewidth": 1.0},
        ax=axis,
        legend=False,
        color=look["color"],
        markers=look["marker"],
        markersize=3.5,
        linestyle="none",
        label=look["label"],
    )


def _finish_x(sweep: Sweep, axes: Sequence[Axes], columns: int) -> None:
    """The swept number along x: scale, ticks, the paper's choice."""
    assert sweep.over is not None
    ticks = sorted(sweep.jobs["x"].unique())
    logarithmic = ticks[0] > 0 and ticks[-1] / ticks[0] > 16
    choice = PAPERS_CHOICE.get(sweep.over)
    for axis in axes:
        if choice is not None and ticks[0] < choice < ticks[-1]:
            label = f"{choice:g}, the paper's choice"
            axis.axvline(choice, color=GREY, linewidth=0.8, linestyle="--", label=label)
        if logarithmic:
            axis.set_xscale("log")
        if len(ticks) <= _MOST_TICKS:
            axis.set_xticks(ticks, _spaced(ticks, columns, math.log if logarithmic else float))
            axis.minorticks_off()
        axis.set_xlabel("")
    for axis in axes[-columns:]:
        axis.set_xlabel(sentence(key_name(sweep.over)))


def _spaced(ticks: Sequence[float], columns: int, scale: Callable[[float], float]) -> list[str]:
    """Labels of ticks, those left out that would touch the one before."""
    inches = (DOUBLE_COLUMN / columns - 0.5) / (scale(ticks[-1]) - scale(ticks[0]))
    labels, free = [], -math.inf
    for tick in ticks:
        label = f"{tick:g}"
        half, middle = 0.03 * (len(label) + 1), inches * scale(tick)
        fits = middle - half >= free
        labels.append(label if fits else "")
        free = middle + half if fits else free
    return labels


def _name_rows(sweep: Sweep, axes: Sequence[Axes]) -> None:
    """Swept values at the rows of dots, the first on top, with faint lines between the rows."""
    names = sweep.names
    for axis in axes:
        axis.set_ylim(len(names) - 0.5, -0.5)
        axis.set_yticks(range(len(names)), [])
        axis.tick_params(axis="y", length=0)
        axis.grid(visible=True, axis="x")
        for edge in range(1, len(names)):
            axis.axhline(edge - 0.5, color="#BFBFBF", linewidth=0.5)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].set_ylabel(sentence(sweep.words))
