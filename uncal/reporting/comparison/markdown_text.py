"""A comparison as Markdown, for where a page with pictures does not fit."""

from __future__ import annotations

from uncal.reporting.comparison.content import Content, Part
from uncal.reporting.comparison.table import Table
from uncal.reporting.layout import markdown_lines


def markdown_text(content: Content) -> str:
    """The same words and tables as the page; figures are named only.

    Args:
        content: what it says.
    """
    lines = [f"# {content.title}", "", f"    {content.made}", "", f"**{content.notice_title}.**"]
    for sentence in content.notice:
        lines += ["", sentence]
    for part in content.parts:
        lines += _part(part)
    return "\n".join(lines) + "\n"


def _part(part: Part) -> list[str]:
    lines = ["", f"## {part.title}"]
    for table in part.tables:
        lines += ["", f"### {table.title}", ""]
        lines += _grid(table)
        lines += [f"- {note}" for note in table.notes]
        lines += ["", *(f"    {made}" for made in table.made_by)]
    if part.pictures:
        lines += ["", "Figures, in report.html:", ""]
        lines += [f"- {picture.title}. {picture.caption}".rstrip() for picture in part.pictures]
    return lines


def _grid(table: Table) -> list[str]:
    if not table.header:
        return []
    return [*markdown_lines([table.flat_header(), *table.rows]), ""]
