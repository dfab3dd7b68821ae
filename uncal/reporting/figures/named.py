"""A figure with what a reader needs beside it, and how it becomes files."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from uncal.reporting.figures.style import paper_style
from uncal.reporting.layout import replaced_whole

PNG_DPI = 200


@dataclass(frozen=True)
class NamedFigure:
    """A figure that has not been written yet.

    Attributes:
        name: file stem, such as "calibration_curves".
        title: heading where the figure stands on a page.
        caption: one or a few sentences on how to read it.
        figure: of :func:`uncal.reporting.figures.style.new_figure`.
    """

    name: str
    title: str
    caption: str
    figure: Figure


def save(figure: NamedFigure, folder: Path) -> tuple[Path, Path]:
    """Write a figure for the screen (PNG) and for a paper (PDF), each whole or not at all.

    The same figure gives the same bytes: no file carries the time of its making.

    Returns:
        ``<folder>/<name>.png`` and ``<folder>/<name>.pdf``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    png, pdf = (folder / f"{figure.name}.{kind}" for kind in ("png", "pdf"))
    drawn = figure.figure
    with paper_style(), _quiet_fonts():
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
    return png, pdf


@contextmanager
def _quiet_fonts() -> Iterator[None]:
    """Without the hundred lines that fontTools tells a run's log for every font in a PDF."""
    logger = logging.getLogger("fontTools")
    before = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(before)
