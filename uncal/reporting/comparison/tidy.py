"""A comparison for programs: one number per line, runs' unrounded, the paper's as printed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from uncal.geometry import DOF_NAMES
from uncal.reporting.comparison.run_folder import Run
from uncal.reporting.layout import csv_text
from uncal.reporting.published import PublishedPaper

COLUMNS = ("source", "data", "method", "dof", "unit", "level", "metric", "value")
"""``source`` is "paper, Table 1" or a run's folder; ``level`` is empty where there is none, ``dof``
"all" for what concerns the whole pose; ``unit`` is that of ``value``."""

_RESULTS = {
    "picp": "%",
    "mpiw": "",
    "interval_score": "",
    "coverage_low": "%",
    "coverage_high": "%",
}
_ERRORS = ("mae_before", "mae_after")
_JOINT = {"together": "%", "joint": "%", "bonferroni": "%", "bonferroni_size": "1"}
_CONTROL = {
    "mae_single": "",
    "mae_blind": "",
    "contribution": "%",
    "contribution_low": "%",
    "contribution_high": "%",
}
_WHOLE = {"translation_after": "cm", "rotation_after": "°"}

Line = tuple[str, str, str, str, str, float | None, str, object]


def tidy_csv(paper: PublishedPaper, runs: Sequence[Run]) -> str:
    """The whole comparison as csv.

    Args:
        paper: with the published numbers.
        runs: all of them.
    """
    lines: list[Line] = [
        (f"paper, Table {v.table}", v.data, v.method, v.dof, v.unit, v.level, v.metric, v.text)
        for v in paper.values
    ]
    for each in paper.errors:
        source = f"paper, section 4.4: {each.source}"
        for metric, unit, text in (
            ("translation_after", "cm", each.translation),
            ("rotation_after", "°", each.rotation),
        ):
            lines.append((source, "real KITTI", "", "all", unit, None, metric, text))
    for run in runs:
        lines += _of_run(run)
    return csv_text(COLUMNS, lines)


def _of_run(run: Run) -> Iterator[Line]:
    """An empty unit in the tables above means that of the DoF."""
    about = (str(run.folder), run.label, run.record.method)
    for row in run.rows:
        for name, unit in _RESULTS.items():
            metric = "is" if name == "interval_score" else name
            value = getattr(row, name)
            yield (*about, row.dof, unit or row.unit, row.level, metric, value)
    for row in run.rows[: len(DOF_NAMES)]:
        for name in _ERRORS:
            yield (*about, row.dof, row.unit, None, name, getattr(row, name))
    for joint in run.joint:
        for name, unit in _JOINT.items():
            if getattr(joint, name) is not None:
                yield (*about, "all", unit, joint.level, name, getattr(joint, name))
    for control in run.control:
        for name, unit in _CONTROL.items():
            yield (*about, control.dof, unit or control.unit, None, name, getattr(control, name))
    if run.whole is not None:
        for name, unit in _WHOLE.items():
            yield (*about, "all", unit, None, name, getattr(run.whole, name))
