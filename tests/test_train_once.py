"""Weights are trained once, found again, and go on where their training was interrupted."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

TINY = [
    "dataset.simulation.n_rigs=10",
    "dataset.simulation.frames_per_drive=4",
    "dataset.simulation.camera.supersampling=1",
    "dataset.simulation.lidar.beams=32",
    "dataset.loader.batch_size=4",
    "dataset.validations=3",
    "trainer.max_epochs=3",
    "trainer.accelerator=cpu",
    "interval.levels=[0.5]",
    "callbacks.overlays=null",
    "callbacks.figures=null",
    "callbacks.interval_overlays=null",
]


def command(*overrides: str) -> list[str]:
    return [sys.executable, "-m", "uncal.train", *overrides, *TINY]


def heed_interrupts() -> None:
    """What a shell starts in the background ignores Ctrl-C, and so would what the tests start."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def train(cwd: Path, *overrides: str) -> str:
    """Everything that a run says; fails the test if the run fails."""
    done = subprocess.run(
        command(*overrides), cwd=cwd, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout + done.stderr


def record(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    return content


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("once")


@pytest.fixture(scope="module")
def swept(workplace: Path) -> str:
    return train(workplace, "-m", "mcd.passes=4,2", "hydra.sweep.dir=many")


def test_other_passes_are_asked_of_the_same_weights(swept: str, workplace: Path) -> None:
    four, two = (record(workplace / "many" / job) for job in "01")
    assert [four["weights"]["reused"], two["weights"]["reused"]] == [False, True]
    assert four["weights"]["fingerprint"] == two["weights"]["fingerprint"]
    assert two["passes"]["test"] == "reused"
    assert "reused, not trained again" in swept
    markdown = (workplace / "many" / "1" / "results.md").read_text(encoding="utf-8")
    assert "reused, not trained again" in markdown
    assert "1 of 2 jobs trained" in (workplace / "many" / "summary.md").read_text(encoding="utf-8")


def test_the_reused_weights_give_what_their_own_training_would_have(
    swept: str, workplace: Path
) -> None:
    train(workplace, "mcd.passes=2", "store=null", "hydra.run.dir=alone")
    assert record(workplace / "alone")["weights"]["reused"] is False
    alone = (workplace / "alone" / "results.csv").read_bytes()
    assert (workplace / "many" / "1" / "results.csv").read_bytes() == alone


def test_the_checkpoint_of_a_run_that_reused_weights_is_its_own(
    swept: str, workplace: Path
) -> None:
    checkpoint = "ckpt=many/1/checkpoints/best.ckpt"
    evaluate = [sys.executable, "-m", "uncal.evaluate", checkpoint, "hydra.run.dir=evaluated"]
    evaluate += [key for key in TINY if key.startswith("callbacks") and "overlays=" not in key]
    done = subprocess.run(evaluate, cwd=workplace, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    assert "calibrating anew" not in done.stderr
    own = (workplace / "many" / "1" / "results.csv").read_bytes()
    assert (workplace / "evaluated" / "results.csv").read_bytes() == own


def test_a_multirun_started_again_keeps_what_is_finished(swept: str, workplace: Path) -> None:
    folder = workplace / "many"
    times = [(folder / job / "results.csv").stat().st_mtime_ns for job in "01"]
    (folder / "1" / "run.json").unlink()  # as if it had been interrupted before its end
    said = train(workplace, "-m", "mcd.passes=4,2", "hydra.sweep.dir=many")
    assert said.count("kept as it is") == 1
    after = [(folder / job / "results.csv").stat().st_mtime_ns for job in "01"]
    assert after[0] == times[0]
    assert after[1] > times[1]
    assert record(folder / "1")["weights"]["reused"] is True


def test_retraining_is_forced(swept: str, workplace: Path) -> None:
    train(workplace, "mcd.passes=4", "retrain=true", "hydra.run.dir=forced")
    content = record(workplace / "forced")
    assert content["weights"]["reused"] is False
    assert content["passes"]["test"] == "computed"
    first = (workplace / "many" / "0" / "results.csv").read_bytes()
    assert (workplace / "forced" / "results.csv").read_bytes() == first


def test_an_interrupted_training_goes_on_and_ends_with_the_same_weights(
    swept: str, workplace: Path
) -> None:
    other = "store=another"
    last = workplace / "stopped" / "checkpoints" / "last.ckpt"
    started = subprocess.Popen(
        command("mcd.passes=4", other, "hydra.run.dir=stopped"),
        cwd=workplace,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heed_interrupts,
    )
    deadline = time.monotonic() + 300
    while not last.exists() and started.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    started.send_signal(signal.SIGINT)
    _, stderr = started.communicate(timeout=120)
    assert started.returncode != 0, stderr
    assert "go on after the last finished epoch with the same command" in stderr

    said = train(workplace, "mcd.passes=4", other, "hydra.run.dir=resumed")
    assert "going on with the interrupted training" in said
    assert record(workplace / "resumed")["weights"]["reused"] is False
    uninterrupted = (workplace / "many" / "0" / "results.csv").read_bytes()
    assert (workplace / "resumed" / "results.csv").read_bytes() == uninterrupted
