"""Figures of a multirun over a number, such as the passes: the paper's ablation."""

from __future__ import annotations

from matplotlib.axes import Axes

from uncal.geometry import DOF_NAMES
from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.style import BAND_GREY, GREY, paper_style
from uncal.reporting.figures.sweep_axis import Over
from uncal.reporting.figures.sweep_marks import lines, numbered, of_dof
from uncal.reporting.figures.sweep_table import (
    Group,
    Quantity,
    Spread,
    mean_of,
)
from uncal.reporting.figures.sweep_words import (
    ERRORS,
    KINDS,
    LAW,
    LAW_LABEL,
    POSE,
    POSE_WORDS,
    key_name,
)


def interval_figure(over: Over, name: str, title: str, column: str) -> NamedFigure | None:
    """Interval score or width against the number: a row of panels per level.

    Args:
        over: what runs along the x axis.
        name: of the figure.
        title: of the quantity, such as "Interval score".
        column: of summary.csv.

    Returns:
        None if all are infinite, because of too small an uncertainty calibration set.
    """
    levels = [level for level in over.sweep.levels if over.sweep.finite(column, level)]
    if not levels:
        return None
    with paper_style():
        figure, panels = over.figure(len(levels), 2)
        for row, level in enumerate(levels):
            for panel, (kind, unit, dofs) in zip(panels[2 * row :], KINDS, strict=False):
                lines(panel, over.drawn(mean_of(column, level, dofs)))
                panel.set_title(f"{kind}, {level:g} % intervals")
                panel.set_ylabel(f"{title} ({unit})")
        over.finish(figure, panels, columns=2)
    against = key_name(over.key)
    text = (
        f"{title} against {against}, at each level asked: mean over X, Y, Z to the left, over "
        f"roll, pitch, yaw to the right. {over.sweep.spread_words}"
    )
    return NamedFigure(name, f"{title} against {against}", text, figure)


def coverage_figure(over: Over) -> NamedFigure:
    """PICP against the number: a panel per level.

    Args:
        over: what runs along the x axis.
    """
    levels = over.sweep.levels
    with paper_style():
        figure, panels = over.figure(1, len(levels))
        for panel, level in zip(panels, levels, strict=True):
            panel.axhline(level, color=GREY, linewidth=0.8, linestyle=":")
            if over.alone:
                _law(panel, over.alone, level)
                series = [
                    of_dof(dof, _points(over.alone, mean_of("picp", level, [dof])))
                    for dof in DOF_NAMES
                ]
                lines(panel, series, bands=False)
            else:
                lines(panel, over.drawn(mean_of("picp", level)))
            panel.set_title(f"{level:g} % intervals")
        panels[0].set_ylabel("Coverage found (%)")
        over.finish(figure, panels, columns=len(levels))
    if over.alone:
        several = ", means over the replicates" if over.sweep.replicates > 1 else ""
        text = f"Coverage found per degree of freedom{several}; dotted: as asked. {LAW}"
    else:
        text = (
            "Coverage found, mean over the six degrees of freedom; dotted: as asked. "
            f"{over.sweep.spread_words}"
        )
    return NamedFigure("coverage", f"Coverage against {key_name(over.key)}", text, figure)


def whole_pose_figure(over: Over) -> NamedFigure | None:
    """How often the whole pose is held, against the number; None if unknown or with other keys.

    Args:
        over: what runs along the x axis.
    """
    if not over.alone or not over.sweep.has("together"):
        return None
    levels = over.sweep.levels
    with paper_style():
        figure, panels = over.figure(1, len(levels))
        for panel, level in zip(panels, levels, strict=True):
            panel.axhline(level, color=GREY, linewidth=0.8, linestyle=":")
            for k, (column, name) in enumerate(POSE.items()):
                points = _points(over.alone, mean_of(column, level))
                lines(panel, [numbered(k, name, points)] if any(points.values()) else [])
            panel.set_title(f"{level:g} %")
        panels[0].set_ylabel("All six DoF held (%)")
        over.finish(figure, panels, columns=len(levels))
    text = f"{POSE_WORDS} Dotted: as asked. {over.sweep.spread_words}"
    return NamedFigure("whole_pose", f"Whole pose against {key_name(over.key)}", text, figure)


def error_figure(over: Over) -> NamedFigure:
    """Mean absolute error against the number; of one pass without dropout too, if known.

    Args:
        over: what runs along the x axis.
    """
    level = over.sweep.levels[0]  # the errors are the same at all
    with paper_style():
        figure, panels = over.figure(1, 2)
        for panel, (kind, unit, dofs) in zip(panels, KINDS, strict=True):
            if over.alone:
                for k, (column, name) in enumerate(ERRORS.items()):
                    points = _points(over.alone, mean_of(column, level, dofs))
                    lines(panel, [numbered(k, name, points)] if any(points.values()) else [])
            else:
                lines(panel, over.drawn(mean_of("mae_after", level, dofs)))
            panel.set_title(kind)
            panel.set_ylabel(f"Mean absolute error ({unit})")
        over.finish(figure, panels, columns=2)
    against = key_name(over.key)
    text = (
        f"Mean absolute error of the estimate against {against}: mean over X, Y, Z to the left, "
        f"over roll, pitch, yaw to the right. {over.sweep.spread_words}"
    )
    return NamedFigure("point_error", f"Point error against {against}", text, figure)


def _points(groups: dict[float, Group], quantity: Quantity) -> dict[float, Spread | None]:
    return {x: quantity(group) for x, group in groups.items()}


def _law(panel: Axes, groups: dict[float, Group], level: float) -> None:
    """The exact law's band, the same for all DoF."""
    ends = {
        x: (low.low, high.high)
        for x, group in sorted(groups.items())
        if (low := group.spread("coverage_low", level))
        and (high := group.spread("coverage_high", level))
    }
    lower, upper = [low for low, _ in ends.values()], [high for _, high in ends.values()]
    panel.fill_between([*ends], lower, upper, color=BAND_GREY, linewidth=0, label=LAW_LABEL)
