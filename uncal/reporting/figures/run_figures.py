"""All figures of one run, from the files in its folder."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from uncal.reporting.figures.coverage import calibration_curves, joint_coverage
from uncal.reporting.figures.predictions import ordered_intervals, width_against_error
from uncal.reporting.figures.style import NamedFigure
from uncal.reporting.frames import CURVE, JOINT, PREDICTIONS, Schema, read_csv
from uncal.reporting.run import recorded_caveat
from uncal.reporting.run_record import read_record

if TYPE_CHECKING:
    import pandas as pd


def run_figures(folder: Path, label: str, caveat: str | None = None) -> list[NamedFigure]:
    """Every figure that the files of a run allow; a missing file means fewer figures.

    Raises:
        UncalError: a file is damaged.
    """
    drawn = [draw() for draw in figure_makers(folder, label, caveat).values()]
    return [figure for figure in drawn if figure is not None]


def figure_makers(
    folder: Path, label: str, caveat: str | None = None
) -> dict[str, Callable[[], NamedFigure | None]]:
    """One function per figure, so that one that fails leaves the others.

    Returns:
        Name of the figure → what draws it, or answers None where the run does not allow it.
    """
    if caveat is None:
        settings = (read_record(folder) or {}).get("settings")
        caveat = recorded_caveat(settings) if isinstance(settings, dict) else None

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
