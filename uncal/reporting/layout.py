"""Lay out small tables as Markdown and as aligned text, and write files whole."""

from __future__ import annotations

import json
import logging
import math
import secrets
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

log = logging.getLogger(__name__)

Grid: TypeAlias = list[list[str]]
"""Rows of cells, the first the header; the first column names the rows."""


def markdown_lines(grid: Sequence[Sequence[str]]) -> list[str]:
    """A grid as a Markdown table, numbers to the right.

    >>> markdown_lines([["", "X"], ["MAE", "1.0"]])
    ['|  | X |', '| :-- | --: |', '| MAE | 1.0 |']
    """
    if not grid:
        return []
    header, *body = grid
    rule = [":--"] + ["--:"] * (len(header) - 1)
    escaped = [[cell.replace("|", "\\|") for cell in line] for line in (header, rule, *body)]
    return ["| " + " | ".join(cells) + " |" for cells in escaped]


def aligned_lines(grid: Sequence[Sequence[str]], gaps: Collection[int] = ()) -> list[str]:
    """A grid as plain text, numbers to the right, all their columns equally wide.

    >>> aligned_lines([["", "X"], ["MAE", "1.0"]])
    ['       X', 'MAE  1.0']
    """
    first = max(len(line[0]) for line in grid)
    others = max(len(cell) for line in grid for cell in line[1:])
    rows = [[f"{line[0]:<{first}}", *(f"{cell:>{others}}" for cell in line[1:])] for line in grid]
    lines = [[*([""] if index in gaps else []), "  ".join(row)] for index, row in enumerate(rows)]
    return [line for pair in lines for line in pair]


def write_whole(path: Path, text: str) -> Path:
    """Write a file whole or not at all: a reader never sees half a table."""
    with replaced_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def read_json(path: Path, consequence: str) -> dict[str, object] | None:
    """A JSON object; None where there is none, with a warning if the file is damaged."""
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        log.warning("%s cannot be read (%s): %s", path, error, consequence)
        return None
    return content if isinstance(content, dict) else None


@contextmanager
def replaced_whole(path: Path) -> Iterator[Path]:
    """A file to write to instead; it takes the place of ``path`` when the block ends well.

    Jobs of a multirun write the same summary at the same time, on several machines even: each
    gets a file of its own, and the last to end stays.
    """
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def number(value: float | None, digits: int) -> str:
    """A number for a cell: "–" for none or NaN, "∞" for infinite.

    >>> number(1.25, 1), number(float("inf"), 1), number(None, 1)
    ('1.2', '∞', '–')
    """
    if value is None or math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{value:.{digits}f}"


def length(value: float | None, unit: str) -> str:
    """Tenths of a millimetre, thousandths of a degree.

    >>> length(1.234, "cm"), length(0.5, "°"), length(None, "cm")
    ('1.23', '0.500', '–')
    """
    return number(value, 2 if unit == "cm" else 3)
