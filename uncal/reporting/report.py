"""The report of a run: its CSV files, results.md, and the table on the terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from uncal.reporting import frames, sections
from uncal.reporting.evaluation import BAND_CONFIDENCE
from uncal.reporting.layout import aligned_lines, markdown_lines, number, write_whole
from uncal.reporting.measure import Results
from uncal.uncertainty.conformal.quantile import samples_needed

TERMINAL_WIDTH = 110

_FILES_NOTES = (
    "`results.csv` has the same numbers unrounded, one row per DoF and level: `level`, "
    "`picp`, `coverage_low`, `coverage_high` in percent, the others in the row's `unit`.",
    "`joint.csv`, `conditional.csv` and `calibration_curve.csv` have the numbers of the tables "
    "below unrounded, for all levels and with their reference bands.",
)

_CONTROL_FILE_NOTE = (
    "What the camera contributes is explained below; `control.csv` has the numbers unrounded."
)

_NO_LAW = {
    "none": "This interval method guarantees no coverage. The band columns of the CSV files are "
    "the reference bands of split conformal intervals.",
    "by group": "This interval method guarantees coverage by group, to which the Beta-Binomial "
    "law of pooled frames does not apply: the band columns of the CSV files are for reference "
    "only.",
}

_TOO_FEW_GROUPS = (
    "∞: too few groups, or frames of a group, in the uncertainty calibration set for that level."
)


def write_report(
    folder: Path, results: Results, *, label: str, notes: Sequence[str] = ()
) -> tuple[Path, ...]:
    """Write all tables, each whole or not at all; floats in a CSV read back exactly.

    ``control.csv`` and ``predictions.csv`` of an earlier run are removed if this one has none.

    Returns:
        The paths: results.csv, results.md, joint.csv, conditional.csv, calibration_curve.csv and,
        where they were measured, control.csv and predictions.csv.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tables = {
        frames.RESULTS: results.per_dof,
        frames.JOINT: results.joint,
        frames.CONDITIONAL: results.conditional,
        frames.CURVE: results.curve,
        frames.CONTROL: results.control,
        frames.PREDICTIONS: results.predictions,
    }
    written = []
    for schema, frame in tables.items():
        if frame is None:
            (folder / schema.file).unlink(missing_ok=True)
        else:
            written.append(frames.write_csv(folder / schema.file, frame))
    written.insert(1, write_whole(folder / "results.md", _markdown(results, label, notes)))
    return tuple(written)


def format_report(results: Results, *, label: str, notes: Sequence[str] = ()) -> str:
    """The main table and that of the whole pose as plain text, :data:`TERMINAL_WIDTH` wide."""
    control = results.control
    grid = sections.main_grid(results.per_dof, control, results.guarantee == "exact")
    heading = f"Results on {label} data"
    gaps = [index for index, line in enumerate(grid) if " PICP" in line[0]]
    lines = [heading, "=" * len(heading), _sizes(results), "", *aligned_lines(grid, gaps=gaps), ""]
    lines += _wrapped(_summary_lines(results))
    lines += _wrapped([] if control is None else [sections.contribution_line(control)])
    lines += _wrapped(_explanations(results))
    lines += _wrapped([*([] if control is None else [sections.contribution_note(control)]), *notes])
    pose = sections.joint_section(results.joint, results.guarantee)
    lines += ["", pose.title, "-" * len(pose.title), *aligned_lines(pose.grid), ""]
    return "\n".join([*lines, *_wrapped(pose.notes)])


def _markdown(results: Results, label: str, notes: Sequence[str]) -> str:
    control, guarantee = results.control, results.guarantee
    about_files = [*_FILES_NOTES, *([] if control is None else [_CONTROL_FILE_NOTE])]
    explained = [*_explanations(results), *notes, *about_files]
    paragraphs = [
        f"# Results on {label} data",
        _sizes(results),
        "\n".join(
            markdown_lines(sections.main_grid(results.per_dof, control, guarantee == "exact"))
        ),
        "\n".join(f"- {text}" for text in _summary_lines(results)),
        "\n".join(f"- {text}" for text in explained),
    ]
    for section in (
        *([] if control is None else [sections.control_section(control)]),
        sections.joint_section(results.joint, guarantee),
        sections.conditional_section(results.conditional),
        sections.curve_section(results.curve, guarantee),
    ):
        paragraphs += section.markdown()
    return "\n\n".join(paragraphs) + "\n"


def _wrapped(texts: Sequence[str]) -> list[str]:
    return [textwrap.fill(text, TERMINAL_WIDTH, subsequent_indent="  ") for text in texts]


def _sizes(results: Results) -> str:
    return (
        f"{results.summary.n_test} frames in the test set, "
        f"{results.summary.n_calibration} in the uncertainty calibration set."
    )


def _summary_lines(results: Results) -> list[str]:
    summary = results.summary
    return [
        f"Mean over the DoF of MAE after / before: {number(summary.mean_ratio, 3)}",
        f"Mean translation error: {summary.translation_after:.2f} cm "
        f"(decalibration: {summary.translation_before:.2f} cm)",
        f"Mean rotation error: {summary.rotation_after:.3f}° "
        f"(decalibration: {summary.rotation_before:.3f}°)",
    ]


def _explanations(results: Results) -> list[str]:
    """What the reader needs to know about this table, and no more."""
    rows, guarantee = results.per_dof, results.guarantee
    widest = rows.groupby("level")["mpiw"].max()
    infinite = [float(level) for level in widest.index[widest.map(math.isinf)]]
    if guarantee != "exact":
        too_few = guarantee == "by group" and infinite
        return [_NO_LAW[guarantee], *([_TOO_FEW_GROUPS] if too_few else [])]
    lines = [
        "Reference band: where the Beta-Binomial law puts the coverage of one DoF with probability "
        f"{100 * BAND_CONFIDENCE:g}% at these sample sizes, if the frames of both sets are "
        "exchangeable."
    ]
    if not all(rows["in_band"]):
        lines.append(sections.OUTSIDE)
    m = results.summary.n_calibration
    for level in infinite:
        needed = samples_needed(1 - Fraction(str(level)) / 100)
        if m < needed:
            lines.append(
                f"∞: {m} samples in the uncertainty calibration set are too few for a {level:g}% "
                f"interval; it needs {needed}."
            )
    return lines
