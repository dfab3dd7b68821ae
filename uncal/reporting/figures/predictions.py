"""Figures of the single predictions: intervals around the truth, and their widths."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.stats import spearmanr  # type: ignore[import-untyped]

from uncal.reporting.figures import style
from uncal.reporting.figures.style import NamedFigure
from uncal.reporting.frames import bound_columns, bound_levels

Column: TypeAlias = NDArray[np.float64]

WINDOWS = 25
"""How many windows of the moving average stand side by side in a panel."""

POINTS = 500
"""At least so many of the smoothed values are drawn, if there are."""

LEVEL = 90.0
"""Percent; of a run without it the lowest level with finite intervals is shown."""


def ordered_intervals(predictions: pd.DataFrame, label: str) -> NamedFigure:
    """Six panels of nested intervals, bounds minus truth, smoothed by a moving average."""
    n = len(predictions) // 6
    window = smoothing_window(n)
    with style.paper_style():
        figure, panels = style.new_figure(2, 3, height=4.1, label=label, sharex=True)
        for panel, (_, rows) in zip(panels, predictions.groupby("dof", sort=False), strict=True):
            _draw_regions(panel, rows, window)
        for panel in panels[3:]:
            panel.set_xlabel("Test frame, in order of truth")
        style.shared_legend(figure, panels)
    caption = _caption(predictions, n, window)
    return NamedFigure("ordered_intervals", "Ordered prediction intervals", caption, figure)


def smoothing_window(n: int) -> int:
    """Frames of the moving average: odd, about n / :data:`WINDOWS`.

    >>> smoothing_window(10), smoothing_window(200), smoothing_window(5000)
    (1, 9, 201)
    """
    return 2 * (n // (2 * WINDOWS)) + 1


def moving_average(values: Column, window: int) -> Column:
    """(n,) means of the ``window`` (odd) values around each; at both ends of those there are.

    A mean with an infinite one among them is NaN.

    >>> moving_average(np.array([0.0, 3.0, 6.0, 3.0]), window=3).tolist()
    [1.5, 3.0, 4.0, 4.5]
    """
    around = pd.DataFrame({"value": values, "infinite": ~np.isfinite(values)}).rolling(
        window, center=True, min_periods=1
    )
    means: Column = around["value"].mean().mask(around["infinite"].max() > 0).to_numpy()
    return means


def bounds(rows: pd.DataFrame, level: float) -> tuple[Column, Column]:
    """Lower and upper ends of a level's intervals, percent."""
    lower, upper = bound_columns(level)
    return rows[lower].to_numpy(), rows[upper].to_numpy()


def covered(rows: pd.DataFrame, level: float) -> NDArray[np.bool_]:
    """(n,) whether each interval of a level holds the truth."""
    (lower, upper), truth = bounds(rows, level), rows["truth"].to_numpy()
    return np.asarray((lower <= truth) & (truth <= upper))


def width_against_error(predictions: pd.DataFrame, label: str) -> NamedFigure | None:
    """Interval width against |error| per DoF; None where no level is finite in all of them."""
    finite = [v for v in bound_levels(predictions) if np.isfinite(bounds(predictions, v)).all()]
    if not finite:
        return None
    level = LEVEL if LEVEL in finite else finite[0]
    lower, upper = bounds(predictions, level)
    off = np.abs((lower + upper) / 2 - predictions["estimate"].to_numpy())
    above = "above it the interval holds the truth."
    if (off > 1e-6 * (upper - lower)).any():
        above = "these intervals are not centred on the estimate, so it is only a guide."
    with style.paper_style():
        figure, panels = style.new_figure(2, 3, height=4.3, label=label)
        for panel, (_, rows) in zip(panels, predictions.groupby("dof", sort=False), strict=True):
            _draw_points(panel, rows, level)
        for handle in style.shared_legend(figure, panels).legend_handles:
            if handle is not None:
                handle.set_alpha(1.0)
    return NamedFigure(
        "width_against_error",
        f"Width of the {level:g} % intervals against error",
        f"Each point is one of {len(predictions) // 6} test frames. ρ is Spearman's rank "
        "correlation of width and |error|: 0 where the width says nothing about the error. "
        f"Dashed: width = 2 |error|; {above}",
        figure,
    )


def rank_correlation(width: Column, error: Column) -> float:
    """Spearman's ρ, NaN where all widths or errors are equal up to rounding.

    >>> rank_correlation(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.4, 0.5]))
    1.0
    """
    if len(width) < 2 or any(np.ptp(values) <= 1e-9 * values.max() for values in (width, error)):
        return float("nan")
    return float(round(spearmanr(width, error).statistic, 12))


