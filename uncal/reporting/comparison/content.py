"""Everything that a comparison says, in the order in which it is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from uncal import __version__
from uncal.reporting.comparison.coverage_tables import conditional_table, curve_table, joint_table
from uncal.reporting.comparison.error_tables import control_table, point_errors
from uncal.reporting.comparison.gathering import Gathered, Multirun
from uncal.reporting.comparison.interval_tables import table_1, table_2
from uncal.reporting.comparison.overview import NOTICE_TITLE, compared_table, notice
from uncal.reporting.comparison.pictures import Picture, multirun_pictures, run_pictures
from uncal.reporting.comparison.run_folder import Run
from uncal.reporting.comparison.summary_tables import multirun_made_by, summary_tables
from uncal.reporting.comparison.table import Table
from uncal.reporting.published import PublishedPaper


@dataclass(frozen=True)
class Part:
    """A chapter.

    Attributes:
        title: its heading.
        tables: to show first.
        pictures: to show after them.
    """

    title: str
    tables: Sequence[Table]
    pictures: Sequence[Picture] = ()


@dataclass(frozen=True)
class Content:
    """A whole comparison.

    Attributes:
        title: heading of the page.
        made: the command and the time of the comparison itself.
        notice_title: what must not be overlooked.
        notice: the same in sentences.
        parts: its chapters.
    """

    title: str
    made: str
    notice_title: str
    notice: Sequence[str]
    parts: Sequence[Part]


def compare(paper: PublishedPaper, gathered: Gathered, command: str) -> Content:
    """Put runs beside the paper.

    Args:
        paper: with the published numbers.
        gathered: the runs.
        command: that asked for the comparison.

    Raises:
        UncalError: a figure in a run's folder cannot be read.
    """
    runs = gathered.runs
    beyond = (
        joint_table(runs),
        control_table(runs),
        conditional_table(runs),
        curve_table(runs),
    )
    beside = [
        table_1(paper, runs),
        table_2(paper, gathered.all_runs),
        point_errors(paper, runs),
    ]
    parts = [
        Part("What stands beside what", [compared_table(paper, gathered)]),
        Part("Beside the paper", beside),
    ]
    if any(beyond):
        parts.append(Part("What the paper does not report", [each for each in beyond if each]))
    parts += [_figures(run) for run in gathered.single]
    parts += [_multirun(multirun) for multirun in gathered.multiruns]
    now = datetime.now().astimezone().isoformat(sep=" ", timespec="minutes")
    return Content(
        title=f"Runs on {', '.join(gathered.labels)} beside the paper",
        made=f"{command} · uncal {__version__} · {now}",
        notice_title=NOTICE_TITLE,
        notice=notice(gathered),
        parts=[part for part in parts if part.tables or part.pictures],
    )


def _figures(run: Run) -> Part:
    return Part(f"Figures of {run.name}: {run.label}; {run.record.method}", [], run_pictures(run))


def _multirun(multirun: Multirun) -> Part:
    labels = ", ".join(dict.fromkeys(run.label for run in multirun.runs))
    return Part(
        f"{multirun.name}, a multirun: {labels}",
        summary_tables(multirun),
        multirun_pictures(multirun, multirun_made_by(multirun)),
    )
