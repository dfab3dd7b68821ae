from __future__ import annotations

import math
from pathlib import Path

import pandas as pd
import pytest

from uncal.errors import UncalError
from uncal.geometry import DOF_NAMES
from uncal.reporting.frames import CURVE, RESULTS, csv_text, read_csv

HEADER = ",".join(RESULTS.columns)
LINES = [
    f"{dof},{unit},90.0,91.5,20.45,inf,80.0,97.5,True,5.5,5.0,nan,200,296"
    for dof, unit in zip(
        ("X", "Y", "Z", "Roll", "Pitch", "Yaw"), ("cm",) * 3 + ("°",) * 3, strict=True
    )
]


def _file(tmp_path: Path, *lines: str, end: str = "\n") -> Path:
    path = tmp_path / "results.csv"
    path.write_text("\n".join([*lines]) + end, encoding="utf-8")
    return path


def test_rows_come_back_with_their_types(tmp_path: Path) -> None:
    rows = read_csv(_file(tmp_path, HEADER, *LINES), RESULTS)
    assert rows["dof"].tolist() == ["X", "Y", "Z", "Roll", "Pitch", "Yaw"]
    assert (rows["picp"][0], rows["in_band"][0], rows["n_test"][0]) == (91.5, True, 200)
    assert [str(rows[name].dtype) for name in ("picp", "in_band", "n_test")] == [
        *("float64", "bool", "int64"),
    ]
    assert rows["is"][0] == float("inf")
    assert math.isnan(rows["ratio"][0])


@pytest.mark.parametrize(
    ("lines", "end", "reason"),
    [
        ([HEADER.replace("picp", "coverage"), *LINES], "\n", "no column picp"),
        ([HEADER, *LINES[:5]], "\n", "90% has rows for X, Y, Z, Roll, Pitch, not for"),
        ([HEADER, LINES[0].replace("91.5", "much"), *LINES[1:]], "\n", "picp is 'much'"),
        ([HEADER, LINES[0].replace("True", "yes"), *LINES[1:]], "\n", "in_band is 'yes'"),
        ([HEADER, *LINES[:5], LINES[5][:20]], "\n", "line 7 has no is"),
        ([HEADER, *LINES], "", "the last line is cut off"),
        ([HEADER], "\n", "no rows"),
    ],
)
def test_damage_is_named(tmp_path: Path, lines: list[str], end: str, reason: str) -> None:
    path = _file(tmp_path, *lines, end=end)
    with pytest.raises(UncalError) as caught:
        read_csv(path, RESULTS)
    text = str(caught.value)
    assert text.startswith(f"{path} is damaged: ")
    assert reason in text
    assert "uncal.evaluate" in text


def test_csv_keeps_every_digit() -> None:
    frame = pd.DataFrame({"a": [0.1 + 0.2, float("inf"), float("nan")], "b": [True, False, True]})
    assert csv_text(frame) == "a,b\n0.30000000000000004,True\ninf,False\nnan,True\n"


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    path.write_bytes(b"\xff\xfe\x00dof")
    with pytest.raises(UncalError, match="is damaged"):
        read_csv(path, RESULTS)


def test_a_calibration_curve_reads_back_and_a_missing_dof_is_named(tmp_path: Path) -> None:
    header = "dof,level,picp,coverage_low,coverage_high,in_band"
    lines = [f"{dof},90.0,{j}.5,86.0,94.0,{j == 0}" for j, dof in enumerate(DOF_NAMES)]
    rows = read_csv(_file(tmp_path, header, *lines), CURVE)
    assert rows.iloc[0].tolist() == ["X", 90.0, 0.5, 86.0, 94.0, True]
    assert rows.iloc[5].tolist() == ["Yaw", 90.0, 5.5, 86.0, 94.0, False]
    with pytest.raises(UncalError, match=r"90% has rows for X, Y, Z, Roll, Pitch, not for"):
        read_csv(_file(tmp_path, header, *lines[:-1]), CURVE)
