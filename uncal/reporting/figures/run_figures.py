"""All figures of one run, from the files in its folder."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

from uncal.reporting.figures.coverage import calibration_curves, joint_coverage
from uncal.reporting.figures.predictions import ordered_intervals, width_against_error
from uncal.reporting.figures.style import NamedFigure
from uncal.reporting.frames import CURVE, JOINT, PREDICTIONS, Schema, read_csv
from uncal.reporting.run import Run

if TYPE_CHECKING:
    import pandas as pd


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
