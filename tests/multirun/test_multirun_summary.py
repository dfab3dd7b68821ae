"""Job folders made by hand: beams 16 and 64, seeds 0 and 1, and what can go wrong."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pandas as pd
import pytest

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.multirun.folder import UNFINISHED, Job, Multirun, read_jobs, swept_keys
from uncal.multirun.summary import summary_markdown, write_summary
from uncal.reporting.frames import CONTROL, JOINT, Schema, csv_text, write_csv

COMMAND = "python -m uncal.train -m lidar.beams=16,64 seed=0,1"
BEAMS = "dataset.simulation.lidar.beams"


def row(dof: int, level: float, picp: float, mpiw: float, ratio: float) -> dict[str, object]:
    return {
        "dof": DOF_NAMES[dof],
        "unit": DOF_UNITS[dof],
        "level": level,
        "picp": picp,
        "mpiw": mpiw,
        "is": 2 * mpiw,
        "coverage_low": 80.0,
        "coverage_high": 100.0,
        "in_band": True,
        "mae_before": 4.0,
        "mae_after": 4.0 * ratio,
        "ratio": ratio,
        "n_test": 20,
        "n_calibration": 30,
    }


def complete(schema: Schema, rows: list[dict[str, object]]) -> str:
    """A table's file; columns that no test looks at are filled."""
    filled = dict.fromkeys(schema.columns, 1) | {"unit": "cm", "groups": "rigs"}
    filled |= {"joint_in_band": True} if schema is JOINT else {}
    return csv_text(pd.DataFrame([filled | row for row in rows], columns=list(schema.columns)))


def markdown(folder: Path) -> str:
    return summary_markdown(Multirun(folder, COMMAND))


