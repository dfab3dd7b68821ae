"""Small simulated recordings, and references made of them, for all tests of the monitor."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest
from omegaconf import OmegaConf

from uncal.settings.configuration import CONFIG_DIR
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated

Run = Callable[..., "subprocess.CompletedProcess[str]"]

TINY = {
    "n_rigs": 3,
    "frames_per_drive": 4,
    "camera": {"height": 48, "width": 128, "focal_px": 140.0},
    "lidar": {"beams": 32, "azimuth_step_deg": 0.6},
    "scene": {"view_m": 60.0},
}
SETTINGS = ("window=2", "level=0.5", "exchangeable=window", "weights=unical")


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three rigs of one drive of four frames each, KITTI layout; tests must not change it."""
    root = tmp_path_factory.mktemp("monitored") / "root"
    street = OmegaConf.load(Path(CONFIG_DIR) / "simulation" / "street.yaml")
    merged = OmegaConf.to_container(OmegaConf.merge(street, TINY))
    ensure_simulated(
        SimulationSettings.from_mapping(cast("dict[str, object]", merged)),
        root,
        workers=1,
        progress=False,
    )
    return root


@pytest.fixture(scope="session")
def settings() -> tuple[str, ...]:
    """Overrides with which so few recordings do."""
    return SETTINGS


@pytest.fixture(scope="session")
def references(recorded: Path, tmp_path_factory: pytest.TempPathFactory, start: Run) -> Path:
    """References of the recordings, with those settings."""
    folder = tmp_path_factory.mktemp("references")
    path = folder / "mine.npz"
    words = (f"calibrate={recorded}", f"references={path}", *SETTINGS)
    done = start("uncal.monitor.__main__", *words, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "6 windows of 2 frames, 3 drives" in done.stdout
    assert path.is_file()
    return path
