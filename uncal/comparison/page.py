"""A comparison as one HTML page, as Markdown, and on the terminal."""

from __future__ import annotations

import base64
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby

from uncal import __version__
from uncal.comparison.gathering import Gathered, shown
from uncal.comparison.pictures import Picture, pictures
from uncal.comparison.tables import (
    compared_table,
    multirun_tables,
    point_errors,
    table_1,
    table_2,
    tables_beyond_the_paper,
)
from uncal.reporting.layout import aligned_lines, length
from uncal.reporting.published.paper import PublishedPaper
from uncal.reporting.report import TERMINAL_WIDTH
from uncal.reporting.sections import Section

NOTICE_TITLE = (
    "The paper measured on real KITTI and DSEC, each run on its own data: not comparable as "
    "accuracy"
)


@dataclass(frozen=True)
class Part:
    """A chapter: tables first, figures after them."""

    title: str
    tables: Sequence[Section]
    pictures: Sequence[Picture] = ()


@dataclass(frozen=True)
class Content:
    """A whole comparison.

    Attributes:
        title: heading of the page.
        origin: the command and the time of the comparison itself.
        notice: what must not be overlooked, below :data:`NOTICE_TITLE`.
        parts: its chapters.
    """

    title: str
    origin: str
    notice: Sequence[str]
    parts: Sequence[Part]


def compare(paper: PublishedPaper, gathered: Gathered, command: str) -> Content:
    """Put runs next to the paper.

    Raises:
        UncalError: a figure in a run's folder cannot be read.
    """
    runs = gathered.runs
    parts = [
        Part("What is compared", [compared_table(paper, gathered)]),
        Part(
            "Next to the paper",
            [table_1(paper, runs), table_2(paper, gathered.all_runs), point_errors(paper, runs)],
        ),
        Part("What the paper does not report", tables_beyond_the_paper(runs)),
    ]
    parts += [
        Part(f"Figures of {run.name}: {run.label}; {run.method}", [], pictures(run))
        for run in gathered.single
    ]
    for multirun in gathered.multiruns:
        title = f"{multirun.name}, a multirun: {multirun.label}"
        parts.append(Part(title, multirun_tables(multirun), pictures(multirun)))
    labels = dict.fromkeys(run.label for run in gathered.all_runs)
    now = datetime.now().astimezone().isoformat(sep=" ", timespec="minutes")
    return Content(
        title=f"Runs on {', '.join(labels)} next to the paper",
        origin=f"{command} · uncal {__version__} · {now}",
        notice=_notice(gathered),
        parts=[part for part in parts if part.tables or part.pictures],
    )


def html_page(content: Content) -> str:
    """The page; every text in it is escaped, and it needs neither network nor other files."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uncal.comparison", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"spans": _spans, "sources": _sources, "base64": _base64}
    template = environment.get_template("report.html.j2")
    return template.render(content=content, notice_title=NOTICE_TITLE)


def markdown_text(content: Content) -> str:
    """The same words and tables as the page; figures are named only."""
    paragraphs = [f"# {content.title}", f"    {content.origin}", f"**{NOTICE_TITLE}.**"]
    paragraphs += content.notice
    for part in content.parts:
        paragraphs += [f"## {part.title}"]
        for table in part.tables:
            paragraphs += table.markdown("###")
        if part.pictures:
            named = (f"- {each.title}. {each.caption}".rstrip() for each in part.pictures)
            paragraphs += ["Figures, in report.html:", "\n".join(named)]
    return "\n\n".join(paragraphs) + "\n"


def terminal_text(paper: PublishedPaper, gathered: Gathered) -> str:
    """One line per source: coverage and mean width at the first of the paper's levels all have."""
    levels = paper.table(1)["level"].unique().tolist()
    common = [v for v in levels if all((r.per_dof["level"] == v).any() for r in gathered.all_runs)]
    level = (common or levels)[0]
    rows = []
    at_level = paper.values[paper.values["level"] == level]
    for (table, data), own in at_level.groupby(["table", "data"], sort=False):
        coverage, widths = (
            own["text"][own["metric"] == metric].astype(float).tolist()
            for metric in ("picp", "mpiw")
        )
        rows.append(_terminal_row(f"Paper, Table {table}, {data}", coverage, widths))
    for run in gathered.runs:
        at = run.per_dof[run.per_dof["level"] == level]
        rows.append(_terminal_row(run.source, at["picp"].tolist(), at["mpiw"].tolist()))
    header = ["", f"{level:g}% PICP", f"{level:g}% MPIW X-Z", "Roll-Yaw"]
    lines = [textwrap.fill(f"{NOTICE_TITLE}.", TERMINAL_WIDTH), ""]
    lines += aligned_lines([header, *rows])
    for multirun in gathered.multiruns:
        count = f"{len(multirun.runs)} of {len(multirun.found)} jobs have results"
        lines.append(f"{multirun.name}: {count}{'' if shown(multirun) else '; see its summary'}")
    return "\n".join(lines)


def _notice(gathered: Gathered) -> list[str]:
    """What a reader must know before any number, one paragraph each."""
    runs = [f"{run.name}: {run.label}" for run in gathered.single]
    runs += [f"{each.name} (a multirun): {each.label}" for each in gathered.multiruns]
    return [
        "The paper's numbers: real KITTI and real DSEC recordings, its authors' networks, weights "
        "and splits.",
        f"The runs' numbers: {'; '.join(runs)}; with the networks named below.",
        "Errors, widths and interval scores from different data and networks cannot be ranked. "
        "What can be compared is whether empirical coverage reaches the nominal level, which DoF "
        "are harder than others, and what happens without conformal prediction.",
    ]


def _spans(names: Sequence[str]) -> list[tuple[str, int]]:
    return [(name, len(list(same))) for name, same in groupby(names)]


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _sources(table: Section) -> list[tuple[bool, list[Sequence[str]]]]:
    """Rows of one source together, and whether it is the paper; a multirun's rows are alone."""
    parts: list[tuple[bool, list[Sequence[str]]]] = []
    for number, row in enumerate(table.grid[1:]):
        if parts and table.texts > 1 and parts[-1][1][0][0] == row[0]:
            parts[-1][1].append(row)
        else:
            parts.append((number < table.published, [row]))
    return parts


def _terminal_row(name: str, coverage: Sequence[float], widths: Sequence[float]) -> list[str]:
    name = textwrap.shorten(name, 70, placeholder=" …")
    picp = f"{min(coverage):.1f}-{max(coverage):.1f}" if coverage else "–"
    if not widths:
        return [name, picp, "–", "–"]
    translation, rotation = length(sum(widths[:3]) / 3, "cm"), length(sum(widths[3:]) / 3, "°")
    return [name, picp, f"{translation} cm", f"{rotation}°"]
