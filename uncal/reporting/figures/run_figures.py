"""All figures of one run from the files in its folder; among them empirical coverage by level."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import pandas as pd

from uncal.geometry import DOF_NAMES
from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.figures import style
from uncal.reporting.figures.predictions import ordered_intervals, width_against_error
from uncal.reporting.figures.style import NamedFigure
from uncal.reporting.frames import CURVE, JOINT, PREDICTIONS, Schema, read_csv
from uncal.reporting.run import Run

_BAND = f"{100 * BAND_CONFIDENCE:g} % reference band"

_POSE_LOOKS: dict[str, dict[str, Any]] = {
    "together": {"label": "six intervals at once", "color": style.VERMILION, "linestyle": "--"},
    "joint": {"label": "joint box", "color": style.BLUE, "linestyle": "-"},
    "bonferroni": {"label": "Bonferroni box", "color": style.GREEN, "linestyle": "-."},
}


def calibration_curves(curve: pd.DataFrame, label: str, caveat: str | None = None) -> NamedFigure:
    """Empirical against nominal coverage, translations to the left, rotations to the right.

    The lower panels show the difference of the two, in which much smaller errors can be seen.
    """
    band = f"{_BAND}, not binding" if caveat else f"{_BAND} (Beta-Binomial)"
    with style.paper_style():
        figure, panels = style.new_figure(
            2, 2, height=4.9, label=label, sharex=True, sharey="row", heights=(2.0, 1.0)
        )
        for k, panel in enumerate(panels):
            difference, side = divmod(k, 2)
            by_dof = curve[curve["dof"].isin(DOF_NAMES[3 * side : 3 * side + 3])]
            # Of one DoF only: the band depends on the sample sizes, which all DoF share.
            first = by_dof[by_dof["dof"] == by_dof["dof"].iloc[0]]
            ends = first[["coverage_low", "coverage_high"]].sub(difference * first["level"], axis=0)
            low, high = ends["coverage_low"], ends["coverage_high"]
            panel.fill_between(
                first["level"], low, high, color=style.BAND_GREY, linewidth=0, label=band
            )
            panel.plot([0, 100], [0, 100 * (1 - difference)], **style.REFERENCE)
            for dof, rows in by_dof.groupby("dof", sort=False):
                picp = rows["picp"] - difference * rows["level"]
                looks = style.dof_style(str(dof))
                panel.plot(rows["level"], picp, **looks, clip_on=False, zorder=3)
        style.shared_legend(figure, panels[:2])
        panels[0].set(ylim=(0, 100), yticks=range(0, 101, 20), title="Translations")
        panels[0].set_ylabel("Empirical coverage (%)")
        panels[1].set_title("Rotations")
        panels[2].set(xlim=(0, 100), xticks=range(0, 101, 20))
        panels[2].set_ylabel("Empirical − nominal\n(percentage points)")
        for panel in panels[2:]:
            panel.set_xlabel("Nominal coverage (%)")
    law = (
        "where the Beta-Binomial law of split conformal intervals puts a point with probability "
        f"{100 * BAND_CONFIDENCE:g} %"
    )
    outside = int((~curve["in_band"].astype(bool)).sum())
    if caveat is None:
        law += " if frames are exchangeable; for reference only with other methods."
    elif caveat:
        law += f". For reference only here: {caveat}."
    else:
        law += f"; {outside} of {len(curve)} points lie outside."
    caption = (
        "Empirical against nominal coverage on the test set, per degree of freedom; below, their "
        "difference. On the dotted line intervals hold the truth exactly as often as their level "
        f"says, above it more often. Shaded: {law}"
    )
    return NamedFigure("calibration_curves", "Calibration curves", caption, figure)


def joint_coverage(joint: pd.DataFrame, label: str, caveat: str | None = None) -> NamedFigure:
    """Empirical coverage of the whole pose against the nominal level."""
    joint = joint.sort_values("level")
    levels = joint["level"]
    band = "reference band of the joint box" + ("" if caveat == "" else ", not binding")
    with style.paper_style():
        figure, (panel,) = style.new_figure(
            1, 1, width=style.SINGLE_COLUMN, height=3.2, label=label
        )
        low, high = joint["joint_low"], joint["joint_high"]
        panel.fill_between(levels, low, high, color=style.BAND_GREY, label=band)
        panel.axline((0, 0), slope=1, **style.REFERENCE)
        for (name, looks), marker in zip(_POSE_LOOKS.items(), "so^", strict=True):
            panel.plot(levels, joint[name], **looks, marker=marker, clip_on=False, zorder=3)
        lowest = levels.min() - 5
        panel.set_xlim(lowest, 100)
        panel.set_ylim(0 if lowest < 60 else min(lowest, joint["together"].min()) - 5, 100)
        panel.set_xlabel("Nominal coverage (%)")
        panel.set_ylabel("Empirical coverage of the whole pose (%)")
        # Above, since no corner is free of curves whatever the levels are.
        figure.legend(loc="outside upper center", ncols=1)
    row = joint.iloc[(levels - 90.0).abs().argmin()]
    law = "Shaded: the 99.9 % reference band of the Beta-Binomial law"
    if caveat is None:
        law += ", if frames are exchangeable."
    else:
        law += f", for reference only here: {caveat}." if caveat else "."
    caption = (
        f"Of {row['n_test']} test frames, all six {row['level']:g} % intervals hold at once in "
        f"{row['together']:.1f} %, the joint box in {row['joint']:.1f} %. {law} Dotted: empirical "
        "equals nominal."
    )
    return NamedFigure("joint_coverage", "The whole pose", caption, figure)


def run_figures(run: Run) -> list[NamedFigure]:
    """Every figure that the files of a run allow; a missing file means fewer figures.

    Raises:
        UncalError: a file is damaged.
    """
    return [figure for draw in figure_makers(run).values() if (figure := draw()) is not None]


def figure_makers(run: Run) -> dict[str, Callable[[], NamedFigure | None]]:
    """Name of a figure → what draws it, or returns None where the run does not allow it."""
    folder, label, caveat = run.folder, run.label, run.caveat

    @cache
    def read(schema: Schema) -> pd.DataFrame:
        return read_csv(folder / schema.file, schema)

    makers: dict[str, tuple[Schema, Callable[[], NamedFigure | None]]] = {
        "calibration_curves": (CURVE, lambda: calibration_curves(read(CURVE), label, caveat)),
        "joint_coverage": (JOINT, lambda: joint_coverage(read(JOINT), label, caveat)),
        "ordered_intervals": (PREDICTIONS, lambda: ordered_intervals(read(PREDICTIONS), label)),
        "width_against_error": (PREDICTIONS, lambda: width_against_error(read(PREDICTIONS), label)),
    }
    return {
        name: draw for name, (schema, draw) in makers.items() if (folder / schema.file).is_file()
    }
