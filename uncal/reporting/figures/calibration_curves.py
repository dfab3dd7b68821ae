"""Coverage found against coverage asked for, with the band of the exact law."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from uncal.reporting.curve_rows import CurveRow
from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.style import (
    BAND_GREY,
    DOF_COLOURS,
    DOF_LINES,
    DOF_MARKERS,
    GREY,
    ROTATIONS,
    TRANSLATIONS,
    light_grid,
    new_figure,
    paper_style,
    shared_legend,
)
from uncal.reporting.predictions import BAND_CONFIDENCE, Promise

_NO_PROMISE = {
    "none": "the interval method promises no coverage",
    "by group": "the interval method promises its coverage by group, not for pooled frames",
}


def why_yardstick(promise: Promise, split_by: str, test: str = "own") -> str:
    """Why the exact law's band is no promise in a run; empty where it is one.

    Args:
        promise: of the interval method.
        split_by: what the split never tears apart, such as ``frame``.
        test: ``own``, or ``unseen`` if rigs put away before the split test.

    >>> why_yardstick("exact", "frame"), why_yardstick("none", "rig")
    ('', 'the interval method promises no coverage')
    """
    if promise != "exact":
        return _NO_PROMISE[promise]
    if test == "unseen":
        return "the test frames are of rigs that the uncertainty calibration set has not"
    if split_by != "frame":
        return f"the split is by {split_by}, so that its frames are not exchangeable"
    return ""


def calibration_curves(
    rows: Sequence[CurveRow], label: str, yardstick: str | None = None
) -> NamedFigure:
    """Observed against expected coverage, translations to the left, rotations to the right.

    The lower panels show the difference of the two, in which much smaller errors can be seen.

    Args:
        rows: :func:`uncal.reporting.curve_rows.curve_rows`.
        label: what the data are, such as "simulated".
        yardstick: :func:`why_yardstick`; None where it is not known.
    """
    with paper_style():
        figure, panels = new_figure(2, 2, height=4.9, label=label, sharex=True, heights=(2.0, 1.0))
        light_grid(panels)
        for top, bottom, names in zip(
            panels[:2], panels[2:], (TRANSLATIONS, ROTATIONS), strict=True
        ):
            _draw(top, [row for row in rows if row.dof in names], yardstick, difference=False)
            _draw(bottom, [row for row in rows if row.dof in names], yardstick, difference=True)
            top.set_ylim(0, 100)
            top.set_yticks(range(0, 101, 20))
            bottom.set_xlabel("Expected coverage (%)")
        for row in (panels[:2], panels[2:]):
            low, high = zip(*(panel.get_ylim() for panel in row), strict=True)
            for panel in row:
                panel.set_ylim(min(low), max(high))
        panels[0].set_title("Translations")
        panels[1].set_title("Rotations")
        shared_legend(figure, panels[:2])
        panels[0].set_ylabel("Observed coverage (%)")
        panels[2].set_ylabel("Observed − expected\n(percentage points)")
        panels[2].set_xlim(0, 100)
        panels[2].set_xticks(range(0, 101, 20))
    return NamedFigure(
        "calibration_curves", "Calibration curves", _caption(rows, yardstick), figure
    )


def _draw(
    panel: Axes, rows: Sequence[CurveRow], yardstick: str | None, *, difference: bool
) -> None:
    def shown(level: float, value: float) -> float:
        return value - level if difference else value

    # Of one DoF only: the band depends on the sample sizes, which all DoF share.
    band = [row for row in rows if row.dof == rows[0].dof]
    panel.fill_between(
        [row.level for row in band],
        [shown(row.level, row.coverage_low) for row in band],
        [shown(row.level, row.coverage_high) for row in band],
        color=BAND_GREY,
        linewidth=0,
        label=_band_label(yardstick),
    )
    panel.plot([0, 100], [0, shown(100, 100)], color=GREY, linewidth=0.8, linestyle=":")
    for dof in dict.fromkeys(row.dof for row in rows):
        curve = [row for row in rows if row.dof == dof]
        panel.plot(
            [row.level for row in curve],
            [shown(row.level, row.picp) for row in curve],
            color=DOF_COLOURS[dof],
            linestyle=DOF_LINES[dof],
            marker=DOF_MARKERS[dof],
            clip_on=False,
            zorder=3,
            label=dof,
        )


def _band_label(yardstick: str | None) -> str:
    share = f"{100 * BAND_CONFIDENCE:g} % band"
    return f"{share}, a yardstick" if yardstick else f"{share} of the exact law"


def _caption(rows: Sequence[CurveRow], yardstick: str | None) -> str:
    law = (
        "the Beta-Binomial law of split conformal intervals puts a point with probability "
        f"{100 * BAND_CONFIDENCE:g} %"
    )
    if yardstick is None:
        band = f"Shaded: where {law} if frames are exchangeable; a yardstick for other methods."
    elif yardstick:
        band = f"Shaded: where {law}. Here it is only a yardstick: {yardstick}."
    else:
        outside = sum(not row.in_band for row in rows)
        band = f"Shaded: where {law}; {outside} of {len(rows)} points lie outside."
    return (
        "Coverage found on the test set against coverage asked for, per degree of freedom; below, "
        "the difference of the two. On the dotted line intervals hold the truth exactly as often "
        f"as asked, above it more often. {band}"
    )
