from __future__ import annotations

from pathlib import Path
from typing import cast

import pytest
from omegaconf import OmegaConf

from uncal.settings.configuration import CONFIG_DIR
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated

SMALL = {
    "seed": 3,
    "n_rigs": 1,
    "frames_per_drive": 6,
    "camera": {"height": 120, "width": 312, "focal_px": 345.0},
    "scene": {"view_m": 100.0},
}


def settings(*files: str) -> SimulationSettings:
    folder = Path(CONFIG_DIR) / "simulation"
    loaded = [OmegaConf.create(dict(OmegaConf.load(folder / f"{name}.yaml"))) for name in files]
    for config in loaded:
        config.pop("defaults", None)
    merged = OmegaConf.to_container(OmegaConf.merge(*loaded, SMALL))
    return SimulationSettings.from_mapping(cast(dict[str, object], merged))


@pytest.fixture(scope="session")
def kitti_like(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One simulated drive in KITTI's layout; tests break copies of it."""
    root = tmp_path_factory.mktemp("checked") / "root"
    ensure_simulated(settings("street"), root, workers=1, progress=False)
    return root


@pytest.fixture(scope="session")
def dsec_like(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One simulated drive in DSEC's layout."""
    root = tmp_path_factory.mktemp("checked_events") / "root"
    ensure_simulated(settings("street", "event_street"), root, workers=1, progress=False)
    return root
