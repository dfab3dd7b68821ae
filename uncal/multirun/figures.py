"""All figures of a multirun, from its summary.csv: lines over a number, or a row of dots per name.

Seaborn takes replicates together: means, and bands or bars from the lowest to the highest.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import cycle
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.multirun.frame import SUMMARY, keys_of, read_summary, replicates
from uncal.multirun.summary import CAPTIONS, FIGURES
from uncal.multirun.tables import groups
from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.figures.named import NamedFigure, save
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
    paper_style,
    shared_legend,
)
from uncal.reporting.layout import csv_text, write_whole

KINDS = (("Translation", DOF_UNITS[0], DOF_NAMES[:3]), ("Rotation", DOF_UNITS[3], DOF_NAMES[3:]))
_ERRORS = {"mae_after": "MC mean", "mae_single": "one pass without dropout"}
_POSE = {"together": "six at once", "joint": "joint box", "bonferroni": "Bonferroni"}

KEY_NAMES = {
    "mcd.passes": "stochastic passes",
    "mcd.masks": "masks",
    "model.backbone_dropout": "backbone dropout rate",
    "model.head_dropout": "head dropout rate",
    "dataset.simulation.lidar.beams": "LiDAR beams",
    "dataset.simulation.n_rigs": "rigs",
    "split.train_frames": "training frames",
    "interval": "interval method",
    "split.by": "split by",
    "split.test": "test set",
}
"""What swept keys are called in a figure; others by themselves."""

PAPERS_CHOICE = {"mcd.passes": 25.0}
"""Marked by a thin line."""

_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, GREY)
_LINES, _MARKERS = ("-", "--", "-.", ":"), "os^Dvp*X"
_MOST_TICKS = 10
_LAW_LABEL = f"{100 * BAND_CONFIDENCE:g} % reference band (Beta-Binomial)"
_LAW = (
    "Shaded: where the Beta-Binomial law of split conformal intervals puts one degree of freedom "
    f"with probability {100 * BAND_CONFIDENCE:g} % if frames are exchangeable; for reference only "
    "with other methods and splits."
)
_POSE_WORDS = (
    "Empirical coverage of all six degrees of freedom at once: by the six intervals together, "
    "which is not guaranteed, by the joint box and by Bonferroni's."
)

Quantity: TypeAlias = tuple[str, float, Sequence[str]]
"""Column, nominal coverage in percent, and the DoF over which to average."""


@dataclass(frozen=True)
class Panel:
    """One panel of a figure.

    Attributes:
        title: above lines.
        axis: what the values are.
        series: label → what is drawn; a DoF has its own look.
        nominal: nominal coverage, a dotted line; the reference band too where ``law``.
        law: whether to shade the reference band.
        bands: whether replicates have bands; those of many lines would hide each other.
        zero: a dotted line at this value.
        relative: each series divided by its value in the first row.
    """

    title: str
    axis: str
    series: Mapping[str, Quantity]
    zero: float | None = None
    law: float | None = None
    bands: bool = True
    relative: bool = False


class Sweep:
    """A multirun's summary, its jobs grouped once."""

    def __init__(self, frame: pd.DataFrame) -> None:
        self.frame = frame
        self.keys = keys_of(frame)
        self.levels = sorted({float(level) for level in frame["level"]})
        self.label = " and ".join(filter(None, frame["label"].unique()))
        self.groups = groups(frame)
        self.replicates = max(map(len, self.groups.values()))
        self.repeated = " and ".join(replicates(frame))

    @cached_property
    def over(self) -> str | None:
        """The swept number with the most values; None if there is none with two."""
        counts = {key: self.frame[key].nunique() for key in self.keys if _numbers(self.frame[key])}
        most = max(counts, key=lambda key: counts[key], default=None)  # the first of several
        return most if most is not None and counts[most] > 1 else None

    @cached_property
    def jobs(self) -> pd.DataFrame:
        """Per job: folder, row (of the group), x (value of the number), others (other keys)."""
        rest = [i for i, key in enumerate(self.keys) if key != self.over]
        jobs: pd.DataFrame = pd.DataFrame(
            [
                {
                    "folder": folder,
                    "row": row,
                    "x": float(values[self.keys.index(self.over)]) if self.over else math.nan,
                    "others": ", ".join(values[i] for i in rest) if self.keys else "",
                }
                for row, (values, folders) in enumerate(self.groups.items())
                for folder in folders
            ]
        )
        return jobs

    @property
    def others(self) -> list[str]:
        """What the lines of a figure over a number differ in."""
        return list(self.jobs["others"].unique()) if len(self.keys) > 1 else []

    @property
    def names(self) -> list[str]:
        """The swept values of each row of dots."""
        return [", ".join(values) if self.keys else "all" for values in self.groups]

    @property
    def words(self) -> str:
        """What the rows differ in."""
        return ", ".join(map(key_name, self.keys)) or self.repeated

    @property
    def spread(self) -> str:
        """What marks, bands and bars are."""
        if self.replicates == 1:
            return "One run per value."
        return (
            f"Marks: means over the {self.repeated} ({self.replicates} runs); bands or bars: from "
            "the lowest to the highest of them."
        )

    def values(self, quantity: Quantity) -> pd.DataFrame:
        """The jobs with a value: means over the DoF, of groups in which all jobs have one."""
        column, level, dofs = quantity
        if column not in self.frame.columns:
            none: pd.DataFrame = self.jobs.iloc[:0].assign(value=[])
            return none
        own = self.frame[(self.frame["level"] == level) & self.frame["dof"].isin(dofs)]
        means = own.groupby("folder")[column].mean()
        jobs: pd.DataFrame = self.jobs.assign(value=self.jobs["folder"].map(means).astype(float))
        finite = np.isfinite(jobs["value"]).groupby(jobs["row"]).transform("all")
        kept: pd.DataFrame = jobs.loc[finite]
        return kept

    def differs(self, panel: Panel) -> bool:
        """Whether there is anything to see: values, and not the same in every row."""
        means = [self.values(q).groupby("row")["value"].mean() for q in panel.series.values()]
        several = len(self.groups) == 1 or any(each.nunique() > 1 for each in means)
        return several and any(len(each) for each in means)


