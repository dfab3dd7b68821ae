from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from uncal.errors import UncalError
from uncal.reporting.comparison.gathering import MOST_JOBS, gather
from uncal.reporting.comparison.run_folder import read_run_folder

MakeRun = Callable[..., Path]


def _hydra(folder: Path, *overrides: str) -> Path:
    (folder / ".hydra").mkdir(parents=True, exist_ok=True)
    (folder / ".hydra" / "overrides.yaml").write_text("".join(f"- {each}\n" for each in overrides))
    (folder / ".hydra" / "config.yaml").write_text(
        "seed: 3\ninterval:\n  calibrator:\n    _target_: uncal.uncertainty.AbsoluteCalibrator\n"
        "dataset: {split_by: rig}\nsplit: {by: '${dataset.split_by}'}\n"
        "mcd: {passes: 10, seed: '${hydra:job.num}'}\n"
    )
    return folder


def test_a_run_with_everything(tmp_path: Path, make: MakeRun) -> None:
    run = read_run_folder(make(tmp_path / "a"), "Run 1")
    assert run.missing == ()
    assert (len(run.rows), len(run.joint), len(run.control)) == (18, 3, 6)
    record = run.record
    assert (record.calibrator, record.split, record.passes) == ("ConformalCalibrator", "rig", "25")
    assert (record.promise, record.alone, record.reused) == ("exact", False, False)
    assert run.source == "Run 1: simulated street-scene; MC dropout + conformal"
    assert run.made_by == (
        "Run 1: python -m uncal.train seed=0 · seed 0 · commit abc1234 · simulated street-scene"
    )
    assert run.whole is not None
    # Of three axes the length is larger than their mean.
    assert run.whole.translation_after > sum(row.mae_after for row in run.rows[:3]) / 3


def test_the_whole_pose_is_that_of_the_report(tmp_path: Path, make: MakeRun) -> None:
    folder = make(tmp_path / "a")
    run = read_run_folder(folder, "Run 1")
    assert run.whole is not None
    said = (folder / "results.md").read_text(encoding="utf-8")
    assert f"Mean translation error: {run.whole.translation_after:.2f} cm" in said
    assert f"Mean rotation error: {run.whole.rotation_after:.3f}°" in said


def test_an_old_run_works_and_says_what_is_missing(tmp_path: Path, make: MakeRun) -> None:
    folder = make(tmp_path / "old", old=True)
    run = read_run_folder(folder, "Run 1")
    assert [sentence.split(",")[0] for sentence in run.missing] == [
        "no run.json",
        "no control.csv",
        "no predictions.csv",
    ]
    assert run.label == "simulated street-scene"
    assert (run.record.promise, run.record.reused, run.whole) == ("none", None, None)
    assert "command not recorded" in run.made_by
    assert "interval method not recorded" in run.source
    # What Hydra keeps tells more, even where a setting points to something that is gone.
    _hydra(folder)
    record = read_run_folder(folder, "Run 1").record
    assert (record.seed, record.split, record.passes) == ("3", "rig", "10")
    assert record.method == "conformal without σ (absolute)"
    assert record.promise == "exact"


def test_a_damaged_record_counts_as_missing(tmp_path: Path, make: MakeRun) -> None:
    folder = make(tmp_path / "a")
    (folder / "run.json").write_text('{"command": "python')
    run = read_run_folder(folder, "Run 1")
    assert not run.record.recorded
    assert any(sentence.startswith("no run.json") for sentence in run.missing)
    content = {"weights": None, "passes": [1], "settings": "?", "seed": None}
    (folder / "run.json").write_text(json.dumps(content))
    assert read_run_folder(folder, "Run 1").record.recorded


def test_a_calibrator_of_ones_own_promises_nothing_here(tmp_path: Path, make: MakeRun) -> None:
    record = read_run_folder(make(tmp_path / "a"), "Run 1").record
    for name in ("mine.Better", "uncal.uncertainty.MCDropout"):
        assert replace(record, calibrator=name).promise == "none"
    assert replace(record, calibrator="MondrianCalibrator").promise == "by group"
    assert replace(record, calibrator="GaussianIntervals").alone


def test_runs_and_multiruns_by_their_folders(tmp_path: Path, make: MakeRun) -> None:
    single = make(tmp_path / "single", seed=9)
    for number, passes in enumerate((5, 10)):
        job = make(tmp_path / "many" / str(number), seed=number)
        _hydra(job, f"mcd.passes={passes}", "+sweeps=passes")
    failed = _hydra(tmp_path / "many" / "2", "mcd.passes=0", "+sweeps=passes")
    (failed / "failed.txt").write_text("0 stochastic passes")
    gathered = gather([tmp_path / "many", single])
    assert [run.name for run in gathered.single] == ["Run 2"]
    (multirun,) = gathered.multiruns
    assert [run.source.partition(":")[0] for run in multirun.runs] == [
        "Run 1, job 0 (mcd.passes=5)",
        "Run 1, job 1 (mcd.passes=10)",
    ]
    assert len(multirun.jobs) == 3
    assert len(gathered.runs) == len(gathered.all_runs) == 3
    assert gathered.labels == ("simulated street-scene",)
    # Many jobs are shown by their summary, if there is one.
    many = replace(multirun, runs=multirun.runs * MOST_JOBS)
    assert many.shown
    (tmp_path / "many" / "summary.md").write_text("# Multirun\n")
    assert not many.shown
    assert multirun.shown


def test_what_cannot_be_compared_is_refused(tmp_path: Path, make: MakeRun) -> None:
    def refusal(*folders: Path) -> str:
        with pytest.raises(UncalError) as caught:
            gather(folders)
        return str(caught.value)

    nowhere, empty, failed = (tmp_path / name for name in ("nowhere", "empty", "failed"))
    assert f"{nowhere}: there is no such folder" in refusal(nowhere)
    empty.mkdir()
    assert f"{empty}: no results.csv" in refusal(empty)
    assert "uncal.train" in refusal(empty)
    assert f"{_hydra(empty)}: no results.csv" in refusal(empty)
    failed.mkdir()
    (failed / "failed.txt").write_text("no memory\n")
    assert "this run failed (no memory)" in refusal(failed)
    file = failed / "failed.txt"
    assert "it is a file" in refusal(file)
    run = make(tmp_path / "run")
    assert "given twice" in refusal(run, tmp_path / "." / "run")
    _hydra(tmp_path / "many" / "0", "seed=0")
    assert "none of the 1 jobs" in refusal(tmp_path / "many")
    (run / "joint.csv").write_text("level\n90.0\n")
    assert f"{run / 'joint.csv'} is damaged: no column together" in refusal(run)
