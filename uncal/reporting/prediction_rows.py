"""Every prediction of a test set with its intervals: predictions.csv, written and read."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from uncal.errors import UncalError
from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.reporting.layout import csv_text, write_whole
from uncal.reporting.predictions import Predictions, percent
from uncal.uncertainty.calibrator import IntervalCalibrator

_COLUMNS = ("frame", "dof", "unit", "truth", "estimate", "sigma")


@dataclass(frozen=True)
class PredictionRow:
    """One degree of freedom of one test frame, in centimetres or degrees.

    Attributes:
        frame: name of the frame, unique in its recording.
        dof: X, Y, Z, Roll, Pitch or Yaw.
        unit: "cm" or "°", of all numbers in the row.
        truth: the true decalibration.
        estimate: the estimated one, mean of the stochastic passes.
        sigma: their standard deviation.
        bounds: level in percent → (lower, upper); infinite if the uncertainty calibration set is
            too small for the level. The columns ``lower_90``, ``upper_90``, …
    """

    frame: str
    dof: str
    unit: str
    truth: float
    estimate: float
    sigma: float
    bounds: Mapping[float, tuple[float, float]]


def prediction_rows(
    tested: Predictions,
    calibrator: IntervalCalibrator,
    levels: Sequence[float],
    frames: Sequence[str],
) -> list[PredictionRow]:
    """One row per frame and DoF, frames outermost, in the order given.

    Args:
        tested: the test set.
        calibrator: fitted on the uncertainty calibration set.
        levels: coverage levels in (0, 1).
        frames: n names, one per sample.

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        NotCalibratedError: the calibrator is not fitted.
        ValueError: not one name per sample.
    """
    if len(frames) != len(tested.target):
        raise ValueError(
            f"{len(frames)} frame names for {len(tested.target)} samples; give one each."
        )
    truth, estimate, sigma = (t.tolist() for t in (tested.target, tested.mean, tested.std))
    made = [tested.intervals(calibrator, level) for level in levels]
    ends = [(each.lower.tolist(), each.upper.tolist()) for each in made]
    percents = [percent(level) for level in levels]
    return [
        PredictionRow(
            frame=frame,
            dof=dof,
            unit=DOF_UNITS[j],
            truth=DOF_SCALE[j] * truth[i][j],
            estimate=DOF_SCALE[j] * estimate[i][j],
            sigma=DOF_SCALE[j] * sigma[i][j],
            bounds=MappingProxyType(
                {
                    level: (DOF_SCALE[j] * lower[i][j], DOF_SCALE[j] * upper[i][j])
                    for level, (lower, upper) in zip(percents, ends, strict=True)
                }
            ),
        )
        for i, frame in enumerate(frames)
        for j, dof in enumerate(DOF_NAMES)
    ]


def write_predictions(path: Path, rows: Sequence[PredictionRow]) -> Path:
    """Write the rows whole or not at all; floats read back exactly.

    Args:
        path: ``predictions.csv`` in a folder that exists.
        rows: :func:`prediction_rows`, at least one.

    Returns:
        The path.
    """
    ends = [f"{end}_{level:.12g}" for level in rows[0].bounds for end in ("lower", "upper")]
    lines = (
        (
            *(row.frame, row.dof, row.unit, row.truth, row.estimate, row.sigma),
            *(end for both in row.bounds.values() for end in both),
        )
        for row in rows
    )
    return write_whole(path, csv_text([*_COLUMNS, *ends], lines))


def read_predictions(path: Path) -> list[PredictionRow]:
    """Read what :func:`write_predictions` wrote.

    Args:
        path: ``predictions.csv``.

    Raises:
        UncalError: the file is missing, or damaged: cut off, a column or a cell missing, text in
            place of a number, NaN, or a frame without its six DoF.
    """
    try:
        text = path.read_text(encoding="utf-8")
        table = csv.DictReader(io.StringIO(text, newline=""), strict=True)
        levels = _levels(table.fieldnames or ())
        rows = [_row(cells, levels) for cells in table]
        _check_frames(rows)
        if not text.endswith("\n"):
            raise ValueError("its last line is cut off")
    except (OSError, ValueError, csv.Error) as error:
        raise UncalError(
            f"{path}: {error}; expected the predictions of a test run as uncal writes them. Run "
            "python -m uncal.evaluate ckpt=… with the run's checkpoint to write them again."
        ) from error
    return rows


def _levels(columns: Sequence[str]) -> dict[float, tuple[str, str]]:
    """Level in percent → names of its two columns."""
    missing = [name for name in _COLUMNS if name not in columns]
    levels = {}
    for name in columns:
        end, _, level = name.partition("_")
        if end == "lower":
            levels[float(level)] = (name, f"upper_{level}")
    missing += [upper for _, upper in levels.values() if upper not in columns]
    if missing:
        raise ValueError(f"no column {', '.join(missing)}")
    return levels


def _check_frames(rows: Sequence[PredictionRow]) -> None:
    for start in range(0, max(1, len(rows)), len(DOF_NAMES)):
        frame = rows[start : start + len(DOF_NAMES)]
        if tuple(row.dof for row in frame) != DOF_NAMES or len({row.frame for row in frame}) != 1:
            name = frame[0].frame if frame else "the first frame"
            raise ValueError(f"{name} has not one row each of {', '.join(DOF_NAMES)}")


def _row(cells: Mapping[str, str | None], levels: Mapping[float, tuple[str, str]]) -> PredictionRow:
    def cell(name: str) -> str:
        text = cells[name]
        if not text:
            raise ValueError(f"{name} of {cells['frame']} is missing")
        return text

    def value(name: str) -> float:
        text = cell(name)
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if math.isnan(number):
            raise ValueError(f"{name} of {cells['frame']} is {text!r}, not a number")
        return number

    return PredictionRow(
        cell("frame"),
        cell("dof"),
        cell("unit"),
        value("truth"),
        value("estimate"),
        value("sigma"),
        MappingProxyType({level: (value(a), value(b)) for level, (a, b) in levels.items()}),
    )
