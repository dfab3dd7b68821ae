"""Everything that a test says: measured once, written to files, shown on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from torch import Tensor

from uncal.reporting.conditional_rows import (
    ConditionalRow,
    conditional_rows,
    conditional_section,
)
from uncal.reporting.control_rows import (
    ControlRow,
    contribution_cells,
    contribution_line,
    contribution_note,
    control_rows,
    control_section,
)
from uncal.reporting.curve_rows import CurveRow, curve_rows, curve_section
from uncal.reporting.joint_rows import JointRow, joint_rows, joint_section
from uncal.reporting.layout import csv_text, write_whole
from uncal.reporting.prediction_rows import PredictionRow, prediction_rows, write_predictions
from uncal.reporting.predictions import Predictions, Promise, promise_of
from uncal.reporting.rows import ResultRow, Summary, results_table, summarise
from uncal.reporting.tables import format_terminal, write_results
from uncal.uncertainty.calibrator import IntervalCalibrator

if TYPE_CHECKING:
    from uncal.models.control import ControlPrediction

_FILES_NOTE = (
    "`joint.csv`, `conditional.csv` and `calibration_curve.csv` have the numbers of the tables "
    "below unrounded, for all levels and with their bands."
)

_CONTROL_FILE_NOTE = (
    "What the camera contributes is explained below; `control.csv` has the numbers unrounded."
)


@dataclass(frozen=True)
class Results:
    """What was measured on a test set.

    Attributes:
        rows: per level and DoF, the paper's table.
        summary: errors of the whole pose.
        joint: per level, all six DoF at once.
        conditional: coverage by σ and by size of the decalibration.
        curve: coverage from 5% to 95%.
        promise: what the interval method promises.
        control: per DoF, what the camera contributes; None where no control was run.
        predictions: per frame and DoF; None where the frames have no names.
    """

    rows: Sequence[ResultRow]
    summary: Summary
    joint: Sequence[JointRow]
    conditional: Sequence[ConditionalRow]
    curve: Sequence[CurveRow]
    promise: Promise
    control: Sequence[ControlRow] | None = None
    predictions: Sequence[PredictionRow] | None = None


def measure(
    mean: Tensor,
    std: Tensor,
    target: Tensor,
    calibrator: IntervalCalibrator,
    levels: Sequence[float],
    *,
    groups: Sequence[str] | None = None,
    bounds: tuple[Tensor, Tensor] | None = None,
    control: ControlPrediction | None = None,
    frames: Sequence[str] | None = None,
) -> Results:
    """Measure everything that the report shows.

    Args:
        mean: (n, 6) estimated decalibration, metres and radians.
        std: (n, 6) σ of the estimate.
        target: (n, 6) true decalibration.
        calibrator: fitted on the uncertainty calibration set.
        levels: coverage levels in (0, 1); the first is the one shown by bins.
        groups: n labels, where the calibrator needs them.
        bounds: (n, 6) lower and upper quantile outputs, where the calibrator needs them.
        control: the image-blind control on the same frames.
        frames: n names of the frames, for the single predictions.

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        NotCalibratedError: the calibrator is not fitted.
        ValueError: no levels, shapes other than (n, 6), values that are not finite, or not one
            label or name per sample.
    """
    rows = results_table(mean, std, target, calibrator, levels, groups=groups, bounds=bounds)
    tested = Predictions.of(mean, std, target, groups, bounds)
    mae_after = {row.dof: row.mae_after for row in rows}
    return Results(
        rows=rows,
        summary=summarise(mean, target, int(calibrator.count)),
        joint=joint_rows(tested, calibrator, levels),
        conditional=conditional_rows(tested, calibrator, levels),
        curve=curve_rows(tested, calibrator),
        promise=promise_of(calibrator),
        control=None if control is None else control_rows(control, list(mae_after.values())),
        predictions=None if frames is None else prediction_rows(tested, calibrator, levels, frames),
    )


def write_report(
    folder: Path,
    results: Results,
    *,
    label: str,
    notes: Sequence[str] = (),
    extra: Mapping[str, str] | None = None,
) -> tuple[Path, ...]:
    """Write all tables, each whole or not at all; floats in a csv read back exactly.

    ``results.csv`` (:class:`ResultRow`), ``results.md`` (for people), ``joint.csv``
    (:class:`JointRow`), ``conditional.csv`` (:class:`ConditionalRow`), ``calibration_curve.csv``
    (:class:`CurveRow`) and, if they were measured, ``control.csv`` (:class:`ControlRow`) and
    ``predictions.csv`` (:class:`PredictionRow`): a class's attributes say what the columns mean.
    Of the last two, files of an earlier run are removed if this one has none.

    Args:
        folder: the run's folder; made if it is not there.
        results: :func:`measure`.
        label: what data this is, for the heading, such as "simulated".
        notes: sentences to print below the main table.
        extra: further named lines of the summary.

    Returns:
        The paths, in the order above.
    """
    control = results.control
    sections = [
        *([] if control is None else [control_section(control)]),
        joint_section(results.joint, results.promise),
        conditional_section(results.conditional),
        curve_section(results.curve, results.promise),
    ]
    table, text = write_results(
        folder,
        results.rows,
        results.summary,
        label=label,
        notes=[*notes, _FILES_NOTE, *([] if control is None else [_CONTROL_FILE_NOTE])],
        extra=extra,
        sections=sections,
        promise=results.promise,
        more=[] if control is None else [contribution_cells(control)],
    )
    written = [
        table,
        text,
        _write_csv(folder / "joint.csv", results.joint),
        _write_csv(folder / "conditional.csv", results.conditional),
        _write_csv(folder / "calibration_curve.csv", results.curve),
    ]
    for name in ("control.csv", "predictions.csv"):
        (folder / name).unlink(missing_ok=True)
    if control is not None:
        written.append(_write_csv(folder / "control.csv", control))
    if results.predictions is not None:
        written.append(write_predictions(folder / "predictions.csv", results.predictions))
    return tuple(written)


def format_report(
    results: Results,
    *,
    label: str,
    notes: Sequence[str] = (),
    extra: Mapping[str, str] | None = None,
) -> str:
    """The main table and that of the whole pose as aligned plain text.

    Args:
        results: :func:`measure`.
        label: what data this is, for the heading, such as "simulated".
        notes: sentences to print below the main table.
        extra: further named lines of the summary.
    """
    control = results.control
    return format_terminal(
        results.rows,
        results.summary,
        label=label,
        notes=[*([] if control is None else [contribution_note(control)]), *notes],
        extra={**({} if control is None else contribution_line(control)), **(extra or {})},
        sections=[joint_section(results.joint, results.promise)],
        promise=results.promise,
        more=[] if control is None else [contribution_cells(control)],
    )


def _write_csv(
    path: Path,
    rows: Sequence[JointRow] | Sequence[ConditionalRow] | Sequence[CurveRow] | Sequence[ControlRow],
) -> Path:
    columns = [field.name for field in fields(rows[0])]
    return write_whole(path, csv_text(columns, (astuple(row) for row in rows)))
