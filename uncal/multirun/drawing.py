"""How figures of a multirun show series: lines over a number, or a row of dots per name.

Seaborn takes replicates together: means, and bands or bars from the lowest to the highest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uncal.geometry import DOF_NAMES
from uncal.multirun.sweep import Quantity, Sweep, key_name, sentence
from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.figures import style

COLOURS = (*style.DOF_COLOURS.values(), style.BLACK, style.GREY)
"""Of series that are no DoF; more than these nobody tells apart."""

PAPERS_CHOICE = {"mcd.passes": 25.0}
"""Marked by a thin line."""

_LINES, _MARKERS = ("-", "--", "-.", ":"), "os^Dvp*X"
_BAND: dict[str, Any] = {
    "color": style.BAND_GREY,
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
        law: nominal coverage in percent whose reference band is shaded.
        relative: whether each series is divided by its value in the first row.
    """

    title: str
    axis: str
    series: Mapping[str, Quantity]
    reference: float | None = None
    law: float | None = None
    relative: bool = False


def lines(sweep: Sweep, panels: Sequence[Panel], columns: int) -> Figure:
    """Panels over the swept number, a row of them at a time."""
    rows = len(panels) // columns
    height = 0.7 + 1.6 * rows
    figure, axes = style.new_figure(rows, columns, height=height, label=sweep.label, sharex=True)
    for index, (axis, panel) in enumerate(zip(axes, panels, strict=True)):
        if panel.reference is not None:
            axis.axhline(panel.reference, **style.REFERENCE)
        if panel.law is not None:
            low, high = sweep.band(panel.law, "x")
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
        legend = style.shared_legend(figure, axes)
        if sweep.others:
            others = ", ".join(key_name(key) for key in sweep.keys if key != sweep.over)
            legend.set_title(sentence(others))
    return figure


def dots(sweep: Sweep, panels: Sequence[Panel], *, own_bars: bool = False) -> Figure:
    """Panels side by side, with a row per combination of swept values."""
    most = max(len(panel.series) for panel in panels)
    height = min(0.75 + max((0.16 + 0.07 * most) * len(sweep.groups), 0.6), 9.2)
    width = (
        style.DOUBLE_COLUMN if len(panels) > 1 else (style.SINGLE_COLUMN + style.DOUBLE_COLUMN) / 2
    )
    figure, axes = style.new_figure(1, len(panels), width=width, height=height, label=sweep.label)
    for axis, panel in zip(axes, panels, strict=True):
        if panel.law is not None:
            low, high = sweep.band(panel.law, "row")
            for row in low.index:
                band = _BAND if row == low.index[0] else {**_BAND, "label": None}
                axis.fill_betweenx([row - 0.5, row + 0.5], low[row], high[row], **band)
        if panel.reference is not None:
            axis.axvline(panel.reference, **style.REFERENCE)
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
            sns.pointplot(
                values.assign(row=values["row"] + shift),
                x="value",
                y="row",
                orient="h",
                native_scale=True,
                errorbar=("pi", 100) if sweep.replicates > 1 else None,
                err_kws={"linewidth": 1.0},
                ax=axis,
                legend=False,
                color=look["color"],
                markers=look["marker"],
                markersize=3.5,
                linestyle="none",
                label=look["label"],
            )
        axis.set_xlabel(f"{panel.axis}\n{panel.title}".strip())
        axis.set_ylabel("")
    _name_rows(sweep, axes)
    style.shared_legend(figure, axes)
    return figure


def _drawn(sweep: Sweep, panel: Panel) -> list[tuple[dict[str, Any], pd.DataFrame]]:
    """Look and values of each series."""
    parts = {label: sweep.values(quantity) for label, quantity in panel.series.items()}
    if "" in parts and sweep.others:
        parts = {str(o): own for o, own in parts[""].groupby("others", sort=False)}
    looks = zip(parts.items(), COLOURS, _MARKERS, cycle(_LINES), strict=False)
    drawn = []
    for (label, values), colour, marker, line in looks:
        own = {"label": label, "color": colour, "marker": marker, "linestyle": line}
        if len(values):
            drawn.append((style.dof_style(label) if label in DOF_NAMES else own, values))
    return drawn


def _finish_x(sweep: Sweep, axes: Sequence[Axes], columns: int) -> None:
    """The swept number along x: scale, ticks, the paper's choice."""
    assert sweep.over is not None
    ticks = sorted(sweep.jobs["x"].unique())
    logarithmic = ticks[0] > 0 and ticks[-1] / ticks[0] > 16
    choice = PAPERS_CHOICE.get(sweep.over)
    places = np.log(ticks) if logarithmic else np.array(ticks)
    # Inches from one tick to the next, below which their labels would touch.
    closest = (style.DOUBLE_COLUMN / columns - 0.5) * np.diff(places).min() / np.ptp(places)
    for axis in axes:
        if choice is not None and ticks[0] < choice < ticks[-1]:
            label = f"{choice:g}, the paper's choice"
            axis.axvline(choice, color=style.GREY, linewidth=0.8, linestyle="--", label=label)
        if logarithmic:
            axis.set_xscale("log")
        if len(ticks) <= _MOST_TICKS:
            axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            axis.minorticks_off()
            axis.tick_params(axis="x", rotation=90 if closest < 0.25 else 0)
        axis.set_xlabel("")
    for axis in axes[-columns:]:
        axis.set_xlabel(sentence(key_name(sweep.over)))


def _name_rows(sweep: Sweep, axes: Sequence[Axes]) -> None:
    """Swept values at the rows of dots, the first on top, with faint lines between the rows."""
    names = sweep.names
    for axis in axes:
        axis.set_ylim(len(names) - 0.5, -0.5)
        axis.set_yticks(range(len(names)), [])
        axis.tick_params(axis="y", length=0)
        axis.grid(visible=False, axis="y")
        for edge in range(1, len(names)):
            axis.axhline(edge - 0.5, color="#BFBFBF", linewidth=0.5)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].set_ylabel(sentence(sweep.words))
