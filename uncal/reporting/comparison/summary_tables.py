"""A multirun's summary.md taken apart into tables."""

from __future__ import annotations

import re

from uncal.reporting.comparison.gathering import Multirun
from uncal.reporting.comparison.record import UNKNOWN
from uncal.reporting.comparison.table import Table

_CELLS = re.compile(r"(?<!\\)\|")
_FIGURES = "Figures"
"""A section that only points to files; the page has the figures themselves."""


def multirun_made_by(multirun: Multirun) -> str:
    """The command that made a multirun, its seeds, commits and data.

    Args:
        multirun: read.
    """
    command = next(
        (line.strip() for line in _summary(multirun) if line.startswith("    ")),
        f"command {UNKNOWN} (no summary.md)",
    )
    seeds = ", ".join(dict.fromkeys(run.record.seed or UNKNOWN for run in multirun.runs))
    commits = ", ".join(dict.fromkeys(run.record.commit or UNKNOWN for run in multirun.runs))
    labels = ", ".join(dict.fromkeys(run.label for run in multirun.runs))
    return f"{multirun.name}: {command} · seed {seeds} · commit {commits} · {labels}"


def summary_tables(multirun: Multirun) -> list[Table]:
    """The tables of summary.md with the sentences below them; none without the file.

    Args:
        multirun: read.
    """
    made_by = [multirun_made_by(multirun)]
    tables: list[Table] = []
    title, grid, notes = "Jobs", list[list[str]](), list[str]()

    def keep() -> None:
        if (grid or notes) and title != _FIGURES:
            header, rows = (grid[0], grid[1:]) if grid else ([], [])
            tables.append(Table(title, header, rows, texts=1, notes=notes, made_by=made_by))

    for line in _summary(multirun):
        if line.startswith("## "):
            keep()
            title, grid, notes = _plain(line[3:]), [], []
        elif line.startswith("|"):
            cells = [_plain(cell.replace("\\|", "|").strip()) for cell in _CELLS.split(line)[1:-1]]
            if not all(re.fullmatch(r":?-+:?", cell) for cell in cells):
                grid.append(cells)
        elif line.strip() and not line.startswith(("# ", "    ", "![")):
            notes.append(_plain(line.removeprefix("- ")))
    keep()
    return tables


def _summary(multirun: Multirun) -> list[str]:
    path = multirun.folder / "summary.md"
    if not path.is_file():
        return []
    return path.read_text(encoding="utf-8", errors="replace").splitlines()


def _plain(text: str) -> str:
    return text.replace("`", "").replace("**", "")
