"""A whole multirun, as a user starts it."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

from uncal.geometry import DOF_NAMES

TINY = [
    "dataset.simulation.n_rigs=10",
    "dataset.simulation.frames_per_drive=4",
    "dataset.simulation.camera.supersampling=1",
    "dataset.simulation.lidar.beams=32",
    "dataset.loader.batch_size=4",
    "trainer.max_epochs=1",
    "trainer.accelerator=cpu",
    "interval.levels=[0.5]",
    "callbacks.overlays=null",
    "callbacks.figures=null",
    "callbacks.interval_overlays=null",
]


@pytest.mark.slow
def test_two_values_are_summarised_and_a_failed_one_is_named(tmp_path: Path) -> None:
    swept = "mcd.passes=2,0,3"
    finished = subprocess.run(
        [sys.executable, "-m", "uncal.train", "-m", swept, *TINY, "hydra.sweep.dir=many"],
        cwd=tmp_path,
        env=os.environ | {"COLUMNS": "110"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert finished.returncode == 1
    assert "mcd.passes=0: expected a whole number from 1" in finished.stderr
    assert "Traceback" not in finished.stderr

    with (tmp_path / "many" / "summary.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [(row["mcd.passes"], row["dof"]) for row in table] == [
        (passes, dof) for passes in ("2", "3") for dof in DOF_NAMES
    ]
    for passes, folder in (("2", "0"), ("3", "2")):
        with (tmp_path / "many" / folder / "results.csv").open(encoding="utf-8") as file:
            results = list(csv.DictReader(file))
        own = [row for row in table if row["mcd.passes"] == passes]
        assert [row["mpiw"] for row in own] == [row["mpiw"] for row in results]

    text = (tmp_path / "many" / "summary.md").read_text(encoding="utf-8")
    assert text.startswith("# Multirun on simulated street-scene data")
    assert f"python -m uncal.train -m {swept}" in text
    assert "- `1` (mcd.passes=0): mcd.passes=0: expected a whole number from 1" in text
