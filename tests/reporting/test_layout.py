from __future__ import annotations

from pathlib import Path

import pytest

from uncal.reporting.layout import (
    aligned_lines,
    markdown_lines,
    number,
    replaced_whole,
    write_whole,
)


def test_columns_line_up_and_gaps_are_where_asked() -> None:
    grid = [["", "X", "Yaw"], ["long name", "1.0", "22.5"], ["b", "–", "∞"]]
    lines = aligned_lines(grid, gaps=[2])
    assert lines[2] == ""
    assert len({len(line) for line in lines if line}) == 1
    assert lines[3] == "b             –     ∞"


def test_a_bar_in_a_cell_does_not_end_it() -> None:
    assert markdown_lines([["", "X"], ["mean |error|", "1"]])[2] == r"| mean \|error\| | 1 |"


def test_numbers() -> None:
    assert [number(v, 1) for v in (None, float("nan"), float("inf"), 2.26)] == [
        "–",
        "–",
        "∞",
        "2.3",
    ]


def test_nothing_partial_is_left(tmp_path: Path) -> None:
    path = write_whole(tmp_path / "a.csv", "x\n")
    write_whole(path, "y\n")
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("a.csv", "y\n")]


def test_two_that_write_the_same_file_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with replaced_whole(path) as first, replaced_whole(path) as second:
        assert first != second
        first.write_text("first\n")
        second.write_text("second\n")
    assert path.read_text() == "first\n"  # it ended last
    assert list(tmp_path.iterdir()) == [path]


def test_what_breaks_off_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = write_whole(tmp_path / "a.csv", "x\n")
    with pytest.raises(FileNotFoundError):
        fill_halfway(path)
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("a.csv", "x\n")]


def fill_halfway(path: Path) -> None:
    with replaced_whole(path) as partial:
        partial.write_text("half")
        (path.parent / "other half").read_text()