def summary_csv(folder: Path) -> str:
    return Multirun(folder, COMMAND).csv()


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
    write_csv(folder / "results.csv", pd.DataFrame(rows))
    record = {"label": "simulated street-scene", "seed": seed}
    (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")


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
    assert [job.name for job in jobs] == ["0", "1", "2", "10", "11", "12"]
    assert [job.seed for job in jobs] == ["0", "1", "0", "1", "0", "1"]
    assert swept_keys(jobs) == (BEAMS,)
    assert {job.label for job in jobs[:4]} == {"simulated street-scene"}
    assert [job.failure for job in jobs[:4]] == [None] * 4
    assert jobs[4].failure == "no memory: 128 beams are too many"
    assert jobs[5].failure == UNFINISHED


def test_the_csv_has_a_row_per_finished_job_level_and_dof(multirun: Path) -> None:
    text = summary_csv(multirun)
    table = list(csv.DictReader(io.StringIO(text)))
    assert list(table[0]) == [
        *(BEAMS, "seed", "dof", "unit", "level", "picp", "mpiw", "is", "ratio", "mae_after"),
        *("n_test", "n_calibration", "coverage_low", "coverage_high", "mae_before"),
        *("label", "folder"),
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
        "coverage_low": "80.0",
        "coverage_high": "100.0",
        "mae_before": "4.0",
        "label": "simulated street-scene",
        "folder": "1",
    }


def test_the_markdown_takes_seeds_together_and_names_what_is_missing(multirun: Path) -> None:
    text = markdown(multirun)
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
    text = markdown(tmp_path)
    assert "Seed 7." in text
    assert "±" not in text
    assert "seeds" not in text
    assert "| 5 | 1.00 | 2.00 | 3.00 | 4.000 | 5.000 | 6.000 | 100.0 |" in text


def test_seeds_alone_give_one_row(tmp_path: Path) -> None:
    for seed in (0, 1, 2):
        finished(tmp_path / f"{seed}", f"seed={seed}", seed=seed, mpiw=1.0 + seed)
    text = markdown(tmp_path)
    assert "| all | 3 | 2.00 ± 1.00 |" in text


def test_a_failed_job_does_not_show_the_results_of_an_earlier_attempt(tmp_path: Path) -> None:
    finished(tmp_path / "0", "mcd.passes=5", seed=0, mpiw=1.0)
    write_summary(tmp_path, COMMAND)
    assert (tmp_path / "summary.csv").is_file()
    (tmp_path / "0" / "failed.txt").write_text("diverged\n")
    (job,) = write_summary(tmp_path, COMMAND).jobs
    assert (job.table, job.failure) == (None, "diverged")
    assert not (tmp_path / "summary.csv").exists()
    text = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert "- `0`: diverged" in text
    assert "## 90%" not in text


def test_a_table_with_other_columns_is_no_result(tmp_path: Path) -> None:
    folder = started(tmp_path / "0", "mcd.passes=5")
    (folder / "results.csv").write_text("dof,level\nX,90.0\n")
    (job,) = read_jobs(tmp_path)
    assert job.table is None
    assert job.failure is not None
    assert "picp" in job.failure


def test_mask_seeds_repeat_like_seeds(tmp_path: Path) -> None:
    for number, (passes, masks) in enumerate([(5, 0), (5, 1), (10, 0), (10, 1)]):
        swept = (f"mcd.passes={passes}", f"mcd.seed={masks}")
        finished(tmp_path / f"{number}", *swept, seed=7, mpiw=passes + 2.0 * masks)
    jobs = read_jobs(tmp_path)
    assert swept_keys(jobs) == ("mcd.passes",)
    text = markdown(tmp_path)
    assert "Mean ± standard deviation over the mask seeds 0, 1. Seed 7." in text
    assert "| mcd.passes | mask seeds | X MPIW (cm) |" in text
    assert "| 5 | 2 | 6.00 ± 1.41 |" in text
    table = list(csv.DictReader(io.StringIO(summary_csv(tmp_path))))
    assert [row["mcd.seed"] for row in table[::12]] == ["0", "1", "0", "1"]


def test_the_first_table_is_of_all_dof(tmp_path: Path) -> None:
    finished(tmp_path / "0", "mcd.passes=5", seed=0, mpiw=1.0, ratio=0.5)
    finished(tmp_path / "1", "mcd.passes=10", seed=0, mpiw=2.0, ratio=0.5)
    joint: dict[str, object] = {"level": 90.0, "together": 61.5, "joint": 92.25, "bonferroni": 95.0}
    (tmp_path / "1" / "joint.csv").write_text(complete(JOINT, [joint]))
    lines = markdown(tmp_path).splitlines()
    table = lines[lines.index("## All DoF, 90% intervals") + 2 :]
    assert table[0] == (
        "| mcd.passes | IS transl. (cm) | IS rot. (°) | MPIW transl. (cm) | MPIW rot. (°) "
        "| PICP, mean (%) | PICP, lowest DoF (%) | six at once (%) | joint box (%) "
        "| Bonferroni (%) | after / before |"
    )
    # widths of the DoF: 1, 2, 3 cm and 4, 5, 6 degrees; scores twice that; PICP 100 … 95
    assert table[2] == "| 5 | 4.00 | 10.000 | 2.00 | 5.000 | 97.5 | 95.0 | – | – | – | 0.500 |"
    assert table[3].startswith("| 10 | 6.00 | 12.000 | 3.00 | 6.000 |")
    assert table[3].endswith("| 61.5 | 92.2 | 95.0 | 0.500 |")
    table_csv = list(csv.DictReader(io.StringIO(summary_csv(tmp_path))))
    assert [row["joint"] for row in table_csv if row["dof"] == "X"] == ["", "", "92.25", ""]


def test_the_control_says_point_errors_and_what_the_camera_contributes(tmp_path: Path) -> None:
    names = "dof mae_single mae_mean mae_blind contribution contribution_low contribution_high"
    for seed in (0, 1):
        for interval, number in (("conformal", seed), ("gaussian", 2 + seed)):
            if number < 3:  # of the second method one seed only
                swept = (f"interval={interval}", f"seed={seed}")
                finished(tmp_path / f"{number}", *swept, seed=seed, mpiw=1.0)
                values = [1.0 + seed, 0.5, 4.0, 60.0 + 10 * seed, 50.0, 71.6]
                rows = [dict(zip(names.split(), [dof, *values], strict=True)) for dof in DOF_NAMES]
                text = complete(CONTROL, rows)
                (tmp_path / f"{number}" / "control.csv").write_text(text)
    lines = markdown(tmp_path).splitlines()
    heading = "## Mean absolute error of one pass without dropout and of the MC mean"
    errors = lines[lines.index(heading) + 2 :]
    assert errors[0].startswith("| interval | seeds | X one pass (cm) | X MC mean (cm) | Y one")
    assert errors[2].startswith("| conformal | 2 | 1.50 ± 0.71 | 0.50 ± 0.00 |")
    camera = lines[lines.index("## What the camera contributes") + 2 :]
    assert (
        camera[0] == "| interval | seeds | X (%) | Y (%) | Z (%) | Roll (%) | Pitch (%) | Yaw (%) |"
    )
    assert camera[2].startswith("| conformal | 2 | 65 ± 7 | 65 ± 7 |")
    assert camera[3].startswith("| gaussian | 1 | 60 [50, 72] |")
    table = list(csv.DictReader(io.StringIO(summary_csv(tmp_path))))
    assert {row["mae_single"] for row in table} == {"1.0", "2.0"}
    assert {row["contribution"] for row in table} == {"60.0", "70.0"}


def test_what_was_trained_and_what_was_found_again_is_said(tmp_path: Path) -> None:
    for number, reused in enumerate([False, True, True, None]):
        folder = tmp_path / f"{number}"
        finished(folder, f"mcd.passes={number + 2}", seed=0, mpiw=1.0)
        if reused is not None:
            weights = {"fingerprint": "0123456789abcdef", "reused": reused}
            (folder / "run.json").write_text(json.dumps({"weights": weights, "seed": 0}))
    text = markdown(tmp_path)
    assert "1 of 3 jobs trained, 2 reused weights." in text
    table = list(csv.DictReader(io.StringIO(summary_csv(tmp_path))))
    assert [row["reused"] for row in table[::12]] == ["False", "True", "True", ""]
    assert {row["weights"] for row in table[:12]} == {"0123456789abcdef"}


def test_an_unfinished_multirun_says_how_it_goes_on(tmp_path: Path) -> None:
    planned = [{"mcd.passes": passes} for passes in ("5", "10", "25")]
    command = "python -m uncal.train -m mcd.passes=5,10,25"
    finished(tmp_path / "0", "mcd.passes=5", seed=0, mpiw=1.0)
    started(tmp_path / "1", "mcd.passes=10")
    write_summary(tmp_path, command, planned)
    text = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert "Jobs: 3, with results: 1." in text
    assert f"\n    {command} hydra.sweep.dir={tmp_path}\n" in text
    assert f"- `1` (mcd.passes=10): {UNFINISHED}" in text
    assert "- not started (mcd.passes=25)" in text

    told = f"{command} hydra.sweep.dir={tmp_path}"
    write_summary(tmp_path, told, planned)
    text = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert text.count("hydra.sweep.dir=") == 2  # the command, and how it goes on

    finished(tmp_path / "2", "mcd.passes=25", seed=0, mpiw=1.0)
    finished(tmp_path / "again", "mcd.passes=10", seed=0, mpiw=1.0)
    write_summary(tmp_path, command, [planned[0], planned[2]])
    assert "resumes" not in (tmp_path / "summary.md").read_text(encoding="utf-8")


def test_folders_of_an_earlier_multirun_are_counted_and_left_out(tmp_path: Path) -> None:
    for number, passes in enumerate((5, 10, 50)):
        finished(tmp_path / f"{number}", f"mcd.passes={passes}", seed=0, mpiw=1.0)
    jobs = write_summary(tmp_path, COMMAND, [{"mcd.passes": "5"}]).jobs
    assert [job.name for job in jobs] == ["0"]
    text = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert "Left out: 2 folders of an earlier multirun (`1`, `2`)." in text
    assert "Jobs: 1, with results: 1." in text
    assert "mcd.passes" not in (tmp_path / "summary.csv").read_text(encoding="utf-8")


def test_a_job_that_ends_while_others_write_is_not_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished(tmp_path / "0", "mcd.passes=5", seed=0, mpiw=1.0)
    started(tmp_path / "1", "mcd.passes=10")
    read = 0

    def reads_before_the_other_ends(folder: Path) -> list[Job]:
        nonlocal read
        read += 1
        jobs = read_jobs(folder)
        if read == 1:
            finished(tmp_path / "done", "mcd.passes=10", seed=0, mpiw=1.0)
            (tmp_path / "done" / "results.csv").rename(tmp_path / "1" / "results.csv")
            (tmp_path / "done" / ".hydra" / "overrides.yaml").unlink()
        return jobs

    monkeypatch.setattr("uncal.multirun.folder.read_jobs", reads_before_the_other_ends)
    write_summary(tmp_path, COMMAND)
    assert "Jobs: 2, with results: 2." in (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert read == 2


def test_a_record_that_is_being_written_is_no_error(tmp_path: Path) -> None:
    finished(tmp_path / "0", "mcd.passes=5", seed=0, mpiw=1.0)
    folder = started(tmp_path / "1", "mcd.passes=10")
    (folder / ".hydra" / "overrides.yaml").write_text("- 'mcd.pass")
    (folder / "run.json").write_text('{"weights": {"finger')
    (folder / "results.csv").write_text((tmp_path / "0" / "results.csv").read_text()[:-9])
    first, second = read_jobs(tmp_path)
    assert first.table is not None
    assert (second.overrides, second.weights) == ({}, {})
    assert second.failure is not None
    assert "damaged" in second.failure


def test_figures_are_shown_with_their_captions(tmp_path: Path) -> None:
    finished(tmp_path / "0", "mcd.passes=5", seed=0, mpiw=1.0)
    (tmp_path / "figures").mkdir()
    rows = [["coverage", "Coverage", "Read it, so."]]
    text = csv_text(pd.DataFrame(rows, columns=["name", "title", "caption"]))
    (tmp_path / "figures" / "captions.csv").write_text(text)
    write_summary(tmp_path, COMMAND)
    shown = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert "\n![Coverage](figures/coverage.png)\n\nRead it, so.\n" in shown


@pytest.mark.parametrize("schema", [CONTROL, JOINT])
def test_a_job_with_a_table_of_other_columns_is_named(tmp_path: Path, schema: Schema) -> None:
    for number in (0, 1):
        finished(tmp_path / f"{number}", f"mcd.passes={5 + number}", seed=0, mpiw=1.0)
    (tmp_path / "1" / schema.file).write_text("other\n1.0\n")
    jobs = read_jobs(tmp_path)
    assert jobs[0].table is not None
    assert jobs[1].table is None
    assert f"{schema.file} is damaged: no column" in (jobs[1].failure or "")
