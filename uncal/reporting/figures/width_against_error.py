"""Whether wide intervals stand where the error is large."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import spearmanr  # type: ignore[import-untyped]

from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.ordered_intervals import Column, bounds, covered
from uncal.reporting.figures.style import (
    BLUE,
    GREY,
    VERMILION,
    light_grid,
    new_figure,
    paper_style,
    shared_legend,
)
from uncal.reporting.frames import bound_levels

if TYPE_CHECKING:
    import pandas as pd

LEVEL = 90.0
"""Percent; of a run without it the lowest level with finite intervals is shown."""


def width_against_error(predictions: pd.DataFrame, label: str) -> NamedFigure | None:
    """Six panels of interval width against |error|, with their rank correlation.

    Returns:
        The figure; None where no level has finite intervals in all DoF.
    """
    finite = [v for v in bound_levels(predictions) if np.isfinite(bounds(predictions, v)).all()]
    if not finite:
        return None
    level = LEVEL if LEVEL in finite else finite[0]
    by_dof = list(predictions.groupby("dof", sort=False))
    with paper_style():
        figure, panels = new_figure(2, 3, height=4.3, label=label)
        light_grid(panels)
        for panel, (_, rows) in zip(panels, by_dof, strict=True):
            _draw(panel, rows, level)
        for handle in shared_legend(figure, panels).legend_handles:
            if handle is not None:
                handle.set_alpha(1.0)
    return NamedFigure(
        "width_against_error",
        f"Width of the {level:g} % intervals against error",
        f"Each point is one of {len(by_dof[0][1])} test frames. ρ is Spearman's rank "
        "correlation of width and |error|: 0 where the width says nothing about the error. "
        f"Dashed: width = 2 |error|; {_above(predictions, level)}",
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


def _draw(panel: Axes, rows: pd.DataFrame, level: float) -> None:
    lower, upper = bounds(rows, level)
    width, error = upper - lower, np.abs((rows["estimate"] - rows["truth"]).to_numpy())
    held = covered(rows, level)
    n = len(held)
    # Density must show among thousands of points, and single points among few.
    size, alpha = float(np.clip(1500 / n, 2.5, 9.0)), float(np.clip(12 / n**0.5, 0.15, 0.7))
    for chosen, colour, marker, strength, text in (
        (held, BLUE, "o", alpha, "truth inside the interval"),
        (~held, VERMILION, "^", min(1.0, 2.5 * alpha), "truth outside"),
    ):
        panel.scatter(
            error[chosen], width[chosen], s=size, c=colour, marker=marker, alpha=strength,
            linewidths=0, rasterized=True, label=text,
        )  # fmt: skip
    right, top = 1.05 * max(error.max(), 1e-12), 1.08 * width.max()
    panel.plot(
        [0, right], [0, 2 * right], color=GREY, linestyle="--", linewidth=0.9,
        label="width = 2 |error|",
    )  # fmt: skip
    panel.set_xlim(0, right)
    panel.set_ylim(0, top)
    dof, unit = rows["dof"].iloc[0], rows["unit"].iloc[0]
    panel.set_xlabel(f"|error| of {dof} ({unit})")
    panel.set_ylabel(f"Width of {level:g} % interval ({unit})")
    rho = rank_correlation(width, error)
    shown = f"ρ = {rho:.2f}".replace("-", "−")
    panel.set_title(f"{dof}: {'no ρ, equal widths' if math.isnan(rho) else shown}")


def _above(predictions: pd.DataFrame, level: float) -> str:
    lower, upper = bounds(predictions, level)
    off = np.abs((lower + upper) / 2 - predictions["estimate"].to_numpy())
    if (off > 1e-6 * (upper - lower)).any():
        return "these intervals are not centred on the estimate, so it is only a guide."
    return "above it the interval holds the truth."
