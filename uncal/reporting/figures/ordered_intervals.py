"""Intervals around the truth, test frames in the order of the truth, as in the paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

from uncal.reporting.figures.columns import Column, DofColumns
from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.style import (
    BLACK,
    BLUE,
    ORANGE,
    new_figure,
    paper_style,
    shared_legend,
)

WINDOWS = 25
"""How many windows of the moving average stand side by side in a panel."""

POINTS = 500
"""At least so many of the smoothed values are drawn, if there are."""


def ordered_intervals(columns: Sequence[DofColumns], label: str) -> NamedFigure:
    """Six panels of nested intervals, bounds minus truth, smoothed by a moving average.

    Args:
        columns: per DoF.
        label: what the data are, such as "simulated".
    """
    n = len(columns[0].truth)
    window = smoothing_window(n)
    levels = list(columns[0].bounds)
    with paper_style():
        figure, panels = new_figure(2, 3, height=4.1, label=label, sharex=True)
        for panel, column in zip(panels, columns, strict=True):
            _draw(panel, column, window)
        for panel in panels[3:]:
            panel.set_xlabel("Test frame, in order of truth")
        shared_legend(figure, panels)
    return NamedFigure(
        "ordered_intervals",
        "Ordered prediction intervals",
        _caption(columns, levels, n, window),
        figure,
    )


def smoothing_window(n: int) -> int:
    """Frames of the moving average: odd, about n / :data:`WINDOWS`.

    Args:
        n: test frames.

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


def _draw(panel: Axes, column: DofColumns, window: int) -> None:
    order = np.argsort(column.truth, kind="stable")
    # Thousands of smoothed points would make a PDF of megabytes that looks the same.
    shown = np.arange(0, len(order), max(1, len(order) // POINTS))
    place = shown + 1
    levels = list(column.bounds)
    for k, (level, colour) in enumerate(zip(levels, _shades(len(levels)), strict=True)):
        lower, upper = (
            moving_average((end - column.truth)[order], window)[shown]
            for end in column.bounds[level]
        )
        panel.fill_between(
            place, lower, upper, color=colour, linewidth=0, zorder=1 - k / 100,
            label=f"{level:g} % interval" if np.isfinite(lower).any() else None,
        )  # fmt: skip
    estimate = moving_average((column.estimate - column.truth)[order], window)[shown]
    panel.plot(place, estimate, color=ORANGE, linewidth=1.1, label="estimate")
    panel.axhline(0.0, color=BLACK, linewidth=0.8, linestyle=":", label="truth")
    panel.set_xlim(1, max(2, len(order)))
    panel.margins(y=0.05)
    panel.locator_params(nbins=5)
    panel.set_ylabel(f"Deviation from true {column.dof} ({column.unit})")
    found = [_coverage(column, level) for level in levels]
    all_infinite = all(text == "∞" for text in found)
    covered = "no finite interval" if all_infinite else f"{' / '.join(found)} % covered"
    panel.set_title(f"{column.dof}: {covered}")


def _coverage(column: DofColumns, level: float) -> str:
    if np.isinf(column.bounds[level]).all():
        return "∞"
    return f"{100 * column.covered(level).mean():.1f}"


def _shades(count: int) -> list[tuple[float, float, float]]:
    """Tints of one hue, the first the strongest: they stay in order in grey print too."""
    strength = np.linspace(0.75, 0.2, count) if count > 1 else np.array([0.5])
    hue = np.array(to_rgb(BLUE))
    return [tuple(s * hue + (1.0 - s)) for s in strength]


def _caption(columns: Sequence[DofColumns], levels: Sequence[float], n: int, window: int) -> str:
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
    missing = [
        f"{level:g} %"
        for level in levels
        if any(np.isinf(column.bounds[level]).any() for column in columns)
    ]
    if missing:
        text += (
            f"Intervals of {', '.join(missing)} are infinite (∞), all or some, and not drawn "
            "there: the uncertainty calibration set is too small for them."
        )
    return text.strip()