def sweep_figures(folder: Path) -> list[NamedFigure]:
    """Every figure that a multirun's ``summary.csv`` allows.

    Over a swept number, such as ``mcd.passes``, lines; another swept key gives one line per value.
    Without a number, or with more lines than can be told apart, a row of dots per combination.

    Returns:
        No figures as long as there is nothing to compare.

    Raises:
        UncalError: ``summary.csv`` is damaged.
    """
    frame = read_summary(folder / SUMMARY)
    if frame is None:
        return []
    sweep = Sweep(frame)
    if len(sweep.groups) < 2 and sweep.replicates < 2:
        return []
    as_lines = sweep.over is not None and len(sweep.others) <= len(_COLOURS)
    with paper_style():
        drawn = _over_a_number(sweep) if as_lines else _by_name(sweep)
        return [figure for figure in (*drawn, _camera(sweep)) if figure is not None]


def draw_figures(folder: Path) -> list[Path]:
    """Save the figures of a multirun, and their captions for its ``summary.md``.

    Returns:
        The PNG files, in ``<folder>/figures``, each with a PDF beside it.

    Raises:
        UncalError: ``summary.csv`` is damaged.
    """
    figures, target = sweep_figures(folder), folder / FIGURES
    paths = [save(figure, target)[0] for figure in figures]
    listed = target / CAPTIONS
    if figures or listed.exists():
        for name in _listed(listed) - {figure.name for figure in figures}:
            for suffix in (".png", ".pdf"):
                (target / f"{name}{suffix}").unlink(missing_ok=True)
        rows = ([figure.name, figure.title, figure.caption] for figure in figures)
        write_whole(listed, csv_text(("name", "title", "caption"), rows))
    return paths


