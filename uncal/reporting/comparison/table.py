"""What a table of the comparison is made of, before it becomes HTML or Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.reporting.comparison.run_folder import Run
from uncal.reporting.layout import Section, number

DOF_HEADINGS: tuple[str, ...] = tuple(
    f"{dof} ({unit})" for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)
)


@dataclass(frozen=True)
class Table:
    """A table with what belongs under it.

    Attributes:
        title: what it shows.
        header: one cell per column.
        rows: the body; the first cell names the source, and equal neighbours are one source.
        published: how many of the first rows are the paper's.
        texts: how many of the first columns are words and not numbers.
        groups: a heading above each column, "" where there is none; none at all if empty.
        notes: sentences to print below.
        made_by: the commands that made the rows of runs.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    published: int = 0
    texts: int = 2
    groups: Sequence[str] = ()
    notes: Sequence[str] = ()
    made_by: Sequence[str] = ()

    def flat_header(self) -> list[str]:
        """The header in one line, for formats whose tables have no more."""
        groups = self.groups or [""] * len(self.header)
        return [f"{a} {b}".strip() for a, b in zip(groups, self.header, strict=True)]


def made_by(runs: Iterable[Run]) -> list[str]:
    """A line per run.

    Args:
        runs: whose numbers a table shows.
    """
    return [run.made_by for run in runs]


def length(value: float | None, unit: str) -> str:
    """Tenths of a millimetre, thousandths of a degree.

    Args:
        value: the number, or None.
        unit: "cm" or "°".

    >>> length(1.234, "cm"), length(0.5, "°"), length(None, "cm")
    ('1.23', '0.500', '–')
    """
    return number(value, 2 if unit == "cm" else 3)


def lacking(runs: Sequence[Run], having: Sequence[Run], file: str) -> list[str]:
    """A sentence on the runs that a table must leave out.

    Args:
        runs: all.
        having: those that it shows.
        file: what the others lack.
    """
    without = [run.name for run in runs if run not in having]
    return [f"Not shown, since without {file}: {', '.join(without)}."] if without else []


def section_rows(runs: Sequence[Run], sections: Sequence[Section]) -> list[list[str]]:
    """The rows of each run's small table, with the run before them.

    Args:
        runs: whose.
        sections: one per run.
    """
    both = zip(runs, sections, strict=True)
    return [[run.source, *line] for run, section in both for line in section.grid[1:]]


def section_notes(runs: Sequence[Run], sections: Sequence[Section]) -> list[str]:
    """The sentences below each run's small table, each once.

    Args:
        runs: whose.
        sections: one per run.
    """
    said: dict[str, list[str]] = {}
    for run, section in zip(runs, sections, strict=True):
        for note in section.notes:
            said.setdefault(note, []).append(run.name)
    return by_name(said, len(runs))


def by_name(said: Mapping[str, Sequence[str]], count: int) -> list[str]:
    """Sentences with the names of the runs that they are about, unless about all.

    Args:
        said: sentence → names.
        count: of all runs.

    >>> by_name({"Few frames.": ["Run 1"], "In cm.": ["Run 1", "Run 2"]}, 2)
    ['In cm.', 'Run 1: Few frames.']
    """
    everyone = [text for text, names in said.items() if len(names) == count]
    others = [f"{', '.join(n)}: {text}" for text, n in said.items() if len(n) < count]
    return everyone + others
