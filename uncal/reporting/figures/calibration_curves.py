"""Empirical against nominal coverage, with the Beta-Binomial law's reference band."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.axes import Axes

from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.style import (
    BAND_GREY,
    GREY,
    ROTATIONS,
    TRANSLATIONS,
    dof_style,
    light_grid,
    new_figure,
    paper_style,
    shared_legend,
)

if TYPE_CHECKING:
    import pandas as pd


def calibration_curves(curve: pd.DataFrame, label: str, caveat: str | None = None) -> NamedFigure:
    """Empirical against nominal coverage, translations to the left, rotations to the right.

    The lower panels show the difference of the two, in which much smaller errors can be seen.
    """
    with paper_style():
        figure, panels = new_figure(2, 2, height=4.9, label=label, sharex=True, heights=(2.0, 1.0))
        light_grid(panels)
        for top, bottom, names in zip(
            panels[:2], panels[2:], (TRANSLATIONS, ROTATIONS), strict=True
        ):
            own = curve[curve["dof"].isin(names)]
            _draw(top, own, caveat, difference=False)
            _draw(bottom, own, caveat, difference=True)
            top.set_ylim(0, 100)
            top.set_yticks(range(0, 101, 20))
            bottom.set_xlabel("Nominal coverage (%)")
        for row in (panels[:2], panels[2:]):
            low, high = zip(*(panel.get_ylim() for panel in row), strict=True)
            for panel in row:
                panel.set_ylim(min(low), max(high))
        panels[0].set_title("Translations")
        panels[1].set_title("Rotations")
        shared_legend(figure, panels[:2])
        panels[0].set_ylabel("Empirical coverage (%)")
        panels[2].set_ylabel("Empirical − nominal\n(percentage points)")
        panels[2].set_xlim(0, 100)
        panels[2].set_xticks(range(0, 101, 20))
    return NamedFigure("calibration_curves", "Calibration curves", _caption(curve, caveat), figure)


def _draw(panel: Axes, curve: pd.DataFrame, caveat: str | None, *, difference: bool) -> None:
    by_dof = dict(list(curve.groupby("dof", sort=False)))
    # Of one DoF only: the band depends on the sample sizes, which all DoF share.
    band = next(iter(by_dof.values()))
    origin = band["level"].to_numpy() if difference else 0.0
    panel.fill_between(
        band["level"],
        band["coverage_low"] - origin,
        band["coverage_high"] - origin,
        color=BAND_GREY,
        linewidth=0,
        label=_band_label(caveat),
    )
    end = 0 if difference else 100
    panel.plot([0, 100], [0, end], color=GREY, linewidth=0.8, linestyle=":")
    for dof, rows in by_dof.items():
        panel.plot(
            rows["level"], rows["picp"] - origin, **dof_style(str(dof)), clip_on=False, zorder=3
        )


def _band_label(caveat: str | None) -> str:
    band = f"{100 * BAND_CONFIDENCE:g} % reference band"
    return f"{band}, not binding" if caveat else f"{band} (Beta-Binomial)"


def _caption(curve: pd.DataFrame, caveat: str | None) -> str:
    law = (
        "where the Beta-Binomial law of split conformal intervals puts a point with probability "
        f"{100 * BAND_CONFIDENCE:g} %"
    )
    if caveat is None:
        band = f"{law} if frames are exchangeable; for reference only with other methods."
    elif caveat:
        band = f"{law}. For reference only here: {caveat}."
    else:
        outside = int((~curve["in_band"].astype(bool)).sum())
        band = f"{law}; {outside} of {len(curve)} points lie outside."
    return (
        "Empirical against nominal coverage on the test set, per degree of freedom; below, their "
        "difference. On the dotted line intervals hold the truth exactly as often as their level "
        f"says, above it more often. Shaded: {band}"
    )
