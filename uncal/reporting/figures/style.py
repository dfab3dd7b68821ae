"""How figures look (sizes, colours that the colour-blind tell apart), and how they become files."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend

from uncal.geometry import DOF_NAMES
from uncal.reporting.layout import replaced_whole

PNG_DPI = 200

SINGLE_COLUMN, DOUBLE_COLUMN = 3.4, 7.0
"""Widths of a paper's column and page, inches."""

ORANGE, SKY, GREEN, YELLOW = "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILION, PURPLE, BLACK = "#0072B2", "#D55E00", "#CC79A7", "#000000"
"""The palette of Okabe and Ito."""

GREY = "#595959"
"""Of what is not data: labels, reference lines."""

BAND_GREY = "#D9D9D9"
"""Of shaded bands that stand for theory."""

REFERENCE: Mapping[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": ":"}
"""Look of a line at what should be."""

_HUES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
DOF_COLOURS: Mapping[str, str] = dict(zip(DOF_NAMES, _HUES, strict=True))
DOF_LINES: Mapping[str, str] = dict(zip(DOF_NAMES, ("-", "--", "-.") * 2, strict=True))
DOF_MARKERS: Mapping[str, str] = dict(zip(DOF_NAMES, "os^Dvp", strict=True))
"""So that colour is never the only cue."""


def dof_style(dof: str) -> dict[str, Any]:
    """Colour, line, marker and label that a DoF has in every figure."""
    colour, line, marker = (each[dof] for each in (DOF_COLOURS, DOF_LINES, DOF_MARKERS))
    return {"color": colour, "linestyle": line, "marker": marker, "label": dof}


_LABEL_POINTS = 6.5
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "axes.titlesize": 8,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "patch.linewidth": 0.6,
    # TrueType, since journals refuse matplotlib's default fonts of Type 3.
    "pdf.fonttype": 42,
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.03,
}


def paper_style() -> AbstractContextManager[None]:
    """Fonts and lines of all figures, for a ``with`` around everything that draws.

    Matplotlib asks for its settings at any time up to the saving, so :func:`new_figure` alone
    could not give them; and nothing is changed for the user's own figures.
    """
    return mpl.rc_context(_STYLE)  # type: ignore[arg-type]  # keys as literals in newer stubs


def new_figure(
    rows: int,
    columns: int,
    *,
    width: float = DOUBLE_COLUMN,
    height: float,
    label: str,
    sharex: bool = False,
    sharey: bool | Literal["row"] = False,
    heights: Sequence[float] | None = None,
) -> tuple[Figure, list[Axes]]:
    """A figure and its panels, row by row, without pyplot; call it in :func:`paper_style`.

    >>> with paper_style():
    ...     figure, panels = new_figure(1, 2, height=2.4, label="simulated")
    >>> len(panels), figure.texts[0].get_text(), tuple(map(float, figure.get_size_inches()))
    (2, 'simulated', (7.0, 2.4))
    """
    strip = 1.5 * _LABEL_POINTS / 72 / height
    layout = ConstrainedLayoutEngine(rect=(0.0, strip, 1.0, 1.0 - strip))
    figure = Figure(figsize=(width, height), layout=layout)
    figure.text(
        1 - 0.04 / width, 0.03 / height, label, ha="right", va="bottom", color=GREY,
        fontsize=_LABEL_POINTS,
    )  # fmt: skip
    grid = figure.subplots(
        rows, columns, sharex=sharex, sharey=sharey, squeeze=False, height_ratios=heights
    )
    return figure, list(grid.flat)


def shared_legend(figure: Figure, panels: Iterable[Axes]) -> Legend:
    """One legend above all panels, where it hides nothing; what several have is named once."""
    handles = {
        text: handle
        for panel in panels
        for handle, text in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    return figure.legend(
        list(handles.values()),
        list(handles),
        loc="outside upper center",
        ncols=len(handles),
        columnspacing=1.4,
        handletextpad=0.5,
    )


@dataclass(frozen=True)
class NamedFigure:
    """A figure that has not been written yet.

    Attributes:
        name: file stem, such as "calibration_curves".
        title: heading where the figure stands on a page.
        caption: one or a few sentences on how to read it.
        figure: of :func:`new_figure`.
    """

    name: str
    title: str
    caption: str
    figure: Figure


def save(figure: NamedFigure, folder: Path) -> tuple[Path, Path]:
    """Write ``<name>.png`` for the screen and ``<name>.pdf`` for a paper, each whole or not at all.

    The same figure gives the same bytes: no file carries the time of its making.
    """
    folder.mkdir(parents=True, exist_ok=True)
    png, pdf = (folder / f"{figure.name}.{kind}" for kind in ("png", "pdf"))
    drawn = figure.figure
    fonts = logging.getLogger("fontTools")  # tells a hundred lines for every font in a PDF
    level = fonts.level
    fonts.setLevel(logging.WARNING)
    try:
        with paper_style():
            with replaced_whole(png) as partial:
                about = {"Title": figure.title, "Description": figure.caption}
                drawn.savefig(partial, format="png", dpi=PNG_DPI, metadata=about)
            # The panels stand where they should by now, and to place them is a third of the work.
            layout = drawn.get_layout_engine()
            drawn.set_layout_engine("none")
            with replaced_whole(pdf) as partial:
                subject = {"Title": figure.title, "Subject": figure.caption, "CreationDate": None}
                drawn.savefig(partial, format="pdf", dpi=PNG_DPI, metadata=subject)
            drawn.set_layout_engine(layout)
    finally:
        fonts.setLevel(level)
    return png, pdf
