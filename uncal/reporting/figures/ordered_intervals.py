"""Intervals around the truth, test frames in the order of the truth, as in the paper."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.style import (
    BLACK,
    BLUE,
    ORANGE,
    new_figure,
    paper_style,
    shared_legend,
)
from uncal.reporting.frames import bound_columns, bound_levels

if TYPE_CHECKING:
    import pandas as pd

Column: TypeAlias = NDArray[np.float64]

WINDOWS = 25
"""How many windows of the moving average stand side by side in a panel."""

POINTS = 500
"""At least so many of the smoothed values are drawn, if there are."""


def ordered_intervals(predictions: pd.DataFrame, label: str) -> NamedFigure:
    """Six panels of nested intervals, bounds minus truth, smoothed by a moving average."""
    by_dof = list(predictions.groupby("dof", sort=False))
    n = len(by_dof[0][1])
    window = smoothing_window(n)
    with paper_style():
        figure, panels = new_figure(2, 3, height=4.1, label=label, sharex=True)
        for panel, (_, rows) in zip(panels, by_dof, strict=True):
            _draw(panel, rows, window)
        for panel in panels[3:]:
            panel.set_xlabel("Test frame, in order of truth")
        shared_legend(figure, panels)
    caption = _caption(predictions, n, window)
    return NamedFigure("ordered_intervals", "Ordered prediction intervals", caption, figure)


def smoothing_window(n: int) -> int:
    """Frames of the moving average: odd, about n / :data:`WINDOWS`.

    >>> smoothing_window(10), smoothing_window(200), smoothing_window(5000)
    (1, 9, 201)
    """
    return 2 * (n // (2 * WINDOWS)) + 1


def moving_average(values: Column, window: int) -> Column:
    """Mean of the ``window`` values around each; at both ends of those there are.

    Args:
        values: (n,); a mean with an infinite one among them is NaN.
        window: odd.

    Returns:
        (n,).

    >>> moving_average(np.array([0.0, 3.0, 6.0, 3.0]), window=3).tolist()
    [1.5, 3.0, 4.0, 4.5]
    """
    ones = np.ones(window)
    finite = np.isfinite(values)

    def total(of: Column) -> Column:
        # Not np.convolve(mode="same"), which is as long as the window where that is longer.
        full = np.convolve(of, ones)
        return full[window // 2 : window // 2 + len(of)]

    means = total(np.where(finite, values, 0.0)) / total(np.ones(len(values)))
    return np.where(total((~finite).astype(float)) > 0.5, np.nan, means)


def bounds(rows: pd.DataFrame, level: float) -> tuple[Column, Column]:
    """Lower and upper ends of a level's intervals, percent."""
    lower, upper = bound_columns(level)
    return rows[lower].to_numpy(), rows[upper].to_numpy()


def covered(rows: pd.DataFrame, level: float) -> NDArray[np.bool_]:
    """(n,) whether each interval of a level holds the truth."""
    (lower, upper), truth = bounds(rows, level), rows["truth"].to_numpy()
    return np.asarray((lower <= truth) & (truth <= upper))


def _draw(panel: Axes, rows: pd.DataFrame, window: int) -> None:
    rows = rows.sort_values("truth", kind="stable")
    truth, levels = rows["truth"].to_numpy(), bound_levels(rows)
    # Thousands of smoothed points would make a PDF of megabytes that looks the same.
    shown = np.arange(0, len(rows), max(1, len(rows) // POINTS))
    index = shown + 1
    for k, (level, colour) in enumerate(zip(levels, _shades(len(levels)), strict=True)):
        lower, upper = (moving_average(end - truth, window)[shown] for end in bounds(rows, level))
        panel.fill_between(
            index, lower, upper, color=colour, linewidth=0, zorder=1 - k / 100,
            label=f"{level:g} % interval" if np.isfinite(lower).any() else None,
        )  # fmt: skip
    estimate = moving_average(rows["estimate"].to_numpy() - truth, window)[shown]
    panel.plot(index, estimate, color=ORANGE, linewidth=1.1, label="estimate")
    panel.axhline(0.0, color=BLACK, linewidth=0.8, linestyle=":", label="truth")
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


def _shades(count: int) -> list[tuple[float, float, float]]:
    """Tints of one hue, the first the strongest: they stay in order in grey print too."""
    strength = np.linspace(0.75, 0.2, count) if count > 1 else np.array([0.5])
    hue = np.array(to_rgb(BLUE))
    return [tuple(s * hue + (1.0 - s)) for s in strength]


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
