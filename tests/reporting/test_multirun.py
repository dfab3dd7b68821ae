"""Job folders made by hand: beams 16 and 64, seeds 0 and 1, and what can go wrong."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.reporting.multirun import summary_csv, summary_markdown, write_summary
from uncal.reporting.multirun_jobs import UNFINISHED, read_jobs, swept_keys
from uncal.reporting.rows import ResultRow, Summary
from uncal.reporting.tables import write_results

COMMAND = "python -m uncal.train -m lidar.beams=16,64 seed=0,1"
BEAMS = "dataset.simulation.lidar.beams"


def row(dof: int, level: float, picp: float, mpiw: float, ratio: float) -> ResultRow:
    return ResultRow(
        dof=DOF_NAMES[dof],
        unit=DOF_UNITS[dof],
        level=level,
        picp=picp,
        mpiw=mpiw,
        interval_score=2 * mpiw,
        coverage_low=80.0,
        coverage_high=100.0,
        in_band=True,
        mae_before=4.0,
        mae_after=4.0 * ratio,
        ratio=ratio,
        n_test=20,
        n_calibration=30,
    )


def started(folder: Path, *overrides: str, seed: int = 0) -> Path:
    """What Hydra leaves as soon as a job starts."""
    record = folder / ".hydra"
    record.mkdir(parents=True)
    (record / "config.yaml").write_text(f"seed: {seed}\nname: ${{missing}}\n")
    (record / "overrides.yaml").write_text("".join(f"- {item}\n" for item in overrides) or "[]\n")
    return folder


def finished(folder: Path, *overrides: str, seed: int, mpiw: float, ratio: float = 0.5) -> None:
    """X is ``mpiw`` wide, Y one more, …; at the second level all is infinite; Yaw says nothing."""
    started(folder, *overrides, seed=seed)
    ratios = [ratio] * 5 + [float("nan")]
    rows = [row(j, 90.0, 100.0 - j, mpiw + j, ratios[j]) for j in range(6)]
    rows += [row(j, 99.0, 100.0, float("inf"), ratios[j]) for j in range(6)]
    whole = Summary(ratio, 7.0, 3.5, 1.0, 0.5, n_test=20, n_calibration=30)
    write_results(folder, rows, whole, label="simulated street-scene")


@pytest.fixture
def multirun(tmp_path: Path) -> Path:
    """2 beams × 2 seeds finished, of 128 beams one failed and one unfinished."""
    fixed = ("+sweeps=beams", "trainer.max_epochs=2")
    finished(tmp_path / "0", f"{BEAMS}=16", "seed=0", *fixed, seed=0, mpiw=1.0, ratio=0.4)
    finished(tmp_path / "1", f"{BEAMS}=16", "seed=1", *fixed, seed=1, mpiw=3.0, ratio=0.8)
    finished(tmp_path / "2", f"{BEAMS}=64", "seed=0", *fixed, seed=0, mpiw=0.5)
    finished(tmp_path / "10", f"{BEAMS}=64", "seed=1", *fixed, seed=1, mpiw=0.5)
    failed = started(tmp_path / "11", f"{BEAMS}=128", "seed=0", *fixed, seed=0)
    (failed / "failed.txt").write_text("no memory:\n  128 beams are too many\n")
    started(tmp_path / "12", f"{BEAMS}=128", "seed=1", *fixed, seed=1)
    (tmp_path / "no_job").mkdir()
    return tmp_path


def test_jobs_are_read_in_the_order_of_their_numbers(multirun: Path) -> None:
    jobs = read_jobs(multirun)
    assert [job.folder for job in jobs] == ["0", "1", "2", "10", "11", "12"]
    assert [job.seed for job in jobs] == ["0", "1", "0", "1", "0", "1"]
    assert swept_keys(jobs) == (BEAMS,)
    assert {job.label for job in jobs[:4]} == {"simulated street-scene"}
    assert [job.failure for job in jobs[:4]] == [None] * 4
    assert jobs[4].failure == "no memory: 128 beams are too many"
    assert jobs[5].failure == UNFINISHED


def test_the_csv_has_a_row_per_finished_job_level_and_dof(multirun: Path) -> None:
    text = summary_csv(read_jobs(multirun))
    table = list(csv.DictReader(io.StringIO(text)))
    assert list(table[0]) == [
        *(BEAMS, "seed", "dof", "unit", "level", "picp", "mpiw", "is", "ratio", "mae_after"),
        *("n_test", "n_calibration", "folder"),
    ]
    assert len(table) == 4 * 2 * 6
    pitch = table[12 + 4]
    assert pitch == {
        BEAMS: "16",
        "seed": "1",
        "dof": "Pitch",
        "unit": "°",
        "level": "90.0",
        "picp": "96.0",
        "mpiw": "7.0",
        "is": "14.0",
        "ratio": "0.8",
        "mae_after": "3.2",
        "n_test": "20",
        "n_calibration": "30",
        "folder": "1",
    }


def test_the_markdown_takes_seeds_together_and_names_what_is_missing(multirun: Path) -> None:
    text = summary_markdown(read_jobs(multirun), COMMAND)
    lines = text.splitlines()
    assert lines[0] == "# Multirun on simulated street-scene data"
    assert f"    {COMMAND}" in lines
    assert "Jobs: 6, with results: 4. 20 frames in the test set, 30 in the uncertainty" in text
    assert "Mean ± standard deviation over the seeds 0, 1." in text
    first = lines[lines.index("## 90% intervals") + 2 :]
    assert first[0].startswith(f"| {BEAMS} | seeds | X MPIW (cm) |")
    assert [cell.strip() for cell in first[2].split("|")[1:-1]] == [
        *("16", "2"),
        *("2.00 ± 1.41", "3.00 ± 1.41", "4.00 ± 1.41"),
        *("5.000 ± 1.414", "6.000 ± 1.414", "7.000 ± 1.414"),
        *("100.0 ± 0.0", "99.0 ± 0.0", "98.0 ± 0.0", "97.0 ± 0.0", "96.0 ± 0.0", "95.0 ± 0.0"),
        "0.600 ± 0.283",
    ]
    second = lines[lines.index("## 99% intervals") + 2 :]
    assert second[2].startswith("| 16 | 2 | ∞ | ∞ |")
    assert second[4] == ""  # 128 beams have no row
    assert "- ∞: the uncertainty calibration set is too small for that level." in lines
    assert f"- `11` ({BEAMS}=128, seed=0): no memory: 128 beams are too many" in lines
    assert f"- `12` ({BEAMS}=128, seed=1): {UNFINISHED}" in lines


def test_one_seed_needs_no_deviation(tmp_path: Path) -> None:
    finished(tmp_path / "0", "mcd.passes=5", seed=7, mpiw=1.0)
    finished(tmp_path / "1", "mcd.passes=10", seed=7, mpiw=2.0)
    text = summary_markdown(read_jobs(tmp_path), COMMAND)
    assert "Seed 7." in text
    assert "±" not in text
    assert "seeds" not in text
    assert "| 5 | 1.00 | 2.00 | 3.00 | 4.000 | 5.000 | 6.000 | 100.0 |" in text


def test_seeds_alone_give_one_row(tmp_path: Path) -> None:
    for seed in (0, 1, 2):
        finished(tmp_path / f"{seed}", f"seed={seed}", seed=seed, mpiw=1.0 + seed)
    text = summary_markdown(read_jobs(tmp_path), COMMAND)
    assert "| all | 3 | 2.00 ± 1.00 |" in text


def test_a_failed_job_does_not_show_the_results_of_an_earlier_attempt(tmp_path: Path) -> None:
    finished(tmp_path / "0", "mcd.passes=5", seed=0, mpiw=1.0)
    write_summary(tmp_path, COMMAND)
    assert (tmp_path / "summary.csv").is_file()
    (tmp_path / "0" / "failed.txt").write_text("diverged\n")
    (job,) = write_summary(tmp_path, COMMAND)
    assert (job.rows, job.failure) == ((), "diverged")
    assert not (tmp_path / "summary.csv").exists()
    text = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert "- `0`: diverged" in text
    assert "## 90%" not in text


def test_a_table_with_other_columns_is_no_result(tmp_path: Path) -> None:
    folder = started(tmp_path / "0", "mcd.passes=5")
    (folder / "results.csv").write_text("dof,level\nX,90.0\n")
    (job,) = read_jobs(tmp_path)
    assert job.rows == ()
    assert job.failure is not None
    assert "picp" in job.failure
