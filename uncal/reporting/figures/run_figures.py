"""All figures of one run, from the files in its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

from omegaconf import OmegaConf

from uncal import uncertainty
from uncal.reporting.csv_rows import read_rows
from uncal.reporting.curve_rows import CurveRow
from uncal.reporting.figures.calibration_curves import (
    calibration_curves,
    why_yardstick,
)
from uncal.reporting.figures.columns import DofColumns, dof_columns
from uncal.reporting.figures.joint_coverage import joint_coverage
from uncal.reporting.figures.named import NamedFigure
from uncal.reporting.figures.ordered_intervals import ordered_intervals
from uncal.reporting.figures.width_against_error import width_against_error
from uncal.reporting.joint_rows import JointRow
from uncal.reporting.prediction_rows import read_predictions
from uncal.reporting.predictions import promise_of
from uncal.reporting.run_record import read_run

CURVE, JOINT, PREDICTIONS = "calibration_curve.csv", "joint.csv", "predictions.csv"


def run_figures(folder: Path, label: str, yardstick: str | None = None) -> list[NamedFigure]:
    """Every figure that the files of a run allow; a missing file means fewer figures.

    Args:
        folder: of a run of ``uncal.train`` or ``uncal.evaluate``.
        label: what the data are, such as "simulated".
        yardstick: :func:`uncal.reporting.figures.calibration_curves.why_yardstick`; None takes it
            from the run's ``run.json``, if that knows.

    Raises:
        UncalError: a file is damaged.
    """
    made = [make() for make in figure_makers(folder, label, yardstick).values()]
    return [figure for figure in made if figure is not None]


def figure_makers(
    folder: Path, label: str, yardstick: str | None = None
) -> dict[str, Callable[[], NamedFigure | None]]:
    """One function per figure, so that one that fails leaves the others.

    Args:
        folder: of the run.
        label: what the data are, such as "simulated".
        yardstick: as in :func:`run_figures`.

    Returns:
        Name of the figure → what draws it, or answers None where the run does not allow it.
    """
    if yardstick is None:
        record = read_run(folder) or {}
        settings = record.get("settings")
        yardstick = recorded_yardstick(settings) if isinstance(settings, dict) else None

    @cache
    def columns() -> list[DofColumns]:
        return dof_columns(read_predictions(folder / PREDICTIONS))

    makers: dict[str, Callable[[], NamedFigure | None]] = {}
    if (folder / CURVE).exists():
        makers["calibration_curves"] = lambda: calibration_curves(
            read_rows(folder / CURVE, CurveRow), label, yardstick
        )
    if (folder / JOINT).exists():
        makers["joint_coverage"] = lambda: joint_coverage(
            read_rows(folder / JOINT, JointRow), label, yardstick
        )
    if (folder / PREDICTIONS).exists():
        makers["ordered_intervals"] = lambda: ordered_intervals(columns(), label)
        makers["width_against_error"] = lambda: width_against_error(columns(), label)
    return makers


def recorded_yardstick(settings: Mapping[str, object]) -> str | None:
    """Why the exact law's band is no promise, as far as the settings of a run tell.

    Args:
        settings: of ``run.json``, or the recipe of a module.

    Returns:
        :func:`uncal.reporting.figures.calibration_curves.why_yardstick`; None where they do not
        tell.
    """
    config = OmegaConf.create(dict(settings))
    target = OmegaConf.select(config, "interval.calibrator._target_")
    split_by = OmegaConf.select(config, "split.by")
    if target is None or split_by is None:
        return None
    kind = getattr(uncertainty, str(target).rpartition(".")[2], None)
    if not isinstance(kind, type) or not issubclass(kind, uncertainty.IntervalCalibrator):
        return None
    test = OmegaConf.select(config, "split.test", default="own")
    return why_yardstick(promise_of(kind()), split_by, test)
