"""Whole runs, as a user starts them."""

import csv
import math
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import (  # type: ignore[import-untyped]
    EventAccumulator,
)

from uncal.geometry.transforms import DOF_NAMES
from uncal.uncertainty.conformal.split_conformal import ConformalCalibrator

Run = Callable[..., "subprocess.CompletedProcess[str]"]

QUANTILE = ["model/backbone=mobilevit_xxs", "model/head=quantile"]
NO_PICTURES = ["callbacks.figures=null", "callbacks.interval_overlays=null"]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_model_without_parameters_is_not_trained(
    start: Run, tiny: list[str], quick: list[str], make_workplace: Callable[[str], Path]
) -> None:
    place = make_workplace("edges")
    options = ["model=edges", "model.search.samples=64", "hydra.run.dir=run"]
    words = [*tiny, *quick, *options, "trainer.max_epochs=2"]
    trained = start("uncal.train", *words, cwd=place)

    assert trained.returncode == 0, trained.stderr
    assert "No training: this model has no parameters." in trained.stdout
    checkpoint = place / "run" / "checkpoints" / "best.ckpt"
    assert checkpoint.is_file()
    assert not (place / "outputs" / "trained").exists()

    words = [f"ckpt={checkpoint}", "hydra.run.dir=again", *NO_PICTURES]
    evaluated = start("uncal.evaluate", *words, cwd=place)

    assert evaluated.returncode == 0, evaluated.stderr


def test_the_table_has_a_row_per_dof_and_level(demo: object, workplace: Path) -> None:
    table = rows(workplace / "first" / "results.csv")
    assert [(row["dof"], float(row["level"])) for row in table] == [
        (dof, level) for level in (90.0, 95.0, 99.0) for dof in DOF_NAMES
    ]
    for row in table:
        assert 0.0 <= float(row["picp"]) <= 100.0
        assert float(row["mpiw"]) > 0.0
        assert float(row["is"]) >= float(row["mpiw"])
        assert float(row["mae_before"]) > 0.0
        assert math.isfinite(float(row["mae_after"]))
    # Four frames in the uncertainty calibration split: no 90 % interval is finite.
    assert {row["mpiw"] for row in table} == {"inf"}


def test_the_terminal_and_the_markdown_say_what_the_data_are(
    demo: subprocess.CompletedProcess[str], workplace: Path
) -> None:
    markdown = (workplace / "first" / "results.md").read_text(encoding="utf-8")
    for text in (demo.stdout, markdown):
        assert "simulated" in text
        assert "∞" in text


def test_tensorboard_has_errors_intervals_and_pictures(demo: object, workplace: Path) -> None:
    events = EventAccumulator(str(workplace / "first"))
    events.Reload()
    scalars = set(events.Tags()["scalars"])
    assert {"loss/train", "relative error/Yaw"} <= scalars
    assert {"PICP 90% (%)/Pitch", "MPIW 95%/X (cm)", "IS 99%/Roll (°)"} <= scalars
    assert any(tag.startswith("overlay/") for tag in events.Tags()["images"])
    assert list((workplace / "first" / "overlays").glob("*.png"))


def test_the_checkpoint_carries_the_calibrator(demo: object, workplace: Path) -> None:
    path = workplace / "first" / "checkpoints" / "best.ckpt"
    state = torch.load(path, weights_only=True)["state_dict"]
    calibrator = ConformalCalibrator()
    prefix = "calibrator."
    calibrator.load_state_dict(
        {key.removeprefix(prefix): v for key, v in state.items() if key.startswith(prefix)}
    )
    assert calibrator.is_fitted
    assert calibrator.scores.shape[1] == 6
    assert int(calibrator.passes) == 4


@pytest.mark.slow
def test_evaluation_of_the_checkpoint_gives_the_same_bytes(
    demo: object, workplace: Path, start_process: Run
) -> None:
    words = ["ckpt=first/checkpoints/best.ckpt", "hydra.run.dir=again", *NO_PICTURES]
    finished = start_process("uncal.evaluate", *words, cwd=workplace)
    assert finished.returncode == 0, finished.stderr[-4000:]
    first, again = (workplace / name / "results.csv" for name in ("first", "again"))
    assert first.read_bytes() == again.read_bytes()


