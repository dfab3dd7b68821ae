"""Write the paper's Table 1 for people (terminal, results.md) and for programs (results.csv)."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from fractions import Fraction
from pathlib import Path

from uncal.reporting.layout import (
    Section,
    aligned_lines,
    csv_text,
    markdown_lines,
    number,
    write_whole,
)
from uncal.reporting.predictions import BAND_CONFIDENCE, Promise
from uncal.reporting.rows import ResultRow, Summary, results_table, summarise
from uncal.uncertainty.quantile import samples_needed

__all__ = [
    "COLUMNS",
    "ResultRow",
    "Summary",
    "format_terminal",
    "results_table",
    "summarise",
    "write_results",
]

COLUMNS: tuple[str, ...] = (
    "dof",
    "unit",
    "level",
    "picp",
    "mpiw",
    "is",
    "coverage_low",
    "coverage_high",
    "in_band",
    "mae_before",
    "mae_after",
    "ratio",
    "n_test",
    "n_calibration",
)
"""The columns of results.csv: the fields of :class:`ResultRow`, ``is`` for the interval score.

``level``, ``picp`` and ``coverage_*`` are percent, lengths cm, angles degrees; infinite is ``inf``.
"""

TERMINAL_WIDTH = 110


def write_results(
    folder: Path,
    rows: Sequence[ResultRow],
    summary: Summary,
    *,
    label: str,
    notes: Sequence[str] = (),
    extra: Mapping[str, str] | None = None,
    sections: Sequence[Section] = (),
    promise: Promise = "exact",
    more: Sequence[Sequence[str]] = (),
) -> tuple[Path, Path]:
    """Write ``results.csv`` and ``results.md``, each whole or not at all.

    The csv holds every float so that it reads back exactly: two runs can be compared bit by bit.

    Args:
        folder: the run's folder; made if it is not there.
        rows: :func:`results_table`.
        summary: :func:`summarise`.
        label: what data this is, for the heading, such as "simulated".
        notes: sentences to print below the table.
        extra: further named lines of the summary.
        sections: smaller tables to add below.
        promise: what the interval method promises; only the exact law's band is called allowed.
        more: further lines of the table, below the errors: a name and one cell per DoF.

    Returns:
        The paths of the csv and of the md.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"# Results on {label} data", "", _sizes(summary), ""]
    lines += markdown_lines(_grid(rows, promise, more))
    lines += ["", *(f"- {text}" for text in _summary_lines(summary, extra or {})), ""]
    lines += [f"- {text}" for text in [*_explanations(rows, promise), *notes]]
    lines.append(
        "- `results.csv` has the same numbers unrounded, one row per DoF and level: `level`, "
        "`picp`, `coverage_low`, `coverage_high` in percent, the others in the row's `unit`."
    )
    for section in sections:
        lines += ["", f"## {section.title}", "", *markdown_lines(section.grid), ""]
        lines += [f"- {note}" for note in section.notes]
    return (
        write_whole(folder / "results.csv", csv_text(COLUMNS, (astuple(row) for row in rows))),
        write_whole(folder / "results.md", "\n".join(lines) + "\n"),
    )


def format_terminal(
    rows: Sequence[ResultRow],
    summary: Summary,
    *,
    label: str,
    notes: Sequence[str] = (),
    extra: Mapping[str, str] | None = None,
    sections: Sequence[Section] = (),
    promise: Promise = "exact",
    more: Sequence[Sequence[str]] = (),
) -> str:
    """The table as aligned plain text of at most :data:`TERMINAL_WIDTH` columns.

    Args:
        rows: :func:`results_table`.
        summary: :func:`summarise`.
        label: what data this is, for the heading, such as "simulated".
        notes: sentences to print below the table.
        extra: further named lines of the summary.
        sections: smaller tables to add below.
        promise: what the interval method promises; only the exact law's band is called allowed.
        more: further lines of the table, below the errors: a name and one cell per DoF.
    """
    grid = _grid(rows, promise, more)
    heading = f"Results on {label} data"
    lines = [heading, "=" * len(heading), _sizes(summary), ""]
    levels = [index for index, line in enumerate(grid) if " PICP" in line[0]]
    lines += [*aligned_lines(grid, gaps=levels), ""]
    lines += _wrapped(_summary_lines(summary, extra or {}))
    lines += _wrapped([*_explanations(rows, promise), *notes])
    for section in sections:
        lines += ["", section.title, "-" * len(section.title), *aligned_lines(section.grid), ""]
        lines += _wrapped(section.notes)
    return "\n".join(lines)


