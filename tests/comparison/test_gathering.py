from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from uncal.comparison.gathering import gather, shown
from uncal.errors import UncalError
from uncal.reporting.frames import CONTROL, JOINT, RESULTS
from uncal.reporting.run import Run, read_run
from uncal.uncertainty import ConformalCalibrator

MakeRun = Callable[..., Path]


def _hydra(folder: Path, *overrides: str) -> Path:
    (folder / ".hydra").mkdir(parents=True, exist_ok=True)
    (folder / ".hydra" / "overrides.yaml").write_text("".join(f"- {each}\n" for each in overrides))
    return folder


def test_a_run_with_everything(tmp_path: Path, make: MakeRun) -> None:
    run = read_run(make(tmp_path / "a"), "Run 1")
    assert run.missing == []
    assert [len(run.tables[schema]) for schema in (RESULTS, JOINT, CONTROL)] == [18, 3, 6]
    assert run.calibrator_class is ConformalCalibrator
    assert (run.setting("split.by"), run.setting("mcd.passes")) == ("rig", "25")
    assert (run.guarantee, run.weights["reused"]) == ("exact", False)
    assert run.source == "Run 1: simulated street-scene; MC dropout + conformal"
    assert run.origin == (
        "Run 1: python -m uncal.train seed=0 · seed 0 · commit abc1234 · simulated street-scene"
    )
    assert run.summary is not None
    # Of three axes the length is larger than their mean.
    assert run.summary.translation_after > run.per_dof["mae_after"][:3].mean()


def test_the_whole_pose_is_that_of_the_report(tmp_path: Path, make: MakeRun) -> None:
    folder = make(tmp_path / "a")
    run = read_run(folder, "Run 1")
    assert run.summary is not None
    said = (folder / "results.md").read_text(encoding="utf-8")
    assert f"Mean translation error: {run.summary.translation_after:.2f} cm" in said
    assert f"Mean rotation error: {run.summary.rotation_after:.3f}°" in said


def test_a_bare_run_works_and_says_what_is_missing(tmp_path: Path, make: MakeRun) -> None:
    run = read_run(make(tmp_path / "bare", bare=True), "Run 1")
    assert [sentence.split(",")[0] for sentence in run.missing] == [
        "no run.json",
        "no control.csv",
        "no predictions.csv",
    ]
    assert run.label == "data not recorded"
    assert (run.guarantee, run.weights, run.summary) == ("none", {}, None)
    assert "command not recorded" in run.origin
    assert "interval method not recorded" in run.source


def test_a_setting_that_points_to_something_gone_is_not_known(tmp_path: Path) -> None:
    settings = {"seed": 3, "mcd": {"passes": 10, "seed": "${hydra:job.num}"}}
    run = Run(tmp_path, {"settings": settings})
    assert (run.setting("mcd.passes"), run.setting("mcd.seed")) == ("10", None)


def test_a_damaged_record_counts_as_missing(tmp_path: Path, make: MakeRun) -> None:
    folder = make(tmp_path / "a")
    (folder / "run.json").write_text('{"command": "python')
    run = read_run(folder, "Run 1")
    assert not run.record
    assert any(sentence.startswith("no run.json") for sentence in run.missing)
    content = {"weights": None, "passes": [1], "settings": "?", "seed": None}
    (folder / "run.json").write_text(json.dumps(content))
    run = read_run(folder, "Run 1")
    assert (run.weights, run.mapping("passes"), run.settings, run.entry("seed")) == (
        {},
        {},
        {},
        None,
    )


def test_a_calibrator_of_ones_own_guarantees_nothing_here(tmp_path: Path, make: MakeRun) -> None:
    run = read_run(make(tmp_path / "a"), "Run 1")

    def with_calibrator(name: str) -> Run:
        settings = {"interval": {"calibrator": {"_target_": name}}}
        return replace(run, record={**run.record, "settings": settings})

    for name in ("mine.Better", "uncal.uncertainty.MCDropout"):
        assert with_calibrator(name).guarantee == "none"
    assert with_calibrator("uncal.uncertainty.MondrianCalibrator").guarantee == "by group"
    absolute = with_calibrator("uncal.uncertainty.AbsoluteCalibrator")
    assert (absolute.guarantee, absolute.method) == ("exact", "conformal without σ (absolute)")
    gaussian = with_calibrator("uncal.uncertainty.GaussianIntervals")
    assert gaussian.method == "MC dropout alone, normal quantiles"


def test_runs_and_multiruns_by_their_folders(
    tmp_path: Path, make: MakeRun, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert len(multirun.found) == 3
    assert len(gathered.runs) == len(gathered.all_runs) == 3
    assert {run.label for run in gathered.all_runs} == {"simulated street-scene"}
    # Many jobs are shown by their summary.
    assert shown(multirun)
    monkeypatch.setattr("uncal.comparison.gathering.MOST_JOBS", 1)
    assert not shown(multirun)


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
