"""Whole multiruns by parallel launchers, as a user starts them; one of the jobs fails."""

from __future__ import annotations

import csv
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from uncal.geometry.transforms import DOF_NAMES

pytestmark = pytest.mark.slow

Run = Callable[..., "subprocess.CompletedProcess[str]"]

SWEPT = ("-m", "mcd.passes=2,0,3")
SMALLER = (
    "dataset.simulation.frames_per_drive=2",
    "dataset.simulation.lidar.azimuth_step_deg=0.6",
    "model.start.search.samples=32",
)


@pytest.mark.parametrize(
    "launcher",
    [
        # Jobs that start processes of their own, to load frames.
        ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "dataset.loader.workers=2"),
        ("hydra/launcher=submitit_local",),
    ],
    ids=["joblib and loading processes", "submitit_local"],
)
def test_parallel_jobs_end_as_those_in_turn_do(
    launcher: tuple[str, ...],
    start_process: Run,
    tiny: list[str],
    quick: list[str],
    tmp_path: Path,
) -> None:
    # An empty folder: jobs simulate too, in processes that a launcher has started.
    words = [*SWEPT, *tiny, *quick, *SMALLER, *launcher, "hydra.sweep.dir=many"]
    # Without it, so that the multirun shares the cores itself.
    finished = start_process("uncal.train", *words, cwd=tmp_path, without="OMP_NUM_THREADS")
    assert finished.returncode == 1, finished.stderr[-4000:]
    assert "mcd.passes=0: expected a whole number from 1" in finished.stderr
    assert "thread(s) per job" in finished.stdout

    many = tmp_path / "many"
    with (many / "summary.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [(row["mcd.passes"], row["dof"]) for row in table] == [
        (passes, dof) for passes in ("2", "3") for dof in DOF_NAMES
    ]
    text = (many / "summary.md").read_text(encoding="utf-8")
    assert f"python -m uncal.train {' '.join(SWEPT)}" in text
    assert "Jobs: 3, with results: 2." in text
    assert "- `1` (mcd.passes=0): mcd.passes=0: expected a whole number from 1" in text
    assert "![Interval score against stochastic passes](figures/interval_score.png)" in text
    assert (many / "figures" / "interval_score.pdf").is_file()
    assert not list(tmp_path.rglob("*.partial"))
