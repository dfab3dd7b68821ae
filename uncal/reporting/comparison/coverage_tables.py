"""Coverage that the paper does not report: of the whole pose, by bins, at all levels."""

from __future__ import annotations

from collections.abc import Sequence

from uncal.geometry import DOF_NAMES
from uncal.reporting.comparison.run_folder import Run
from uncal.reporting.comparison.table import (
    Table,
    lacking,
    made_by,
    section_notes,
    section_rows,
)
from uncal.reporting.conditional_rows import conditional_section
from uncal.reporting.curve_rows import curve_section
from uncal.reporting.joint_rows import JointRow
from uncal.reporting.layout import number

_JOINT = {
    "all six intervals at once (%)": "together",
    "joint box (%)": "joint",
    "Bonferroni box (%)": "bonferroni",
    "Bonferroni / joint, width": "bonferroni_size",
}


def joint_table(runs: Sequence[Run]) -> Table | None:
    """How often the whole pose is held.

    Args:
        runs: to show; those without joint.csv are left out.

    Returns:
        The table; None if no run has one.
    """
    having = [run for run in runs if run.joint]
    if not having:
        return None
    levels = sorted({row.level for run in having for row in run.joint})
    rows = []
    for run in having:
        found = {row.level: row for row in run.joint}
        for name, attribute in _JOINT.items():
            if any(getattr(row, attribute) is not None for row in run.joint):
                cells = [_joint_cell(run, found.get(level), attribute) for level in levels]
                rows.append([run.source, name, *cells])
    return Table(
        "The whole pose: all six DoF at once",
        ["source", "", *(f"{level:g}%" for level in levels)],
        rows,
        notes=[
            "All six intervals at once: the level is asked of each DoF alone, not of the six. The "
            "joint box is made for all six from the largest score; the Bonferroni box takes each "
            "DoF at level 1 - α/6. The paper reports none of them.",
            *_marks(rows),
            *lacking(runs, having, "joint.csv"),
        ],
        made_by=made_by(having),
    )


def conditional_table(runs: Sequence[Run]) -> Table | None:
    """Coverage at each run's first level by σ and by size of the decalibration.

    Args:
        runs: to show; those without conditional.csv are left out.

    Returns:
        The table; None if no run has one.
    """
    having = [run for run in runs if run.conditional]
    if not having:
        return None
    sections = [conditional_section(run.conditional) for run in having]
    levels = dict.fromkeys(f"{run.conditional[0].level:g}%" for run in having)
    return Table(
        f"Coverage of the {' or '.join(levels)} intervals by σ and by size of the decalibration",
        ["source", "", *DOF_NAMES],
        section_rows(having, sections),
        notes=[*section_notes(having, sections), *lacking(runs, having, "conditional.csv")],
        made_by=made_by(having),
    )


def curve_table(runs: Sequence[Run]) -> Table | None:
    """How far each DoF's calibration curve is from the diagonal.

    Args:
        runs: to show; those without calibration_curve.csv are left out.

    Returns:
        The table; None if no run has one.
    """
    having = [run for run in runs if run.curve]
    if not having:
        return None
    sections = [curve_section(run.curve, run.record.promise) for run in having]
    return Table(
        sections[0].title,
        ["source", "", *DOF_NAMES],
        section_rows(having, sections),
        notes=[
            *section_notes(having, sections),
            "The paper shows its curves as figures, without numbers.",
            *lacking(runs, having, "calibration_curve.csv"),
        ],
        made_by=made_by(having),
    )


def _marks(rows: Sequence[Sequence[str]]) -> list[str]:
    """What the marks in the cells mean, if there are any."""
    cells = [cell for row in rows for cell in row[2:]]
    notes = []
    if any(cell.endswith("*") for cell in cells):
        notes.append("*: outside what exact theory allows for exchangeable frames.")
    if "∞" in cells:
        notes.append("∞: the uncertainty calibration set is too small for that level.")
    return notes


def _joint_cell(run: Run, row: JointRow | None, attribute: str) -> str:
    if row is None:
        return "–"
    value = number(getattr(row, attribute), 2 if attribute == "bonferroni_size" else 1)
    outside = run.record.promise == "exact" and row.joint_in_band is False
    return value + ("*" if outside and attribute == "joint" else "")
