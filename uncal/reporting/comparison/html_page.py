"""A comparison as one HTML page that needs nothing else: no network, no script, no other file."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from itertools import groupby

from uncal.reporting.comparison.content import Content, Part
from uncal.reporting.comparison.html_style import STYLE
from uncal.reporting.comparison.pictures import Picture
from uncal.reporting.comparison.table import Table

_WIDE, _SHORT = 14, 24
"""Tables of more columns get smaller letters on paper; of fewer rows they are not torn apart."""


def html_page(content: Content) -> str:
    """The page; every text in it is escaped.

    Args:
        content: what it says.
    """
    parts = "\n".join(_part(f"part-{k}", part) for k, part in enumerate(content.parts, start=1))
    contents = " · ".join(
        f'<a href="#part-{k}">{escape(part.title)}</a>'
        for k, part in enumerate(content.parts, start=1)
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(content.title)}</title>
<style>{STYLE}</style>
</head>
<body>
<header>
<h1>{escape(content.title)}</h1>
<p class="made">{escape(content.made)}</p>
</header>
<aside class="notice" role="note">
<h2>{escape(content.notice_title)}</h2>
{_paragraphs(content.notice)}
</aside>
<nav>{contents}</nav>
<main>
{parts}
</main>
</body>
</html>
"""


def _part(anchor: str, part: Part) -> str:
    inside = [*(_table(table) for table in part.tables), *map(_picture, part.pictures)]
    return f'<section id="{anchor}">\n<h2>{escape(part.title)}</h2>\n{_lines(inside)}\n</section>'


def _table(table: Table) -> str:
    body = []
    start = 0
    for _, group in groupby(table.rows, key=lambda row: row[0]):
        rows = list(group)
        kind = "published" if start < table.published else "run"
        body.append(_source_rows(rows, table, kind))
        start += len(rows)
    lines = [f'<div class="scroll"><table class="{_shape(table)}">']
    if table.header:
        lines.append(f"<thead>\n{_header(table)}\n</thead>")
    grid = _lines([*lines, *body, "</table></div>"]) if body else ""
    return (
        f'<div class="block">\n<h3>{escape(table.title)}</h3>\n{grid}\n'
        f"{_list(table.notes, 'notes')}{_list(table.made_by, 'made')}</div>"
    )


def _header(table: Table) -> str:
    lines = []
    if table.groups:
        cells = []
        for name, columns in groupby(table.groups):
            span = len(list(columns))
            cells.append(f'<th colspan="{span}" scope="colgroup">{escape(name)}</th>')
        lines.append(f"<tr>{''.join(cells)}</tr>")
    cells = [
        f'<th scope="col" class="{_kind(table, j)}">{escape(name)}</th>'
        for j, name in enumerate(table.header)
    ]
    return _lines([*lines, f"<tr>{''.join(cells)}</tr>"])


def _source_rows(rows: Sequence[Sequence[str]], table: Table, kind: str) -> str:
    """The rows of one source under one heading of their own."""
    lines = []
    for number, row in enumerate(rows):
        first = f'<th scope="rowgroup" rowspan="{len(rows)}">{escape(row[0])}</th>'
        cells = [
            f'<td class="{_kind(table, j)}">{escape(cell)}</td>'
            for j, cell in enumerate(row[1:], start=1)
        ]
        lines.append(f"<tr>{first if number == 0 else ''}{''.join(cells)}</tr>")
    return f'<tbody class="{kind}">\n{_lines(lines)}\n</tbody>'


def _shape(table: Table) -> str:
    names = (
        ("sources", table.texts > 1),
        ("wide", len(table.header) > _WIDE),
        ("short", len(table.rows) < _SHORT),
    )
    return " ".join(name for name, holds in names if holds)


def _kind(table: Table, column: int) -> str:
    """Words to the left, numbers to the right, a line where a group of columns begins."""
    kind = "word" if column < table.texts else "number"
    begins = table.groups and column and table.groups[column] != table.groups[column - 1]
    return f"{kind} begins" if begins else kind


def _picture(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    caption = f"<p>{escape(picture.caption)}</p>" if picture.caption else ""
    return (
        f'<figure class="block">\n<h3>{escape(picture.title)}</h3>\n'
        f'<img style="width: {picture.inches:.2f}in" alt="{escape(picture.title)}" '
        f'src="data:image/png;base64,{data}">\n'
        f"<figcaption>{caption}{_list([picture.made_by], 'made')}</figcaption>\n</figure>"
    )


def _list(texts: Sequence[str], kind: str) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f'<ul class="{kind}">{items}</ul>\n' if items else ""


def _paragraphs(texts: Sequence[str]) -> str:
    return _lines([f"<p>{escape(text)}</p>" for text in texts])


def _lines(texts: Sequence[str]) -> str:
    return "\n".join(texts)
