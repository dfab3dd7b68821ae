"""The paper's Table 1 and Table 2 with rows of runs beside the paper's."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from uncal.geometry import DOF_NAMES
from uncal.reporting.comparison.run_folder import Run
from uncal.reporting.comparison.table import DOF_HEADINGS, Table, length, made_by
from uncal.reporting.predictions import BAND_CONFIDENCE
from uncal.reporting.published import PublishedPaper, PublishedValue
from uncal.reporting.rows import ResultRow

METRICS = {"picp": "PICP (%)", "mpiw": "MPIW", "is": "IS"}


def table_1(paper: PublishedPaper, runs: Sequence[Run]) -> Table:
    """Coverage, width and interval score per DoF and level.

    Args:
        paper: with the published rows.
        runs: to stand beside them.
    """
    published = paper.table(1)
    levels = _levels(published, runs)
    rows = []
    for data in dict.fromkeys(each.data for each in published):
        own = {(v.metric, v.dof, v.level): v.text for v in published if v.data == data}
        source = f"Paper, Table 1: {data}; {published[0].method}"
        for metric, name in METRICS.items():
            cells = [own.get((metric, dof, level), "–") for dof in DOF_NAMES for level in levels]
            rows.append([source, name, *cells])
    count = len(rows)
    for run in runs:
        found = {(row.dof, row.level): row for row in run.rows}
        for metric, name in METRICS.items():
            cells = [
                _cell(run, found.get((dof, level)), metric) for dof in DOF_NAMES for level in levels
            ]
            rows.append([run.source, name, *cells])
    return Table(
        "Prediction intervals per DoF (the paper's Table 1)",
        ["source", "metric", *(f"{level:g}%" for _ in DOF_NAMES for level in levels)],
        rows,
        published=count,
        groups=["", "", *(heading for heading in DOF_HEADINGS for _ in levels)],
        notes=[
            "PICP: coverage found. MPIW: mean width of the intervals. IS: mean interval score. "
            "Widths and scores in cm or °, as printed in the paper, and of runs to 0.01 cm and "
            "0.001°.",
            f"Paper's rows: {paper.source('Table 1')}.",
            *paper.doubts,
            *_band_notes(runs),
        ],
        made_by=made_by(runs),
    )


def table_2(paper: PublishedPaper, runs: Sequence[Run]) -> Table:
    """Coverage of MC dropout alone, with normal quantiles.

    Args:
        paper: with the published rows.
        runs: all; those with another interval method are left out.
    """
    published, alone = paper.table(2), [run for run in runs if run.record.alone]
    rows = []
    for level in dict.fromkeys(each.level for each in published):
        cells = [each.text for each in published if each.level == level]
        source = f"Paper, Table 2: {published[0].data}; {published[0].method}"
        rows.append([source, f"{level:g}%", *cells])
    count = len(rows)
    for run in alone:
        for level in dict.fromkeys(row.level for row in run.rows):
            cells = [f"{row.picp:.1f}" for row in run.rows if row.level == level]
            rows.append([run.source, f"{level:g}%", *cells])
    without = [
        "None of the runs has these intervals. python -m uncal.evaluate ckpt=…/best.ckpt "
        "interval=gaussian makes them from weights that are trained already."
    ]
    return Table(
        "MC dropout alone: coverage found, PICP in % (the paper's Table 2)",
        ["source", "asked for", *DOF_NAMES],
        rows,
        published=count,
        notes=[
            "Normal quantiles of σ, not calibrated: nothing is promised here. Widths and scores of "
            "the same runs: Table 1 above, or, of the jobs of a large multirun, report.csv.",
            f"Paper's rows: {paper.source('Table 2')}.",
            *([] if alone else without),
        ],
        made_by=made_by(alone),
    )


def _levels(published: Iterable[PublishedValue], runs: Iterable[Run]) -> list[float]:
    return sorted({v.level for v in published} | {row.level for run in runs for row in run.rows})


def _cell(run: Run, row: ResultRow | None, metric: str) -> str:
    if row is None:
        return "–"
    if metric == "picp":
        mark = "*" if run.record.promise == "exact" and not row.in_band else ""
        return f"{row.picp:.1f}{mark}"
    return length(row.mpiw if metric == "mpiw" else row.interval_score, row.unit)


def _band_notes(runs: Sequence[Run]) -> list[str]:
    """What exact theory allows, and why a width is infinite."""
    exact = [run for run in runs if run.record.promise == "exact"]
    allowed: dict[str, list[str]] = {}
    for run in exact:
        first = run.rows[0]
        bands = ", ".join(
            f"{row.coverage_low:.1f}-{row.coverage_high:.1f} at {row.level:g}%"
            for row in run.rows
            if row.dof == DOF_NAMES[0]
        )
        text = (
            f"coverage allowed with {first.n_test} test and {first.n_calibration} uncertainty "
            f"calibration frames: {bands}."
        )
        allowed.setdefault(text, []).append(run.name)
    notes = [f"{', '.join(names)}, {text}" for text, names in allowed.items()]
    if exact:
        notes.append(
            f"Allowed: what exact theory (Beta-Binomial law) gives one DoF with probability "
            f"{100 * BAND_CONFIDENCE:g}%, if the frames of both sets are exchangeable; frames of "
            "one rig or drive are not. The paper does not say how many frames it tested on."
        )
    if any(run.record.promise == "exact" and not row.in_band for run in runs for row in run.rows):
        notes.append("*: outside what is allowed.")
    if any(math.isinf(row.mpiw) for run in runs for row in run.rows):
        notes.append("∞: the uncertainty calibration set is too small for that level.")
    return notes
