"""Write the paper's Table 1 for people (terminal, results.md) and for programs (results.csv)."""

from __future__ import annotations

import csv
import io
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path

from uncal.reporting.rows import BAND_CONFIDENCE, ResultRow, Summary, results_table, summarise
from uncal.uncertainty.conformal import samples_needed

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
) -> tuple[Path, Path]:
    """Write ``results.csv`` and ``results.md``, each whole or not at all.

    The csv holds every float so that it reads back exactly: two runs can be compared bit by bit.

    Args:
        folder: the run's folder; made if it is not there.
        rows: :func:`results_table`.
        summary: :func:`summarise`.
        label: what data this is, for the heading, such as "simulated".
        notes: sentences to print below the table.
        extra: further named lines of the summary, such as the image-blind control.

    Returns:
        The paths of the csv and of the md.
    """
    folder.mkdir(parents=True, exist_ok=True)
    table, text = folder / "results.csv", folder / "results.md"
    _write(table, _csv(rows))
    _write(text, _markdown(rows, summary, label, notes, extra or {}))
    return table, text


def format_terminal(
    rows: Sequence[ResultRow],
    summary: Summary,
    *,
    label: str,
    notes: Sequence[str] = (),
    extra: Mapping[str, str] | None = None,
) -> str:
    """The table as aligned plain text of at most :data:`TERMINAL_WIDTH` columns.

    Args:
        rows: :func:`results_table`.
        summary: :func:`summarise`.
        label: what data this is, for the heading, such as "simulated".
        notes: sentences to print below the table.
        extra: further named lines of the summary, such as the image-blind control.
    """
    grid = _grid(rows)
    first = max(len(line[0]) for line in grid)
    others = max(len(cell) for line in grid for cell in line[1:])
    heading = f"Results on {label} data"
    lines = [heading, "=" * len(heading), _sizes(summary), ""]
    for line in grid:
        if line is not grid[0] and line[0].endswith("(%)"):
            lines.append("")
        cells = "".join(f"  {cell:>{others}}" for cell in line[1:])
        lines.append(f"{line[0]:<{first}}{cells}")
    lines.append("")
    for text in [*_summary_lines(summary, extra or {}), *_explanations(rows), *notes]:
        lines.append(textwrap.fill(text, TERMINAL_WIDTH, subsequent_indent="  "))
    return "\n".join(lines)


def _markdown(
    rows: Sequence[ResultRow],
    summary: Summary,
    label: str,
    notes: Sequence[str],
    extra: Mapping[str, str],
) -> str:
    header, *body = _grid(rows)
    lines = [f"# Results on {label} data", "", _sizes(summary), ""]
    lines += [_md_line(header), _md_line([":--"] + ["--:"] * (len(header) - 1))]
    lines += [_md_line(line) for line in body]
    lines += ["", *(f"- {text}" for text in _summary_lines(summary, extra)), ""]
    lines += [f"- {text}" for text in [*_explanations(rows), *notes]]
    lines.append(
        "- `results.csv` has the same numbers unrounded, one row per DoF and level: `level`, "
        "`picp`, `coverage_low`, `coverage_high` in percent, the others in the row's `unit`."
    )
    return "\n".join(lines) + "\n"


def _grid(rows: Sequence[ResultRow]) -> list[list[str]]:
    """DoF as columns like the paper's table: a heading, the errors, three lines per level."""
    levels = list(dict.fromkeys(row.level for row in rows))
    at_level = {level: [row for row in rows if row.level == level] for level in levels}
    first = at_level[levels[0]]
    lines = [
        ["", *(f"{row.dof} ({row.unit})" for row in first)],
        ["MAE before", *(_length(row.mae_before, row) for row in first)],
        ["MAE after", *(_length(row.mae_after, row) for row in first)],
        ["after / before", *(_number(row.ratio, 2) for row in first)],
    ]
    for level, group in at_level.items():
        band = f"{group[0].coverage_low:.1f}-{group[0].coverage_high:.1f}"
        marks = ["" if row.in_band else "*" for row in group]
        lines += [
            [
                f"{level:g}% PICP, allowed {band} (%)",
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
        f"Mean over the DoF of MAE after / before: {_number(summary.mean_ratio, 3)}",
        f"Mean translation error: {summary.translation_after:.2f} cm "
        f"(decalibration: {summary.translation_before:.2f} cm)",
        f"Mean rotation error: {summary.rotation_after:.3f}° "
        f"(decalibration: {summary.rotation_before:.3f}°)",
        *(f"{name}: {value}" for name, value in extra.items()),
    ]


def _explanations(rows: Sequence[ResultRow]) -> list[str]:
    """What the reader needs to know about this table, and no more."""
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
    return _number(value, 2 if row.unit == "cm" else 3)


def _number(value: float, digits: int) -> str:
    if math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{value:.{digits}f}"


def _md_line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _csv(rows: Sequence[ResultRow]) -> str:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    # repr is the shortest text that reads back as the same float.
    writer.writerows(
        [repr(value) if isinstance(value, float) else value for value in asdict(row).values()]
        for row in rows
    )
    return buffer.getvalue()


def _write(path: Path, text: str) -> None:
    """Whole or not at all: a reader never sees half a table."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
