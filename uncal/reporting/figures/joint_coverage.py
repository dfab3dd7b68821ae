"""How often intervals hold the whole pose: six at once, the joint box, Bonferroni's."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.style import (
    BAND_GREY,
    BLUE,
    GREEN,
    GREY,
    SINGLE_COLUMN,
    VERMILION,
    light_grid,
    new_figure,
    paper_style,
)

if TYPE_CHECKING:
    import pandas as pd

_CURVES = (
    ("together", "six intervals at once", VERMILION, "--", "s"),
    ("joint", "joint box", BLUE, "-", "o"),
    ("bonferroni", "Bonferroni box", GREEN, "-.", "^"),
)


def joint_coverage(joint: pd.DataFrame, label: str, caveat: str | None = None) -> NamedFigure:
    """Empirical coverage of the whole pose against the nominal level."""
    joint = joint.sort_values("level")
    levels = joint["level"]
    with paper_style():
        figure, (panel,) = new_figure(1, 1, width=SINGLE_COLUMN, height=2.9, label=label)
        light_grid([panel])
        panel.fill_between(
            levels,
            joint["joint_low"],
            joint["joint_high"],
            color=BAND_GREY,
            label="reference band of the joint box" + ("" if caveat == "" else ", not binding"),
        )
        panel.axline((0, 0), slope=1, color=GREY, linestyle=":", linewidth=0.8)
        for name, words, colour, line, marker in _CURVES:
            panel.plot(
                levels, joint[name], color=colour, linestyle=line, marker=marker, label=words,
                clip_on=False, zorder=3,
            )  # fmt: skip
        low = levels.min() - 5
        panel.set_xlim(low, 100)
        panel.set_ylim(0 if low < 60 else min(low, joint["together"].min()) - 5, 100)
        panel.set_xlabel("Nominal coverage (%)")
        panel.set_ylabel("Empirical coverage of the whole pose (%)")
        # Above, since no corner is free of curves whatever the levels are.
        figure.legend(loc="outside upper center", ncols=2)
    return NamedFigure("joint_coverage", "The whole pose", _caption(joint, caveat), figure)


def _caption(joint: pd.DataFrame, caveat: str | None) -> str:
    row = joint.iloc[(joint["level"] - 90.0).abs().argmin()]
    band = "Shaded: the 99.9 % reference band of the Beta-Binomial law"
    if caveat is None:
        band += ", if frames are exchangeable."
    else:
        band += f", for reference only here: {caveat}." if caveat else "."
    return (
        f"Of {row['n_test']} test frames, all six {row['level']:g} % intervals hold at once in "
        f"{row['together']:.1f} %, the joint box in {row['joint']:.1f} %. {band} Dotted: empirical "
        "equals nominal."
    )
