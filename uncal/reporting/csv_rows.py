"""Read the csv files of a run folder back into the rows that were written."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import TypeVar, cast

from uncal.errors import UncalError
from uncal.geometry import DOF_NAMES
from uncal.reporting.conditional_rows import ConditionalRow
from uncal.reporting.control_rows import ControlRow
from uncal.reporting.curve_rows import CurveRow
from uncal.reporting.joint_rows import JointRow
from uncal.reporting.rows import ResultRow

HEADER_NAMES = {"interval_score": "is"}
"""Columns that are not called like the attribute: ``is`` is a word of Python's."""


Row = TypeVar("Row", ResultRow, JointRow, ConditionalRow, CurveRow, ControlRow)


def read_rows(path: Path, kind: type[Row]) -> tuple[Row, ...]:
    """Read a csv whose columns are a class's attributes; columns beyond them are passed over.

    Args:
        path: the csv.
        kind: of its rows; an attribute that may be None may lack its column.

    Raises:
        UncalError: the file cannot be read, a column is missing, a value is missing or not of its
            kind, there are no rows, or a level lacks one of the six DoF.
    """
    wanted = fields(kind)
    build = cast(Callable[..., object], kind)
    try:
        text = path.read_text(encoding="utf-8")
        table = csv.DictReader(io.StringIO(text, newline=""), strict=True)
        header = table.fieldnames or ()
        missing = [
            name
            for field in wanted
            if (name := _name(field)) not in header and "None" not in str(field.type)
        ]
        if missing:
            raise ValueError(f"no column {', '.join(missing)}")
        rows = []
        for cells in table:
            values = {field.name: _value(cells, field, table.line_num) for field in wanted}
            rows.append(cast(Row, build(**values)))
        if not text.endswith("\n"):
            raise ValueError("the last line is cut off")
        _check_complete(rows)
    except (OSError, ValueError, csv.Error) as error:
        raise UncalError(
            f"{path} is damaged: {error}. Expected what uncal writes into a run's folder: a line "
            f"per row with {', '.join(map(_name, wanted))}. Run the test again "
            "(python -m uncal.evaluate ckpt=…/best.ckpt) and give that run's folder."
        ) from error
    return tuple(rows)


def _name(field: Field[object]) -> str:
    return HEADER_NAMES.get(field.name, field.name)


def _truth(text: str) -> bool:
    return {"True": True, "False": False}[text]


_READERS: Mapping[str, Callable[[str], object]] = {
    "str": str,
    "float": float,
    "int": int,
    "bool": _truth,
}


def _value(cells: Mapping[str, str | None], field: Field[object], line: int) -> object:
    """One cell as its attribute's type, which is text: annotations are not evaluated."""
    name, (kind, _, optional) = _name(field), str(field.type).partition(" | ")
    text = cells.get(name)
    if not text:
        if optional:
            return None
        raise ValueError(f"line {line} has no {name}")
    try:
        return _READERS[kind](text)
    except (ValueError, KeyError):
        raise ValueError(f"line {line}: {name} is {text!r}, not a {kind}") from None


def _check_complete(rows: Sequence[object]) -> None:
    """Every level of the paper's table has its six DoF."""
    if not rows:
        raise ValueError("it has no rows")
    results = [row for row in rows if isinstance(row, ResultRow | CurveRow)]
    for level in dict.fromkeys(row.level for row in results):
        found = tuple(row.dof for row in results if row.level == level)
        if found != DOF_NAMES:
            raise ValueError(
                f"{level:g}% has rows for {', '.join(found)}, not for {', '.join(DOF_NAMES)}"
            )
