from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest
from omegaconf import OmegaConf

from uncal.settings.configuration import CONFIG_DIR
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated

MakeSettings = Callable[..., SimulationSettings]

TINY = {
    "n_rigs": 2,
    "frames_per_drive": 3,
    "camera": {"height": 24, "width": 64, "focal_px": 70.0},
    "lidar": {"beams": 16, "azimuth_step_deg": 1.0},
    "scene": {"view_m": 60.0},
}


@pytest.fixture(scope="session")
def make_settings() -> MakeSettings:
    """Settings of street.yaml made tiny; keyword arguments override groups or keys."""

    def make(**overrides: object) -> SimulationSettings:
        street = OmegaConf.load(Path(CONFIG_DIR) / "simulation" / "street.yaml")
        merged = OmegaConf.to_container(OmegaConf.merge(street, TINY, overrides))
        return SimulationSettings.from_mapping(cast(dict[str, object], merged))

    return make


@pytest.fixture(scope="session")
def make_event_settings() -> MakeSettings:
    """The same of event_street.yaml."""

    def make(**overrides: object) -> SimulationSettings:
        folder = Path(CONFIG_DIR) / "simulation"
        street = OmegaConf.load(folder / "street.yaml")
        events = OmegaConf.create(dict(OmegaConf.load(folder / "event_street.yaml")))
        defaults = events.pop("defaults")
        assert list(defaults) == ["street", "_self_"]
        tiny = {"events": {"subframes": 3}}
        merged = OmegaConf.to_container(OmegaConf.merge(street, events, TINY, tiny, overrides))
        return SimulationSettings.from_mapping(cast(dict[str, object], merged))

    return make


@pytest.fixture(scope="session")
def tiny_settings(make_settings: MakeSettings) -> SimulationSettings:
    return make_settings()


@pytest.fixture(scope="session")
def tiny_simulation(
    tiny_settings: SimulationSettings, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A finished simulation, written by two processes; tests must not change it."""
    root = tmp_path_factory.mktemp("simulated") / "root"
    ensure_simulated(tiny_settings, root, workers=2, progress=False)
    return root


@pytest.fixture(scope="session")
def event_settings(make_event_settings: MakeSettings) -> SimulationSettings:
    return make_event_settings(n_rigs=2, drives_per_rig=2, frames_per_drive=3)


@pytest.fixture(scope="session")
def event_simulation(
    event_settings: SimulationSettings, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A finished simulation with events, written by two processes; tests must not change it."""
    root = tmp_path_factory.mktemp("simulated_events") / "root"
    ensure_simulated(event_settings, root, workers=2, progress=False)
    return root
