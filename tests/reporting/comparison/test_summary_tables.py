from __future__ import annotations

from pathlib import Path

from uncal.reporting.comparison.gathering import Multirun
from uncal.reporting.comparison.summary_tables import multirun_made_by, summary_tables

SUMMARY = r"""# Multirun on simulated data

    python -m uncal.train -m mcd.passes=5,10

Jobs: 3, with results: 2. Seed 0.

## 90% intervals

| mcd.passes | X \| Y |
| :-- | --: |
| 5 | 1.00 ± 0.10 |
| 10 | 2.00 |

- MPIW: mean width, in `summary.csv`.

## Figures

![Score](figures/score.png)

How to read it.

## Jobs without results

- `2`: no memory
"""


def test_the_summary_is_taken_apart(tmp_path: Path) -> None:
    (tmp_path / "summary.md").write_text(SUMMARY, encoding="utf-8")
    multirun = Multirun("Run 1", tmp_path, (), ())
    jobs, intervals, without = summary_tables(multirun)
    assert (jobs.title, list(jobs.rows), jobs.notes) == (
        "Jobs",
        [],
        ["Jobs: 3, with results: 2. Seed 0."],
    )
    assert intervals.title == "90% intervals"
    assert intervals.header == ["mcd.passes", "X | Y"]
    assert intervals.rows == [["5", "1.00 ± 0.10"], ["10", "2.00"]]
    assert intervals.notes == ["MPIW: mean width, in summary.csv."]
    assert without.notes == ["2: no memory"]
    made_by = multirun_made_by(multirun)
    assert made_by.startswith("Run 1: python -m uncal.train -m mcd.passes=5,10 · ")
    assert list(intervals.made_by) == [made_by]


def test_without_a_summary_there_are_no_tables(tmp_path: Path) -> None:
    multirun = Multirun("Run 1", tmp_path, (), ())
    assert summary_tables(multirun) == []
    assert "command not recorded" in multirun_made_by(multirun)