def _over_a_number(sweep: Sweep) -> list[NamedFigure | None]:
    assert sweep.over is not None
    against, alone = f"against {key_name(sweep.over)}", not sweep.others
    drawn: list[NamedFigure | None] = []
    for name, title, column in (
        ("interval_score", "Interval score", "is"),
        ("interval_width", "Mean width", "mpiw"),
    ):
        panels = [
            Panel(f"{kind}, {v:g} % intervals", f"{title} ({unit})", {"": (column, v, dofs)})
            for v in sweep.levels
            if len(sweep.values((column, v, DOF_NAMES)))
            for kind, unit, dofs in KINDS
        ]
        caption = (
            f"{title} {against}, at each nominal level: mean over X, Y, Z to the left, over roll, "
            f"pitch, yaw to the right. {sweep.spread}"
        )
        if panels:
            figure = _lines(sweep, panels, columns=2)
            drawn.append(NamedFigure(name, f"{title} {against}", caption, figure))
    coverage, caption = _coverage(sweep, by_dof=alone)
    figure = _lines(sweep, coverage, columns=len(coverage))
    drawn.append(NamedFigure("coverage", f"Coverage {against}", caption, figure))
    if alone and "together" in sweep.frame.columns:
        pose = _pose(sweep)
        figure = _lines(sweep, pose, columns=len(pose))
        caption = f"{_POSE_WORDS} Dotted: nominal. {sweep.spread}"
        drawn.append(NamedFigure("whole_pose", f"Whole pose {against}", caption, figure))
    figure = _lines(sweep, _errors(sweep, both=alone), columns=2)
    drawn.append(NamedFigure("point_error", f"Point error {against}", _error_words(sweep), figure))
    return drawn


def _by_name(sweep: Sweep) -> list[NamedFigure | None]:
    by, level = f"by {sweep.words}", sweep.levels[0]
    coverage, caption = _coverage(sweep, by_dof=True)
    drawn: list[NamedFigure | None] = [
        NamedFigure("coverage", f"Coverage {by}", caption, _dots(sweep, coverage))
    ]
    widths = [
        Panel("", f"{title} relative to the first row", _by_dof(column, level), 1.0, relative=True)
        for column, title in (("mpiw", "Mean width"), ("is", "Interval score"))
    ]
    first = [sweep.values((column, level, DOF_NAMES)) for column in ("mpiw", "is")]
    if len(sweep.groups) > 1 and all((each["row"] == 0).any() for each in first):
        caption = (
            f"Mean width (MPIW) and interval score (IS) of {level:g} % intervals, each degree of "
            f"freedom divided by its own in the row “{sweep.names[0]}”. Narrow intervals are "
            "better only if they cover: the interval score counts misses too. " + sweep.spread
        )
        figure = _dots(sweep, widths)
        drawn.append(NamedFigure("interval_width", f"Interval width {by}", caption, figure))
    if "together" in sweep.frame.columns:
        caption = f"{_POSE_WORDS} Dotted: nominal. {sweep.spread}"
        figure = _dots(sweep, _pose(sweep))
        drawn.append(NamedFigure("whole_pose", f"Whole pose {by}", caption, figure))
    errors = _errors(sweep, both=True)
    # The same in all rows with interval methods.
    if sweep.differs(Panel("", "", {n: (c, level, DOF_NAMES) for c, n in _ERRORS.items()})):
        figure = _dots(sweep, errors)
        drawn.append(NamedFigure("point_error", f"Point error {by}", _error_words(sweep), figure))
    return drawn


def _camera(sweep: Sweep) -> NamedFigure | None:
    """None if it is unknown, or the same in all rows, as with stochastic passes."""
    axis = "What the camera contributes (% of the decalibration)"
    panel = Panel("", axis, _by_dof("contribution", sweep.levels[0]), zero=0.0)
    if not sweep.differs(panel):
        return None
    own = sweep.replicates == 1
    words = "Bars: 95 % bootstrap intervals." if own else sweep.spread
    caption = (
        "How much larger the mean absolute error gets when the network sees another frame's image, "
        f"relative to the mean decalibration. At 0 it calibrates blind. {words}"
    )
    title = f"What the camera contributes by {sweep.words}"
    return NamedFigure("camera", title, caption, _dots(sweep, [panel], own_bars=own))


