"""kill -9 at any moment costs what was being done, and nothing else."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

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
    "callbacks.figures=null",
    "callbacks.interval_overlays=null",
    "hydra.run.dir=run",
]


def start(folder: Path) -> subprocess.Popen[str]:
    folder.mkdir(exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "uncal.train", *TINY],
        cwd=folder,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def kill_when(folder: Path, sign: str, delay: float) -> None:
    """Start a run and kill it a moment after it has made a file."""
    started = start(folder)
    deadline = time.monotonic() + 300
    while not list(folder.glob(sign)) and started.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(delay)
    started.kill()
    started.communicate(timeout=60)


def finished(folder: Path) -> bytes:
    ended = start(folder)
    _, stderr = ended.communicate(timeout=300)
    assert ended.returncode == 0, stderr[-4000:]
    return (folder / "run" / "results.csv").read_bytes()


def test_a_run_killed_again_and_again_ends_with_the_same_bytes(tmp_path: Path) -> None:
    rng = random.Random(0)
    killed = tmp_path / "killed"
    signs = (
        "data/demo/.partial_*",  # simulating
        "run/checkpoints/last.ckpt",  # training
        "run/*.csv",  # writing
    )
    for sign in signs:
        kill_when(killed, sign, rng.uniform(0, 0.5))
    again = finished(killed)
    assert again == finished(tmp_path / "whole")
    left = {path.name for path in killed.rglob("*")} - {
        path.name for path in (tmp_path / "whole").rglob("*")
    }
    assert not {name for name in left if name.startswith((".partial_", "best-", "last-"))}