def _draw_points(panel: Axes, rows: pd.DataFrame, level: float) -> None:
    lower, upper = bounds(rows, level)
    width, error = upper - lower, np.abs((rows["estimate"] - rows["truth"]).to_numpy())
    held = covered(rows, level)
    n = len(held)
    # Density must show among thousands of points, and single points among few.
    size, alpha = float(np.clip(1500 / n, 2.5, 9.0)), float(np.clip(12 / n**0.5, 0.15, 0.7))
    for chosen, colour, marker, strength, text in (
        (held, style.BLUE, "o", alpha, "truth inside the interval"),
        (~held, style.VERMILION, "^", min(1.0, 2.5 * alpha), "truth outside"),
    ):
        panel.scatter(
            error[chosen], width[chosen], s=size, c=colour, marker=marker, alpha=strength,
            linewidths=0, rasterized=True, label=text,
        )  # fmt: skip
    right, top = 1.05 * max(error.max(), 1e-12), 1.08 * width.max()
    panel.plot(
        [0, right], [0, 2 * right], color=style.GREY, linestyle="--", linewidth=0.9,
        label="width = 2 |error|",
    )  # fmt: skip
    dof, unit = rows["dof"].iloc[0], rows["unit"].iloc[0]
    panel.set(xlim=(0, right), ylim=(0, top), xlabel=f"|error| of {dof} ({unit})")
    panel.set_ylabel(f"Width of {level:g} % interval ({unit})")
    rho = rank_correlation(width, error)
    shown = f"ρ = {rho:.2f}".replace("-", "−")
    panel.set_title(f"{dof}: {'no ρ, equal widths' if math.isnan(rho) else shown}")


def _draw_regions(panel: Axes, rows: pd.DataFrame, window: int) -> None:
    rows = rows.sort_values("truth", kind="stable")
    truth, levels = rows["truth"].to_numpy(), bound_levels(rows)
    # Thousands of smoothed points would make a PDF of megabytes that looks the same.
    shown = np.arange(0, len(rows), max(1, len(rows) // POINTS))
    index = shown + 1
    # Tints of one hue, the first the strongest: they stay in order in grey print too.
    tints = sns.light_palette(style.BLUE, len(levels) + 2, reverse=True)[1:-1]
    for k, (level, colour) in enumerate(zip(levels, tints, strict=True)):
        lower, upper = (moving_average(end - truth, window)[shown] for end in bounds(rows, level))
        panel.fill_between(
            index, lower, upper, color=colour, linewidth=0, zorder=1 - k / 100,
            label=f"{level:g} % interval" if np.isfinite(lower).any() else None,
        )  # fmt: skip
    estimate = moving_average(rows["estimate"].to_numpy() - truth, window)[shown]
    panel.plot(index, estimate, color=style.ORANGE, linewidth=1.1, label="estimate")
    panel.axhline(0.0, color=style.BLACK, linewidth=0.8, linestyle=":", label="truth")
    panel.grid(visible=False)
    panel.set_xlim(1, max(2, len(rows)))
    panel.margins(y=0.05)
    panel.locator_params(nbins=5)
    dof, unit = rows["dof"].iloc[0], rows["unit"].iloc[0]
    panel.set_ylabel(f"Deviation from true {dof} ({unit})")
    coverage = [
        "∞" if np.isinf(bounds(rows, level)).all() else f"{100 * covered(rows, level).mean():.1f}"
        for level in levels
    ]
    finite = any(text != "∞" for text in coverage)
    title = f"{' / '.join(coverage)} % covered" if finite else "no finite interval"
    panel.set_title(f"{dof}: {title}")


def _caption(predictions: pd.DataFrame, n: int, window: int) -> str:
    levels = bound_levels(predictions)
    names = ", ".join(f"{level:g}" for level in levels)
    text = (
        f"Intervals of {names} % minus the truth, over {n} test frames in the order of the truth; "
        "the truth is the zero line. "
    )
    if window > 1:
        text += (
            f"Bounds and estimate are smoothed by a moving average of {window} frames (fewer at "
            "both ends); the coverage above each panel is counted before smoothing. "
        )
    infinite = [f"{v:g} %" for v in levels if np.isinf(bounds(predictions, v)).any()]
    if infinite:
        text += (
            f"Intervals of {', '.join(infinite)} are infinite (∞), all or some, and not drawn "
            "there: the uncertainty calibration set is too small for them."
        )
    return text.strip()
