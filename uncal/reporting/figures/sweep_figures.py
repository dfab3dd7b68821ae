"""All figures of a multirun, from its summary.csv."""

from __future__ import annotations

import csv
from pathlib import Path

from uncal.reporting.figures.named import NamedFigure, save
from uncal.reporting.figures.sweep_axis import Over
from uncal.reporting.figures.sweep_dots import (
    camera_dots,
    coverage_dots,
    error_dots,
    whole_pose_dots,
    width_dots,
)
from uncal.reporting.figures.sweep_lines import (
    coverage_figure,
    error_figure,
    interval_figure,
    whole_pose_figure,
)
from uncal.reporting.figures.sweep_marks import MOST_SERIES
from uncal.reporting.figures.sweep_table import read_sweep
from uncal.reporting.layout import csv_text, write_whole
from uncal.reporting.multirun_markdown import CAPTIONS, FIGURES


def sweep_figures(folder: Path) -> list[NamedFigure]:
    """Every figure that a multirun's ``summary.csv`` allows.

    Over a swept number, such as ``mcd.passes``, lines; another swept key gives one line per value.
    Without a number, or with more lines than can be told apart, a row of dots per combination.

    Args:
        folder: of the multirun.

    Returns:
        No figures as long as there is nothing to compare.

    Raises:
        UncalError: ``summary.csv`` is damaged.
    """
    sweep = read_sweep(folder / "summary.csv")
    if sweep is None or (len(sweep.groups) < 2 and sweep.replicates < 2):
        return []
    over = Over.of(sweep)
    if over is None or len(over.series) > MOST_SERIES:
        made = [each(sweep) for each in (coverage_dots, width_dots, whole_pose_dots, error_dots)]
    else:
        made = [
            interval_figure(over, "interval_score", "Interval score", "is"),
            interval_figure(over, "interval_width", "Mean width", "mpiw"),
            coverage_figure(over),
            whole_pose_figure(over),
            error_figure(over),
        ]
    return [figure for figure in (*made, camera_dots(sweep)) if figure is not None]


def draw_sweep_figures(folder: Path) -> list[Path]:
    """Save the figures of a multirun, and their captions for its ``summary.md``.

    Args:
        folder: of the multirun.

    Returns:
        The PNG files, in ``<folder>/figures``, each with a PDF beside it.

    Raises:
        UncalError: ``summary.csv`` is damaged.
    """
    figures = sweep_figures(folder)
    place = folder / FIGURES
    paths = [save(figure, place)[0] for figure in figures]
    listed = place / CAPTIONS
    if figures or listed.exists():
        kept = {figure.name for figure in figures}
        for name in _listed(listed) - kept:
            for suffix in (".png", ".pdf"):
                (place / f"{name}{suffix}").unlink(missing_ok=True)
        rows = ([figure.name, figure.title, figure.caption] for figure in figures)
        write_whole(listed, csv_text(("name", "title", "caption"), rows))
    return paths


def _listed(path: Path) -> set[str]:
    if not path.exists():
        return set()
    with path.open(encoding="utf-8", newline="") as file:
        return {row["name"] for row in csv.DictReader(file)}
