"""A comparison as one HTML page, as Markdown, and on the terminal."""

from __future__ import annotations

import base64
import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image, UnidentifiedImageError

from uncal import __version__
from uncal.comparison.compared import compared_table
from uncal.comparison.gathering import Gathered, shown
from uncal.comparison.tables import (
    multirun_tables,
    point_errors,
    table_1,
    table_2,
    tables_beyond_the_paper,
)
from uncal.errors import UncalError
from uncal.multirun.folder import Multirun
from uncal.reporting.layout import aligned_lines, length
from uncal.reporting.published.paper import PublishedPaper
from uncal.reporting.report import TERMINAL_WIDTH
from uncal.reporting.run import Run
from uncal.reporting.sections import Section

if TYPE_CHECKING:
    from uncal.reporting.figures.style import NamedFigure

NOTICE_TITLE = (
    "The paper measured on real KITTI and DSEC, each run on its own data: not comparable as "
    "accuracy"
)

FOLDER = "figures"


@dataclass(frozen=True)
class Picture:
    """A figure as it stands on a page."""

    title: str
    caption: str  # how to read it; may be empty
    png: bytes
    inches: float  # its width in a paper
    origin: str  # the command of the run that it shows


def pictures(source: Run | Multirun) -> list[Picture]:
    """The figures that lie in a run's or multirun's folder, or else those that its tables allow.

    Raises:
        UncalError: a figure's file cannot be read.
    """
    if files := sorted((source.folder / FOLDER).glob("*.png")):
        return [_stored(path, source.origin) for path in files]
    # Matplotlib and seaborn take seconds to import, and most folders have their figures.
    from uncal.multirun.figures import sweep_figures
    from uncal.reporting.figures.run_figures import run_figures
    from uncal.reporting.figures.style import paper_style

    with paper_style():
        if isinstance(source, Run):
            figures = run_figures(source)
        else:
            figures = [] if source.frame is None else sweep_figures(source.frame)
        return [_drawn(figure, source.origin) for figure in figures]


def _stored(path: Path, origin: str) -> Picture:
    """A file with its title and caption, which :func:`style.save` keeps in it."""
    data = path.read_bytes()
    try:
        with Image.open(io.BytesIO(data)) as image:
            image.load()
            texts = {key: v for key, v in image.info.items() if isinstance(v, str)}
            dpi, width = image.info.get("dpi", (200, 200))[0], image.width
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise UncalError(
            f"{path} is no readable PNG ({error}). Delete {path.parent}: the figures are then "
            "drawn anew from the run's tables."
        ) from error
    title = texts.get("Title") or path.stem.replace("_", " ")
    return Picture(title, texts.get("Description", ""), data, width / dpi, origin)


def _drawn(figure: NamedFigure, origin: str) -> Picture:
    from uncal.reporting.figures.style import PNG_DPI

    buffer = io.BytesIO()
    figure.figure.savefig(buffer, format="png", dpi=PNG_DPI)
    inches = float(figure.figure.get_size_inches()[0])
    return Picture(figure.title, figure.caption, buffer.getvalue(), inches, origin)


@dataclass(frozen=True)
class Part:
    """A chapter: tables first, figures after them."""

    title: str
    tables: Sequence[Section]
    pictures: Sequence[Picture] = ()


@dataclass(frozen=True)
class Content:
    """A whole comparison."""

    title: str
    origin: str  # the command and the time of the comparison itself
    notice: Sequence[str]  # what must not be overlooked, below NOTICE_TITLE
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