def evaluate(start: Run, cwd: Path, folder: str, *overrides: str) -> list[dict[str, str]]:
    finished = start(
        "uncal.evaluate",
        "ckpt=first/checkpoints/best.ckpt",
        f"hydra.run.dir={folder}",
        *NO_PICTURES,
        *overrides,
        cwd=cwd,
    )
    assert finished.returncode == 0, finished.stderr[-4000:]
    return rows(cwd / folder / "results.csv")


@pytest.mark.slow
def test_two_processes_calibrate_and_test_like_one(
    demo: object, workplace: Path, start: Run, start_process: Run
) -> None:
    # Other passes than in training, so that both calibrate anew; 7 test frames, of which Lightning
    # makes 8 for 2 processes.
    asked = (
        *("mcd.passes=6", "interval.levels=[0.5]", "interval=conformal", "split.by=frame"),
        "split.fractions=[0.425,0.2,0.2,0.175]",
    )
    one = evaluate(start, workplace, "one", *asked)
    processes = ("trainer.devices=2", "trainer.strategy=ddp")
    two = evaluate(start_process, workplace, "two", *asked, *processes)
    assert {row["n_test"] for row in (*one, *two)} == {"7"}
    assert len(one) == len(two) == len(DOF_NAMES)
    for a, b in zip(one, two, strict=True):
        for key, value in a.items():
            if key in ("dof", "unit", "in_band"):
                assert b[key] == value
            else:
                assert float(b[key]) == pytest.approx(float(value), rel=1e-4)
        assert math.isfinite(float(a["mpiw"]))


@pytest.mark.parametrize("interval", ["gaussian", "absolute", "mondrian", "hierarchical"])
def test_the_same_weights_with_other_intervals(
    demo: object, workplace: Path, start: Run, interval: str
) -> None:
    before = rows(workplace / "first" / "results.csv")
    after = evaluate(start, workplace, interval, f"interval={interval}", "mcd.masks=fixed")
    assert [row["mae_before"] for row in after] == [row["mae_before"] for row in before]
    finite = {math.isfinite(float(row["mpiw"])) for row in after}
    assert finite == {interval == "gaussian"}
    markdown = (workplace / interval / "results.md").read_text(encoding="utf-8")
    assert f"fixed masks, intervals of kind {interval}" in markdown


def test_another_model_setting_calibrates_anew(demo: object, workplace: Path, start: Run) -> None:
    evaluate(start, workplace, "one_round", "model.rounds=[1]")
    scores = [
        torch.load(workplace / run / "checkpoints" / "best.ckpt", weights_only=True)["state_dict"][
            "calibrator.scores"
        ]
        for run in ("first", "one_round")
    ]
    assert scores[0].shape == scores[1].shape
    assert not torch.allclose(scores[0], scores[1])


def test_quantile_regression_needs_its_head(workplace: Path, start: Run, tiny: list[str]) -> None:
    finished = start("uncal.train", *tiny, "hydra.run.dir=no_head", "interval=cqr", cwd=workplace)
    assert finished.returncode == 1
    assert "model/head=quantile" in finished.stderr
    assert "Traceback" not in finished.stderr


def test_quantile_regression_runs_with_it(
    workplace: Path, start: Run, tiny: list[str], quick: list[str]
) -> None:
    words = [*tiny, *quick, "mcd.passes=4", "hydra.run.dir=cqr", "interval=cqr", *QUANTILE]
    finished = start("uncal.train", *words, cwd=workplace)
    assert finished.returncode == 0, finished.stderr[-4000:]
    markdown = (workplace / "cqr" / "results.md").read_text(encoding="utf-8")
    assert "intervals of kind quantile" in markdown


def test_a_second_run_reuses_the_simulation_and_a_resumed_one_goes_on(
    demo: object, workplace: Path, start: Run, tiny: list[str], quick: list[str]
) -> None:
    manifest = workplace / "data" / "demo" / "simulation.json"
    before = manifest.stat().st_mtime_ns
    words = [*tiny, *quick, "ckpt=first/checkpoints/last.ckpt", "trainer.max_epochs=3"]
    words += ["mcd.passes=4", "hydra.run.dir=resumed"]
    finished = start("uncal.train", *words, cwd=workplace)
    assert finished.returncode == 0, finished.stderr[-4000:]
    assert manifest.stat().st_mtime_ns == before
    state = torch.load(workplace / "resumed" / "checkpoints" / "last.ckpt", weights_only=True)
    assert state["epoch"] == 2
    first = torch.load(workplace / "first" / "checkpoints" / "last.ckpt", weights_only=True)
    steps_per_epoch = first["global_step"] // 2
    assert state["global_step"] == 3 * steps_per_epoch


