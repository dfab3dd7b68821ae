"""Weights are trained once, found again, and go on where their training was interrupted."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Run = Callable[..., "subprocess.CompletedProcess[str]"]
Train = Callable[..., str]

NO_FIGURES = "hydra.callbacks.summary.figures=false"


@pytest.fixture(scope="module")
def words(tiny: list[str], quick: list[str]) -> list[str]:
    edges = ("model.edges=256", "model.train_edges=64", "model.start.search.samples=32")
    return [*tiny, *quick, *edges, "dataset.validations=3", "trainer.max_epochs=3"]


@pytest.fixture(scope="module")
def workplace(make_workplace: Callable[[str], Path]) -> Path:
    return make_workplace("once")


@pytest.fixture(scope="module")
def train(workplace: Path, start: Run, words: list[str]) -> Train:
    """Everything that a run says; fails the test if the run fails."""

    def train(*overrides: str, start: Run = start) -> str:
        done = start("uncal.train", *overrides, *words, cwd=workplace)
        assert done.returncode == 0, done.stderr[-4000:]
        return done.stdout + done.stderr

    return train


def record(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    return content


@pytest.fixture(scope="module")
def swept(train: Train) -> str:
    return train("-m", "mcd.passes=4,2", "hydra.sweep.dir=many", NO_FIGURES)


def test_other_passes_are_asked_of_the_same_weights(swept: str, workplace: Path) -> None:
    four, two = (record(workplace / "many" / job) for job in "01")
    assert [four["weights"]["reused"], two["weights"]["reused"]] == [False, True]
    assert four["weights"]["fingerprint"] == two["weights"]["fingerprint"]
    assert two["passes"]["test"] == "reused"
    assert "reused, not trained again" in swept
    markdown = (workplace / "many" / "1" / "results.md").read_text(encoding="utf-8")
    assert "reused, not trained again" in markdown
    assert "1 of 2 jobs trained" in (workplace / "many" / "summary.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_reused_weights_give_what_their_own_training_would_have(
    swept: str, workplace: Path, train: Train, start_forked: Run
) -> None:
    train("mcd.passes=2", "store=null", "hydra.run.dir=alone", start=start_forked)
    assert record(workplace / "alone")["weights"]["reused"] is False
    alone = (workplace / "alone" / "results.csv").read_bytes()
    assert (workplace / "many" / "1" / "results.csv").read_bytes() == alone


def test_the_checkpoint_of_a_run_that_reused_weights_is_its_own(
    swept: str, workplace: Path, start: Run
) -> None:
    evaluate = ["ckpt=many/1/checkpoints/best.ckpt", "hydra.run.dir=evaluated"]
    evaluate += ["callbacks.figures=null", "callbacks.interval_overlays=null"]
    done = start("uncal.evaluate", *evaluate, cwd=workplace)
    assert done.returncode == 0, done.stderr[-4000:]
    assert "calibrating anew" not in done.stderr
    own = (workplace / "many" / "1" / "results.csv").read_bytes()
    assert (workplace / "evaluated" / "results.csv").read_bytes() == own


def test_a_multirun_started_again_keeps_what_is_finished(
    swept: str, workplace: Path, train: Train
) -> None:
    folder = workplace / "many"
    times = [(folder / job / "results.csv").stat().st_mtime_ns for job in "01"]
    (folder / "1" / "run.json").unlink()  # as if it had been interrupted before its end
    said = train("-m", "mcd.passes=4,2", "hydra.sweep.dir=many", NO_FIGURES)
    assert said.count("kept as it is") == 1
    after = [(folder / job / "results.csv").stat().st_mtime_ns for job in "01"]
    assert after[0] == times[0]
    assert after[1] > times[1]
    assert record(folder / "1")["weights"]["reused"] is True


def test_retraining_is_forced(swept: str, workplace: Path, train: Train) -> None:
    train("mcd.passes=4", "retrain=true", "hydra.run.dir=forced")
    content = record(workplace / "forced")
    assert content["weights"]["reused"] is False
    assert content["passes"]["test"] == "computed"
    first = (workplace / "many" / "0" / "results.csv").read_bytes()
    assert (workplace / "forced" / "results.csv").read_bytes() == first


@pytest.mark.slow
def test_an_interrupted_training_goes_on_and_ends_with_the_same_weights(
    swept: str, workplace: Path, train: Train, interrupt: Run, words: list[str]
) -> None:
    other = ("mcd.passes=4", "store=another")
    last = workplace / "stopped" / "checkpoints" / "last.ckpt"
    command = [*words, *other, "hydra.run.dir=stopped"]
    stopped = interrupt("uncal.train", *command, cwd=workplace, after=last)
    assert stopped.returncode != 0, stopped.stderr
    assert "go on after the last finished epoch with the same command" in stopped.stderr

    said = train(*other, "hydra.run.dir=resumed")
    assert "going on with the interrupted training" in said
    assert record(workplace / "resumed")["weights"]["reused"] is False
    uninterrupted = (workplace / "many" / "0" / "results.csv").read_bytes()
    assert (workplace / "resumed" / "results.csv").read_bytes() == uninterrupted
