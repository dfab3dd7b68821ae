"""kill -9 at any moment costs what was being done, and nothing else."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from forked import Forked

Fork = Callable[..., Forked]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL"),
]

TINY = [
    "dataset.simulation.n_rigs=10",
    "dataset.simulation.frames_per_drive=2",
    "dataset.simulation.camera.supersampling=1",
    "dataset.simulation.lidar.beams=16",
    "dataset.simulation.lidar.azimuth_step_deg=0.6",
    "dataset.loader.batch_size=4",
    "dataset.validations=3",
    "trainer.max_epochs=3",
    "trainer.accelerator=cpu",
    "interval.levels=[0.5]",
    "mcd.passes=2",
    "model.edges=256",
    "model.train_edges=64",
    "model.start.search.samples=32",
    "callbacks.overlays.frames=1",
    "callbacks.figures=null",
    "callbacks.interval_overlays.frames=1",
    "hydra.run.dir=run",
]


@pytest.fixture
def start(fork: Fork) -> Callable[[Path], Forked]:
    def start(folder: Path) -> Forked:
        folder.mkdir(exist_ok=True)
        return fork("uncal.train", *TINY, cwd=folder)

    return start


def kill_when(started: Forked, folder: Path, sign: str, delay: float) -> int:
    """Kill a run a moment after it has made a file; how it ended."""
    deadline = time.monotonic() + 300
    while not list(folder.glob(sign)) and started.is_running():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(delay)
    started.send_signal(signal.SIGKILL)
    return started.finished(timeout=60).returncode


def finished(started: Forked, folder: Path) -> bytes:
    ended = started.finished(timeout=300)
    assert ended.returncode == 0, ended.stderr[-4000:]
    return (folder / "run" / "results.csv").read_bytes()


def test_a_run_killed_again_and_again_ends_with_the_same_bytes(
    tmp_path: Path, start: Callable[[Path], Forked]
) -> None:
    rng = random.Random(0)
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    moments = {  # sign → longest delay
        "data/demo/.partial_*": 0.5,  # simulating
        "run/checkpoints/last.ckpt": 0.5,  # training
        "run/*.csv": 0.05,  # writing
    }
    ends = [
        kill_when(start(killed), killed, sign, rng.uniform(0, longest))
        for sign, longest in moments.items()
    ]
    assert ends[:2] == [-signal.SIGKILL] * 2
    assert ends[2] in (-signal.SIGKILL, 0)  # a busy machine may come too late for the last
    assert finished(start(killed), killed) == finished(start(whole), whole)
    left = {path.name for path in killed.rglob("*")} - {path.name for path in whole.rglob("*")}
    assert not {name for name in left if name.startswith((".partial_", "best-", "last-"))}