@pytest.mark.slow
def test_an_interrupted_run_says_how_to_go_on_and_its_checkpoint_loads(
    workplace: Path, interrupt: Run, tiny: list[str], quick: list[str]
) -> None:
    last = workplace / "stopped" / "checkpoints" / "last.ckpt"
    words = [*tiny, *quick, "mcd.passes=4", "hydra.run.dir=stopped", "trainer.max_epochs=400"]
    stopped = interrupt("uncal.train", *words, cwd=workplace, after=last)
    assert stopped.returncode != 0
    assert "interrupted" in stopped.stderr
    assert "stopped/checkpoints/last.ckpt" in stopped.stderr
    assert torch.load(last, weights_only=True)["epoch"] >= 0


def test_a_training_that_diverges_ends_at_that_step_and_not_with_a_table(
    make_workplace: Callable[[str], Path], start: Run, tiny: list[str], quick: list[str]
) -> None:
    place = make_workplace("diverging")
    words = [*tiny, *quick, "trainer.max_epochs=30", "model.optimization.optimizer.lr=1e6"]
    finished = start("uncal.train", *words, "hydra.run.dir=run", cwd=place)
    assert finished.returncode == 1
    # The solver may meet such numbers before the loss is one.
    what = r"the loss is (nan|-?inf)|the normal equations are not finite"
    where = rf"diverges: ({what}) at step \d+ \(epoch \d+ of 30\), learning rate [\d.e+]+ there"
    assert re.search(where, finished.stderr)
    last = place / "run" / "checkpoints" / "last.ckpt"
    if last.is_file():
        assert f"The last good checkpoint is {last}" in finished.stderr
        assert torch.load(last, weights_only=True)["epoch"] >= 0
    else:
        assert "No epoch had ended" in finished.stderr
    assert "Traceback" not in finished.stderr
    assert not (place / "run" / "results.csv").exists()
    assert not list((place / "outputs" / "trained").glob("*/best.ckpt"))


@pytest.mark.parametrize("key", ["mcd.passs=5", "dataset.rot=data", "trainer.max_epoch=1"])
def test_a_misspelt_key_is_named(tmp_path: Path, start: Run, key: str) -> None:
    finished = start("uncal.train", key, cwd=tmp_path)
    assert finished.returncode != 0
    assert key.split("=")[0].split(".")[-1] in finished.stderr


@pytest.mark.slow
def test_a_wrong_root_says_what_was_expected_and_where_to_get_it(
    tmp_path: Path, start_forked: Run
) -> None:
    finished = start_forked("uncal.train", "dataset=kitti", "dataset.root=nowhere", cwd=tmp_path)
    assert finished.returncode == 1
    assert "nowhere" in finished.stderr
    assert "cvlibs.net" in finished.stderr
    assert "Traceback" not in finished.stderr


def test_a_missing_checkpoint_is_one_sentence(tmp_path: Path, start: Run) -> None:
    finished = start("uncal.evaluate", "ckpt=nowhere.ckpt", cwd=tmp_path)
    assert finished.returncode == 1
    assert "nowhere.ckpt" in finished.stderr
    assert "Traceback" not in finished.stderr


@pytest.mark.slow
@pytest.mark.kitti
def test_real_frames_run_to_their_table(
    kitti_root: Path, workplace: Path, start_forked: Run
) -> None:
    finished = start_forked(
        "uncal.train",
        "dataset=kitti",
        f"dataset.root={kitti_root}",
        "trainer.max_epochs=1",
        "mcd.passes=3",
        "dataset.image_size=[96,320]",
        "callbacks.figures=null",
        "hydra.run.dir=real",
        cwd=workplace,
    )
    assert finished.returncode == 0, finished.stderr[-4000:]
    table = rows(workplace / "real" / "results.csv")
    assert {row["n_test"] for row in table} == {"4"}
    assert {row["mpiw"] for row in table} == {"inf"}
    assert "real KITTI" in finished.stdout
    assert "99" in finished.stdout
