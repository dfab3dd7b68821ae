"""The comparison in a few lines, for the terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from uncal.geometry import DOF_NAMES
from uncal.reporting.comparison.gathering import Gathered
from uncal.reporting.comparison.overview import NOTICE_TITLE
from uncal.reporting.comparison.run_folder import Run
from uncal.reporting.comparison.table import length
from uncal.reporting.layout import aligned_lines
from uncal.reporting.published import PublishedPaper
from uncal.reporting.tables import TERMINAL_WIDTH


def terminal_text(paper: PublishedPaper, gathered: Gathered) -> str:
    """One line per source: coverage and mean width at the level that both have.

    Args:
        paper: with the published numbers.
        gathered: the runs.
    """
    level = _common_level(paper, gathered.all_runs)
    rows = []
    for table in (1, 2):
        cells = [each for each in paper.table(table) if each.level == level]
        for data in dict.fromkeys(each.data for each in cells):
            own = {(each.metric, each.dof): each.value for each in cells if each.data == data}
            widths = [own[("mpiw", dof)] for dof in DOF_NAMES] if table == 1 else []
            rows.append(
                _line(
                    f"Paper, Table {table}, {data}",
                    [own[("picp", dof)] for dof in DOF_NAMES],
                    widths,
                )
            )
    for run in gathered.runs:
        found = [row for row in run.rows if row.level == level]
        rows.append(_line(run.source, [row.picp for row in found], [row.mpiw for row in found]))
    asked = f"{level:g}%"
    header = ["", f"{asked} PICP", f"{asked} MPIW X-Z", "Roll-Yaw"]
    lines = [textwrap.fill(f"{NOTICE_TITLE}.", TERMINAL_WIDTH), ""]
    lines += aligned_lines([header, *rows])
    for multirun in gathered.multiruns:
        count = f"{len(multirun.runs)} of {len(multirun.jobs)} jobs have results"
        where = "" if multirun.shown else "; shown by its summary"
        lines.append(f"{multirun.name}: {count}{where}")
    return "\n".join(lines)


def _common_level(paper: PublishedPaper, runs: Sequence[Run]) -> float:
    """The first of the paper's levels that every run has, else its first."""
    levels = list(dict.fromkeys(each.level for each in paper.table(1)))
    return next(
        (level for level in levels if all(any(r.level == level for r in run.rows) for run in runs)),
        levels[0],
    )


def _line(name: str, coverages: Sequence[float], widths: Sequence[float]) -> list[str]:
    picp = f"{min(coverages):.1f}-{max(coverages):.1f}" if coverages else "–"
    if not widths:
        return [textwrap.shorten(name, 70, placeholder=" …"), picp, "–", "–"]
    translation, rotation = sum(widths[:3]) / 3, sum(widths[3:]) / 3
    return [
        textwrap.shorten(name, 70, placeholder=" …"),
        picp,
        f"{length(translation, 'cm')} cm",
        f"{length(rotation, '°')}°",
    ]