def _wrapped(texts: Sequence[str]) -> list[str]:
    return [textwrap.fill(text, TERMINAL_WIDTH, subsequent_indent="  ") for text in texts]


def _grid(
    rows: Sequence[ResultRow], promise: Promise, more: Sequence[Sequence[str]]
) -> list[list[str]]:
    """DoF as columns like the paper's table: a heading, the errors, three lines per level."""
    levels = list(dict.fromkeys(row.level for row in rows))
    at_level = {level: [row for row in rows if row.level == level] for level in levels}
    errors = at_level[levels[0]]
    lines = [
        ["", *(f"{row.dof} ({row.unit})" for row in errors)],
        ["MAE before", *(_length(row.mae_before, row) for row in errors)],
        ["MAE after", *(_length(row.mae_after, row) for row in errors)],
        ["after / before", *(number(row.ratio, 2) for row in errors)],
        *(list(line) for line in more),
    ]
    for level, group in at_level.items():
        first, exact = group[0], promise == "exact"
        allowed = f", allowed {first.coverage_low:.1f}-{first.coverage_high:.1f}" if exact else ""
        marks = ["*" if exact and not row.in_band else "" for row in group]
        lines += [
            [
                f"{level:g}% PICP{allowed} (%)",
                *(f"{row.picp:.1f}{mark}" for row, mark in zip(group, marks, strict=True)),
            ],
            [f"{level:g}% MPIW", *(_length(row.mpiw, row) for row in group)],
            [f"{level:g}% IS", *(_length(row.interval_score, row) for row in group)],
        ]
    return lines


def _sizes(summary: Summary) -> str:
    return (
        f"{summary.n_test} frames in the test set, "
        f"{summary.n_calibration} in the uncertainty calibration set."
    )


def _summary_lines(summary: Summary, extra: Mapping[str, str]) -> list[str]:
    return [
        f"Mean over the DoF of MAE after / before: {number(summary.mean_ratio, 3)}",
        f"Mean translation error: {summary.translation_after:.2f} cm "
        f"(decalibration: {summary.translation_before:.2f} cm)",
        f"Mean rotation error: {summary.rotation_after:.3f}° "
        f"(decalibration: {summary.rotation_before:.3f}°)",
        *(f"{name}: {value}" for name, value in extra.items()),
    ]


_WITHOUT_LAW = {
    "none": "This interval method promises no coverage. The band columns of the csv files say what "
    "split conformal intervals would be allowed here: a yardstick, nothing more.",
    "by group": "This interval method promises its coverage by group, which the exact law of "
    "pooled frames does not describe: the band columns of the csv files are only a yardstick.",
}

_TOO_FEW_GROUPS = (
    "∞: too few groups, or frames of a group, in the uncertainty calibration set for that level."
)


def _explanations(rows: Sequence[ResultRow], promise: Promise) -> list[str]:
    """What the reader needs to know about this table, and no more."""
    if promise != "exact":
        too_few = promise == "by group" and any(math.isinf(row.mpiw) for row in rows)
        return [_WITHOUT_LAW[promise], *([_TOO_FEW_GROUPS] if too_few else [])]
    lines = [
        "Allowed: the coverage that exact theory (Beta-Binomial law) gives one DoF with "
        f"probability {100 * BAND_CONFIDENCE:g}% at these sample sizes, if the frames of both "
        "sets are exchangeable."
    ]
    if any(not row.in_band for row in rows):
        lines.append("*: outside the allowed band.")
    infinite = {row.level: row for row in rows if math.isinf(row.mpiw)}
    for level, row in infinite.items():
        needed = samples_needed(1 - Fraction(str(level)) / 100)
        if row.n_calibration < needed:
            lines.append(
                f"∞: {row.n_calibration} samples in the uncertainty calibration set are too few "
                f"for a {level:g}% interval; it needs {needed}."
            )
    return lines


def _length(value: float, row: ResultRow) -> str:
    """Tenths of a millimetre, thousandths of a degree."""
    return number(value, 2 if row.unit == "cm" else 3)