def _coverage(sweep: Sweep, *, by_dof: bool) -> tuple[list[Panel], str]:
    panels = [
        Panel(
            f"{v:g} % intervals",
            "Empirical coverage (%)",
            _by_dof("picp", v) if by_dof else {"": ("picp", v, DOF_NAMES)},
            zero=v,
            law=v if by_dof else None,
            bands=not by_dof,
        )
        for v in sweep.levels
    ]
    if not by_dof:
        return panels, (
            "Empirical coverage, mean over the six degrees of freedom; dotted: nominal. "
            + sweep.spread
        )
    return panels, (
        f"Empirical coverage per degree of freedom; dotted: nominal. {_LAW} {sweep.spread}"
    )


def _pose(sweep: Sweep) -> list[Panel]:
    return [
        Panel(
            f"{v:g} %",
            "All six DoF held (%)",
            {name: (c, v, DOF_NAMES) for c, name in _POSE.items()},
            zero=v,
        )
        for v in sweep.levels
    ]


def _errors(sweep: Sweep, *, both: bool) -> list[Panel]:
    level = sweep.levels[0]  # the errors are the same at all
    shown = _ERRORS if both else {"mae_after": ""}
    return [
        Panel(kind, f"Mean absolute error ({unit})", {n: (c, level, d) for c, n in shown.items()})
        for kind, unit, d in KINDS
    ]


def _error_words(sweep: Sweep) -> str:
    return (
        "Mean absolute error of the estimate: mean over X, Y, Z to the left, over roll, pitch, yaw "
        f"to the right. {sweep.spread}"
    )


def _by_dof(column: str, level: float) -> dict[str, Quantity]:
    return {dof: (column, level, [dof]) for dof in DOF_NAMES}


def _drawn(sweep: Sweep, panel: Panel) -> list[tuple[dict[str, Any], pd.DataFrame]]:
    """Look and values of each series; a nameless one is split by the other swept keys."""
    parts = []
    for label, quantity in panel.series.items():
        values = sweep.values(quantity)
        if label or not sweep.others:
            parts.append((label, values))
        else:
            parts += [(other, values[values["others"] == other]) for other in sweep.others]
    looks = [
        {"label": label, "color": colour, "marker": marker, "linestyle": line}
        for (label, _), colour, marker, line in zip(
            parts, _COLOURS, _MARKERS, cycle(_LINES), strict=False
        )
    ]
    return [
        (dof_style(label) if label in DOF_NAMES else look, values)
        for look, (label, values) in zip(looks, parts, strict=True)
        if len(values)
    ]


def _lines(sweep: Sweep, panels: Sequence[Panel], *, columns: int) -> Figure:
    rows = len(panels) // columns
    height = 0.7 + 1.6 * rows
    figure, axes = new_figure(rows, columns, height=height, label=sweep.label, sharex=True)
    light_grid(axes)
    for index, (axis, panel) in enumerate(zip(axes, panels, strict=True)):
        if panel.zero is not None:
            axis.axhline(panel.zero, color=GREY, linewidth=0.8, linestyle=":")
        if panel.law is not None:
            low, high = (
                sweep.values((f"coverage_{end}", panel.law, DOF_NAMES)).groupby("x")["value"]
                for end in ("low", "high")
            )
            ends = low.min(), high.max()
            axis.fill_between(ends[0].index, *ends, color=BAND_GREY, linewidth=0, label=_LAW_LABEL)
        errorbar = ("pi", 100) if panel.bands and sweep.replicates > 1 else None
        for look, values in _drawn(sweep, panel):
            sns.lineplot(values, x="x", y="value", ax=axis, errorbar=errorbar, legend=False, **look)
        axis.set_title(panel.title)
        axis.set_ylabel(panel.axis if index % columns == 0 or columns == 2 else "")
    _finish_x(sweep, axes, columns)
    if axes[0].get_legend_handles_labels()[1]:
        legend = shared_legend(figure, axes)
        if sweep.others:
            others = ", ".join(key_name(key) for key in sweep.keys if key != sweep.over)
            legend.set_title(sentence(others))
    return figure


