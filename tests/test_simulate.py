from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest
from omegaconf import OmegaConf

from uncal.settings.configuration import CONFIG_DIR
from uncal.simulate import main

Run = Callable[..., "subprocess.CompletedProcess[str]"]

TINY = (
    "simulation.n_rigs=1",
    "simulation.frames_per_drive=2",
    "simulation.camera.height=16",
    "simulation.camera.width=40",
    "simulation.camera.focal_px=45",
    "simulation.lidar.beams=8",
    "simulation.lidar.azimuth_step_deg=2",
    "simulation.scene.view_m=50",
)


@pytest.mark.slow
def test_simulates_then_reuses_and_leaves_nothing_else(
    tmp_path: Path, start: Run, start_process: Run
) -> None:
    words = ("root=sim", "workers=1", *TINY)
    first = start_process("uncal.simulate", *words, cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    assert "1 rigs, 1 drives, 2 frames" in first.stdout
    assert str(tmp_path / "sim") in first.stdout
    assert "2/2" in first.stderr, "the progress bar counts frames"
    assert [entry.name for entry in tmp_path.iterdir()] == ["sim"]
    assert json.loads((tmp_path / "sim/simulation.json").read_text())["n_frames"] == 2
    images = list((tmp_path / "sim").glob("2041_01_01/*_sync/image_02/data/*.png"))
    assert len(images) == 2
    second = start("uncal.simulate", *words, cwd=tmp_path)
    assert second.returncode == 0
    assert "reusing" in second.stdout


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("root=mine", "no simulation.json"),
        (
            "simulation.camera.height=0",
            "simulation.camera.height=0: expected a whole number from 8",
        ),
        ("+simulation.lidar.beam=3", "did you mean simulation.lidar.beams?"),
        ("workers=0", "workers=0: expected a whole number from 1 to 256 or null"),
        ("workers=many", "workers=many: expected a whole number from 1 to 256 or null"),
    ],
)
def test_errors_are_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, argument: str, message: str
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("precious")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["simulate", argument, "progress=false"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert message in str(ended.value)
    assert [entry.name for entry in (tmp_path / "mine").iterdir()] == ["thesis.tex"]


def test_an_error_ends_without_a_traceback(tmp_path: Path, start: Run) -> None:
    failed = start("uncal.simulate", "simulation.n_rigs=0", cwd=tmp_path)
    assert failed.returncode == 1
    assert "simulation.n_rigs=0: expected a whole number from 1 to" in failed.stderr
    assert "Traceback" not in failed.stderr + failed.stdout


def test_help_names_every_key(tmp_path: Path, start: Run) -> None:
    shown = start("uncal.simulate", "--help", cwd=tmp_path)
    assert shown.returncode == 0
    loaded = OmegaConf.load(Path(CONFIG_DIR) / "simulation/street.yaml")
    street = cast(dict[str, object], OmegaConf.to_container(loaded))
    explained = shown.stdout.split("Settings in use")[0]
    keys = list(street)
    for value in street.values():
        keys += list(value) if isinstance(value, dict) else []
    assert len(keys) > 45
    assert [key for key in keys if key not in explained] == []
