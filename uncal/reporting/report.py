"""Everything that a test says: measured once, written to files, shown on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from torch import Tensor

from uncal.reporting.conditional_rows import (
    ConditionalRow,
    conditional_rows,
    conditional_section,
)
from uncal.reporting.curve_rows import CurveRow, curve_rows, curve_section
from uncal.reporting.joint_rows import JointRow, joint_rows, joint_section
from uncal.reporting.layout import csv_text, write_whole
from uncal.reporting.predictions import Predictions, Promise, promise_of
from uncal.reporting.rows import ResultRow, Summary, results_table, summarise
from uncal.reporting.tables import format_terminal, write_results
from uncal.uncertainty.calibrator import IntervalCalibrator

_FILES_NOTE = (
    "`joint.csv`, `conditional.csv` and `calibration_curve.csv` have the numbers of the tables "
    "below unrounded, for all levels and with their bands."
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
    """

    rows: Sequence[ResultRow]
    summary: Summary
    joint: Sequence[JointRow]
    conditional: Sequence[ConditionalRow]
    curve: Sequence[CurveRow]
    promise: Promise


def measure(
    mean: Tensor,
    std: Tensor,
    target: Tensor,
    calibrator: IntervalCalibrator,
    levels: Sequence[float],
    *,
    groups: Sequence[str] | None = None,
    bounds: tuple[Tensor, Tensor] | None = None,
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

    Raises:
        UncertaintyError: the predictions or a level allow no interval.
        NotCalibratedError: the calibrator is not fitted.
        ValueError: no levels, shapes other than (n, 6), values that are not finite, or not one
            label per sample.
    """
    rows = results_table(mean, std, target, calibrator, levels, groups=groups, bounds=bounds)
    tested = Predictions.of(mean, std, target, groups, bounds)
    return Results(
        rows=rows,
        summary=summarise(mean, target, int(calibrator.count)),
        joint=joint_rows(tested, calibrator, levels),
        conditional=conditional_rows(tested, calibrator, levels),
        curve=curve_rows(tested, calibrator),
        promise=promise_of(calibrator),
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
    (:class:`JointRow`), ``conditional.csv`` (:class:`ConditionalRow`) and
    ``calibration_curve.csv`` (:class:`CurveRow`): a class's attributes say what the columns mean.

    Args:
        folder: the run's folder; made if it is not there.
        results: :func:`measure`.
        label: what data this is, for the heading, such as "simulated".
        notes: sentences to print below the main table.
        extra: further named lines of the summary, such as the image-blind control.

    Returns:
        The paths, in the order above.
    """
    sections = [
        joint_section(results.joint, results.promise),
        conditional_section(results.conditional),
        curve_section(results.curve, results.promise),
    ]
    table, text = write_results(
        folder,
        results.rows,
        results.summary,
        label=label,
        notes=[*notes, _FILES_NOTE],
        extra=extra,
        sections=sections,
        promise=results.promise,
    )
    return (
        table,
        text,
        _write_csv(folder / "joint.csv", results.joint),
        _write_csv(folder / "conditional.csv", results.conditional),
        _write_csv(folder / "calibration_curve.csv", results.curve),
    )


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
        extra: further named lines of the summary, such as the image-blind control.
    """
    return format_terminal(
        results.rows,
        results.summary,
        label=label,
        notes=notes,
        extra=extra,
        sections=[joint_section(results.joint, results.promise)],
        promise=results.promise,
    )


def _write_csv(
    path: Path, rows: Sequence[JointRow] | Sequence[ConditionalRow] | Sequence[CurveRow]
) -> Path:
    columns = [field.name for field in fields(rows[0])]
    return write_whole(path, csv_text(columns, (astuple(row) for row in rows)))