def _finish_x(sweep: Sweep, axes: Sequence[Axes], columns: int) -> None:
    """The swept number along x: scale, ticks, the paper's choice."""
    assert sweep.over is not None
    ticks = sorted(sweep.jobs["x"].unique())
    logarithmic = ticks[0] > 0 and ticks[-1] / ticks[0] > 16
    choice = PAPERS_CHOICE.get(sweep.over)
    for axis in axes:
        if choice is not None and ticks[0] < choice < ticks[-1]:
            name = f"{choice:g}, the paper's choice"
            axis.axvline(choice, color=GREY, linewidth=0.8, linestyle="--", label=name)
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


def _dots(sweep: Sweep, panels: Sequence[Panel], *, own_bars: bool = False) -> Figure:
    most = max(len(panel.series) for panel in panels)
    height = min(0.75 + max((0.16 + 0.07 * most) * len(sweep.groups), 0.6), 9.2)
    width = DOUBLE_COLUMN if len(panels) > 1 else (SINGLE_COLUMN + DOUBLE_COLUMN) / 2
    figure, axes = new_figure(1, len(panels), width=width, height=height, label=sweep.label)
    for axis, panel in zip(axes, panels, strict=True):
        if panel.law is not None:
            _law_per_row(axis, sweep, panel.law)
        if panel.zero is not None:
            axis.axvline(panel.zero, color=GREY, linewidth=0.8, linestyle=":")
        drawn = _drawn(sweep, panel)
        for k, (look, values) in enumerate(drawn):
            shift = 0.7 / max(len(drawn), len(DOF_NAMES)) * (k - (len(drawn) - 1) / 2)
            if panel.relative:
                unit = values.loc[values["row"] == 0, "value"].mean()
                values = values.assign(value=values["value"] / unit)
            if own_bars:
                _own_bars(axis, sweep, panel, look, shift)
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
        level = f", {panel.title}" if panel.title else ""
        axis.set_xlabel(f"{panel.axis}{level}")
        axis.set_ylabel("")
    _name_rows(sweep, axes)
    shared_legend(figure, axes)
    return figure


def _law_per_row(axis: Axes, sweep: Sweep, level: float) -> None:
    """The reference band behind each row: sample sizes may differ from row to row."""
    low, high = (sweep.values((f"coverage_{end}", level, DOF_NAMES)) for end in ("low", "high"))
    for row in range(len(sweep.groups)):
        lows, highs = low.loc[low["row"] == row, "value"], high.loc[high["row"] == row, "value"]
        if len(lows) and len(highs):
            label = "" if row else _LAW_LABEL
            corner, width = (lows.min(), row - 0.5), highs.max() - lows.min()
            band = Rectangle(corner, width, 1.0, color=BAND_GREY, linewidth=0, label=label)
            axis.add_patch(band)


def _own_bars(
    axis: Axes, sweep: Sweep, panel: Panel, look: Mapping[str, Any], shift: float
) -> None:
    """The interval that each run gives itself, in place of a spread over several."""
    column, level, dofs = panel.series[look["label"]]
    ends = [sweep.values((f"{column}_{end}", level, dofs)).set_index("row")["value"]
            for end in ("low", "high")]  # fmt: skip
    for row in ends[0].index.intersection(ends[1].index):
        axis.plot([end[row] for end in ends], [row + shift] * 2, color=look["color"], linewidth=1)


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


def key_name(key: str) -> str:
    """What a swept key is called in a figure."""
    return KEY_NAMES.get(key, key)


def sentence(words: str) -> str:
    """A name as the first word of a line; a key stays as it is typed.

    >>> sentence("stochastic passes"), sentence("trainer.max_epochs")
    ('Stochastic passes', 'trainer.max_epochs')
    """
    return words if "." in words else words[:1].upper() + words[1:]


def _numbers(values: pd.Series[str]) -> bool:
    try:
        values.astype(float)
    except ValueError:
        return False
    return True


def _listed(path: Path) -> set[str]:
    if not path.exists():
        return set()
    with path.open(encoding="utf-8", newline="") as file:
        return {row["name"] for row in csv.DictReader(file)}
