"""Errors of the estimates, and what the camera contributes to them."""

from __future__ import annotations

from collections.abc import Sequence

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.reporting.comparison.run_folder import Run
from uncal.reporting.comparison.table import (
    DOF_HEADINGS,
    Table,
    lacking,
    length,
    made_by,
    section_notes,
    section_rows,
)
from uncal.reporting.control_rows import control_section
from uncal.reporting.published import PublishedPaper


def point_errors(paper: PublishedPaper, runs: Sequence[Run]) -> Table:
    """How far estimates are off: of one pass without dropout and of the mean over the passes.

    Args:
        paper: with the published errors.
        runs: to stand beside them.
    """
    rows = [
        [
            f"Paper, section 4.4: real KITTI, {each.source}",
            "mean error",
            *["–"] * len(DOF_NAMES),
            each.translation,
            each.rotation,
        ]
        for each in paper.errors
    ]
    count = len(rows)
    for run in runs:
        first = run.rows[: len(DOF_NAMES)]
        rows.append(
            [
                run.source,
                "before (the decalibration)",
                *_with_means([row.mae_before for row in first]),
            ]
        )
        after = _with_means([row.mae_after for row in first])
        rows.append([run.source, "after, mean of the passes", *after])
        if run.control:
            single = _with_means([row.mae_single for row in run.control])
            rows.append([run.source, "after, one pass without dropout", *single])
        if run.whole is not None:
            both = length(run.whole.translation_after, "cm"), length(run.whole.rotation_after, "°")
            rows.append([run.source, "after, length and angle", *["–"] * len(DOF_NAMES), *both])
    having = [run for run in runs if run.control]
    return Table(
        "Errors of the estimate",
        ["source", "mean absolute error", *DOF_HEADINGS, "translation (cm)", "rotation (°)"],
        rows,
        published=count,
        notes=[
            "Translation and rotation: mean over the three axes; in the last line of a run the "
            "length and the angle of the whole error. The paper does not say which of the two its "
            "numbers are.",
            f"Paper's rows: {paper.source('section 4.4')}. Its claim is that MC dropout does not "
            "cost accuracy: for a run, that is the mean of the passes against one pass without "
            "dropout.",
            *lacking(runs, having, "control.csv (one pass without dropout)"),
        ],
        made_by=made_by(runs),
    )


def control_table(runs: Sequence[Run]) -> Table | None:
    """The image-blind control.

    Args:
        runs: to show; those without one are left out.

    Returns:
        The table; None if no run has one.
    """
    having = [run for run in runs if run.control]
    if not having:
        return None
    sections = [control_section(run.control) for run in having]
    return Table(
        sections[0].title,
        ["source", "", *DOF_HEADINGS],
        section_rows(having, sections),
        notes=[
            *section_notes(having, sections),
            "The paper has no such control.",
            *lacking(runs, having, "control.csv"),
        ],
        made_by=made_by(having),
    )


def _with_means(values: Sequence[float]) -> list[str]:
    """Six errors, then the mean over X, Y, Z and that over roll, pitch, yaw."""
    cells = [length(value, unit) for value, unit in zip(values, DOF_UNITS, strict=True)]
    return [*cells, length(sum(values[:3]) / 3, "cm"), length(sum(values[3:]) / 3, "°")]
