"""A comparison for programs: one number per line, runs' unrounded, the paper's as printed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pandas as pd

from uncal.geometry import DOF_NAMES
from uncal.reporting.frames import CONTROL, JOINT, RESULTS, csv_text
from uncal.reporting.published.paper import PublishedPaper
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

_WHOLE = ("translation_after", "rotation_after")


def tidy_csv(paper: PublishedPaper, runs: Sequence[Run]) -> str:
    """The whole comparison as CSV."""
    published = paper.values.rename(columns={"text": "value"})
    source = "paper, Table " + published["table"].astype(str)
    lines = published.assign(source=source)[list(COLUMNS)].to_numpy().tolist()
    for name, texts in paper.errors.items():
        about = (f"paper, section 4.4: {name}", "real KITTI", "", "all")
        for unit, metric, text in zip(("cm", "°"), _WHOLE, texts, strict=True):
            lines.append((*about, unit, "", metric, text))
    for run in runs:
        lines += [(str(run.folder), run.label, run.method, *line) for line in _of_run(run)]
    return csv_text(pd.DataFrame(lines, columns=list(COLUMNS)).astype(object))


def _of_run(run: Run) -> Iterator[tuple[object, ...]]:
    for schema, units in _UNITS.items():
        if schema not in run.tables:
            continue
        rows = run.tables[schema].to_dict("records")
        for row in rows:
            for metric, unit in units.items():
                dof, unit = row.get("dof", "all"), unit or row["unit"]
                yield dof, unit, row.get("level", ""), metric, row[metric]
        if schema is RESULTS:
            for row in rows[: len(DOF_NAMES)]:
                for metric in ("mae_before", "mae_after"):
                    yield row["dof"], row["unit"], "", metric, row[metric]
    if run.summary is not None:
        for unit, metric in zip(("cm", "°"), _WHOLE, strict=True):
            yield "all", unit, "", metric, getattr(run.summary, metric)
