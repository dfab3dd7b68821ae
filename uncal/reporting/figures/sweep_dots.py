"""Figures of a multirun over names, such as interval methods: a row of dots per combination."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from uncal.geometry import DOF_NAMES
from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.style import (
    BAND_GREY,
    GREY,
    paper_style,
)
from uncal.reporting.figures.sweep_marks import (
    dots,
)
from uncal.reporting.figures.sweep_rows import (
    by_column,
    by_dof,
    differs,
    finish_rows,
    relative,
    row_figure,
    row_names,
    swept_words,
    with_interval,
)
from uncal.reporting.figures.sweep_table import (
    Sweep,
)
from uncal.reporting.figures.sweep_words import (
    ERRORS,
    KINDS,
    LAW,
    LAW_LABEL,
    POSE,
    POSE_WORDS,
)


def coverage_dots(sweep: Sweep) -> NamedFigure:
    """PICP per DoF, a panel per level, with the exact law's band.

    Args:
        sweep: the multirun.
    """
    with paper_style():
        figure, panels = row_figure(sweep, len(sweep.levels), len(DOF_NAMES))
        for panel, level in zip(panels, sweep.levels, strict=True):
            _law(panel, sweep, level)
            panel.axvline(level, color=GREY, linewidth=0.8, linestyle=":")
            dots(panel, by_dof(sweep, "picp", level))
            panel.set_xlabel(f"Coverage found, {level:g} % asked (%)")
        finish_rows(sweep, figure, panels)
    text = f"Coverage found per degree of freedom; dotted: as asked. {LAW} {sweep.spread_words}"
    return NamedFigure("coverage", f"Coverage by {swept_words(sweep)}", text, figure)


def width_dots(sweep: Sweep) -> NamedFigure | None:
    """MPIW and IS per DoF at the first level, relative to the first row.

    Args:
        sweep: the multirun.

    Returns:
        None if there is nothing to compare.
    """
    level, first = sweep.levels[0], sweep.groups[0]
    names = {"mpiw": "Mean width", "is": "Interval score"}
    if len(sweep.groups) < 2 or not all(first.spread(each, level) for each in names):
        return None
    with paper_style():
        figure, panels = row_figure(sweep, len(names), len(DOF_NAMES))
        for panel, (column, name) in zip(panels, names.items(), strict=True):
            panel.axvline(1.0, color=GREY, linewidth=0.8, linestyle=":")
            dots(panel, [relative(each) for each in by_dof(sweep, column, level)])
            panel.set_xlabel(f"{name} relative to the first row")
        finish_rows(sweep, figure, panels)
    text = (
        f"Mean width (MPIW) and interval score (IS) of {level:g} % intervals, each degree of "
        f"freedom divided by its own in the row “{row_names(sweep)[0]}”. Narrow intervals are "
        f"better only if they cover: the interval score counts misses too. {sweep.spread_words}"
    )
    return NamedFigure("interval_width", f"Interval width by {swept_words(sweep)}", text, figure)


def whole_pose_dots(sweep: Sweep) -> NamedFigure | None:
    """How often the whole pose is held, a panel per level; None if unknown.

    Args:
        sweep: the multirun.
    """
    if not sweep.has("together"):
        return None
    with paper_style():
        figure, panels = row_figure(sweep, len(sweep.levels), len(POSE))
        for panel, level in zip(panels, sweep.levels, strict=True):
            panel.axvline(level, color=GREY, linewidth=0.8, linestyle=":")
            dots(panel, by_column(sweep, POSE, level))
            panel.set_xlabel(f"All six held, {level:g} % asked (%)")
        finish_rows(sweep, figure, panels)
    text = f"{POSE_WORDS} Dotted: as asked. {sweep.spread_words}"
    return NamedFigure("whole_pose", f"Whole pose by {swept_words(sweep)}", text, figure)


def error_dots(sweep: Sweep) -> NamedFigure | None:
    """Mean absolute error, of one pass without dropout too if known.

    Args:
        sweep: the multirun.

    Returns:
        None if it is the same in all rows, as with interval methods.
    """
    level = sweep.levels[0]  # the errors are the same at all
    if not differs(sweep, by_column(sweep, ERRORS, level)):
        return None
    with paper_style():
        figure, panels = row_figure(sweep, len(KINDS), len(ERRORS))
        for panel, (kind, unit, dofs) in zip(panels, KINDS, strict=True):
            dots(panel, by_column(sweep, ERRORS, level, dofs))
            panel.set_xlabel(f"{kind}: mean absolute error ({unit})")
        finish_rows(sweep, figure, panels)
    text = (
        "Mean absolute error of the estimate: mean over X, Y, Z to the left, over roll, pitch, yaw "
        f"to the right. {sweep.spread_words}"
    )
    return NamedFigure("point_error", f"Point error by {swept_words(sweep)}", text, figure)


def camera_dots(sweep: Sweep) -> NamedFigure | None:
    """What the camera contributes per DoF.

    Args:
        sweep: the multirun.

    Returns:
        None if it is unknown, or the same in all rows, as with stochastic passes.
    """
    level = sweep.levels[0]  # the same at all
    series = by_dof(sweep, "contribution", level)
    if not differs(sweep, series):
        return None
    words = sweep.spread_words
    if sweep.replicates == 1:
        series = [with_interval(sweep, each, "contribution", level) for each in series]
        words = "Bars: 95 % bootstrap intervals."
    with paper_style():
        figure, panels = row_figure(sweep, 1, len(DOF_NAMES))
        panels[0].axvline(0.0, color=GREY, linewidth=0.8, linestyle=":")
        dots(panels[0], series)
        panels[0].set_xlabel("What the camera contributes (% of the decalibration)")
        finish_rows(sweep, figure, panels)
    text = (
        "How much larger the mean absolute error gets when the network sees another frame's image, "
        f"relative to the mean decalibration. At 0 it calibrates blind. {words}"
    )
    return NamedFigure(
        "camera", f"What the camera contributes by {swept_words(sweep)}", text, figure
    )


def _law(panel: Axes, sweep: Sweep, level: float) -> None:
    """The exact law's band behind each row: sample sizes may differ from row to row."""
    for row, group in enumerate(sweep.groups):
        low, high = (group.spread(f"coverage_{end}", level) for end in ("low", "high"))
        if low and high:
            corner, width = (low.low, row - 0.5), high.high - low.low
            label = "" if row else LAW_LABEL
            band = Rectangle(corner, width, 1.0, color=BAND_GREY, linewidth=0, label=label)
            panel.add_patch(band)
