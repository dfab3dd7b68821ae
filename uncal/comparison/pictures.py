"""Figures of runs and multiruns as bytes that a page can hold."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image, UnidentifiedImageError

from uncal.errors import UncalError
from uncal.multirun.folder import Multirun
from uncal.reporting.run import Run

if TYPE_CHECKING:
    from uncal.reporting.figures.style import NamedFigure

FOLDER = "figures"


@dataclass(frozen=True)
class Picture:
    """A figure as it stands on a page.

    Attributes:
        title: what it shows.
        caption: how to read it; may be empty.
        png: the file.
        inches: its width in a paper.
        origin: the command of the run that it shows.
    """

    title: str
    caption: str
    png: bytes
    inches: float
    origin: str


def pictures(source: Run | Multirun) -> list[Picture]:
    """The figures that lie in a run's or multirun's folder, or else those that its tables allow.

    Raises:
        UncalError: a figure's file cannot be read.
    """
    if files := sorted((source.folder / FOLDER).glob("*.png")):
        return [_stored(path, source.origin) for path in files]
    # Matplotlib and seaborn take seconds to import, and most folders have their figures.
    from uncal.multirun.figures import sweep_figures
    from uncal.reporting.figures.run_figures import run_figures
    from uncal.reporting.figures.style import paper_style

    with paper_style():
        if isinstance(source, Run):
            figures = run_figures(source)
        else:
            figures = [] if source.frame is None else sweep_figures(source.frame)
        return [_drawn(figure, source.origin) for figure in figures]


def _stored(path: Path, origin: str) -> Picture:
    """A file with its title and caption, which :func:`named.save` keeps in it."""
    data = path.read_bytes()
    try:
        with Image.open(io.BytesIO(data)) as image:
            image.load()
            texts = {key: v for key, v in image.info.items() if isinstance(v, str)}
            dpi, width = image.info.get("dpi", (200, 200))[0], image.width
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise UncalError(
            f"{path} is no readable PNG ({error}). Delete {path.parent}: the figures are then "
            "drawn anew from the run's tables."
        ) from error
    title = texts.get("Title") or path.stem.replace("_", " ")
    return Picture(title, texts.get("Description", ""), data, width / dpi, origin)


def _drawn(figure: NamedFigure, origin: str) -> Picture:
    from uncal.reporting.figures.style import PNG_DPI

    buffer = io.BytesIO()
    figure.figure.savefig(buffer, format="png", dpi=PNG_DPI)
    inches = float(figure.figure.get_size_inches()[0])
    return Picture(figure.title, figure.caption, buffer.getvalue(), inches, origin)
