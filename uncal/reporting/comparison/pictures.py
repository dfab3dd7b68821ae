"""Figures of runs and multiruns as bytes that a page can hold."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from uncal.errors import UncalError
from uncal.reporting.comparison.gathering import Multirun
from uncal.reporting.comparison.run_folder import Run
from uncal.reporting.figures.named import PNG_DPI, NamedFigure
from uncal.reporting.figures.run_figures import run_figures
from uncal.reporting.figures.style import paper_style
from uncal.reporting.figures.sweep_figures import sweep_figures

FOLDER = "figures"


@dataclass(frozen=True)
class Picture:
    """A figure as it stands on a page.

    Attributes:
        title: what it shows.
        caption: how to read it; may be empty.
        png: the file.
        inches: its width in a paper.
        made_by: the command of the run that it shows.
    """

    title: str
    caption: str
    png: bytes
    inches: float
    made_by: str


def run_pictures(run: Run) -> list[Picture]:
    """The figures that lie in a run's folder, or else those that its tables allow.

    Args:
        run: whose.

    Raises:
        UncalError: a figure's file cannot be read.
    """
    return _pictures(run.folder, run.made_by, lambda: run_figures(run.folder, run.label))


def multirun_pictures(multirun: Multirun, made_by: str) -> list[Picture]:
    """The figures that lie in a multirun's folder, or else those that its summary allows.

    Args:
        multirun: whose.
        made_by: its command.

    Raises:
        UncalError: a figure's file cannot be read.
    """
    return _pictures(multirun.folder, made_by, lambda: sweep_figures(multirun.folder))


def _pictures(
    folder: Path, made_by: str, draw: Callable[[], Sequence[NamedFigure]]
) -> list[Picture]:
    files = sorted((folder / FOLDER).glob("*.png"))
    if files:
        return [_stored(path, made_by) for path in files]
    with paper_style():
        return [_drawn(figure, made_by) for figure in draw()]


def _stored(path: Path, made_by: str) -> Picture:
    """A file with its title and caption, which :func:`named.save` keeps in it."""
    data = path.read_bytes()
    try:
        with Image.open(io.BytesIO(data)) as image:
            image.load()
            said = {key: value for key, value in image.info.items() if isinstance(value, str)}
            dpi, width = image.info.get("dpi", (PNG_DPI, PNG_DPI))[0], image.width
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise UncalError(
            f"{path} is no readable PNG ({error}). Delete {path.parent}: the figures are then "
            "drawn anew from the run's tables."
        ) from error
    title = said.get("Title") or path.stem.replace("_", " ")
    return Picture(title, said.get("Description", ""), data, width / dpi, made_by)


def _drawn(figure: NamedFigure, made_by: str) -> Picture:
    buffer = io.BytesIO()
    figure.figure.savefig(buffer, format="png", dpi=PNG_DPI)
    inches = float(figure.figure.get_size_inches()[0])
    return Picture(figure.title, figure.caption, buffer.getvalue(), inches, made_by)
