"""A comparison for programs: one number per line, runs' unrounded, the paper's as printed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from uncal.geometry import DOF_NAMES
from uncal.reporting.frames import CONTROL, JOINT, RESULTS
from uncal.reporting.layout import csv_text
from uncal.reporting.published import PublishedPaper
from uncal.reporting.run import Run

COLUMNS = ("source", "data", "method", "dof", "unit", "level", "metric", "value")
"""``source`` is "paper, Table 1" or a run's folder; ``level`` is empty where there is none, ``dof``
"all" for what concerns the whole pose; ``unit`` is that of ``value``."""

_UNITS = {
    RESULTS: {"picp": "%", "mpiw": "", "is": "", "coverage_low": "%", "coverage_high": "%"},
    JOINT: {"together": "%", "joint": "%", "bonferroni": "%", "bonferroni_size": "1"},
    CONTROL: {
        **{"mae_single": "", "mae_blind": ""},
        **dict.fromkeys(("contribution", "contribution_low", "contribution_high"), "%"),
    },
}
"""Column → unit; an empty one is that of the DoF."""


def tidy_csv(paper: PublishedPaper, runs: Sequence[Run]) -> str:
    """The whole comparison as CSV."""
    lines: list[tuple[object, ...]] = [
        (f"paper, Table {v.table}", v.data, v.method, v.dof, v.unit, v.level, v.metric, v.text)
        for v in paper.values
    ]
    for each in paper.errors:
        paper_error = (f"paper, section 4.4: {each.source}", "real KITTI", "", "all")
        lines.append((*paper_error, "cm", None, "translation_after", each.translation))
        lines.append((*paper_error, "°", None, "rotation_after", each.rotation))
    for run in runs:
        about = (str(run.folder), run.label, run.method)
        lines += [(*about, *line) for line in _of_run(run)]
    return csv_text(COLUMNS, lines)


def _of_run(run: Run) -> Iterator[tuple[object, ...]]:
    for schema, units in _UNITS.items():
        if schema not in run.tables:
            continue
        rows = run.tables[schema].to_dict("records")
        for row in rows:
            for metric, unit in units.items():
                dof, unit = row.get("dof", "all"), unit or row["unit"]
                yield dof, unit, row.get("level"), metric, row[metric]
        if schema is RESULTS:
            for row in rows[: len(DOF_NAMES)]:
                for metric in ("mae_before", "mae_after"):
                    yield row["dof"], row["unit"], None, metric, row[metric]
    if run.summary is not None:
        yield "all", "cm", None, "translation_after", run.summary.translation_after
        yield "all", "°", None, "rotation_after", run.summary.rotation_after
