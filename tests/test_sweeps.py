"""Every file in sweeps/ composes with the entry points that its README names."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.types import RunMode
from omegaconf import DictConfig

from uncal.monitor.experiment.cases import ExperimentSettings
from uncal.settings.configuration import CONFIG_DIR

ROOT = Path(__file__).parents[1]
SWEEPS = sorted(path.stem for path in (ROOT / "sweeps").glob("*.yaml"))
SINGLE = ("full_muliev", "full_unical")
"""One training each, not a multirun."""

OWN = ("monitor",)
"""Of an entry point of its own."""


def composed(entry_point: str, *overrides: str) -> DictConfig:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        # What --config-dir does on the command line.
        search = f"hydra.searchpath=[file://{ROOT}]"
        return compose(entry_point, [search, *overrides], return_hydra_config=True)


def test_the_sweeps_are_the_documented_ones() -> None:
    readme = (ROOT / "sweeps" / "README.md").read_text(encoding="utf-8")
    table = [line for line in readme.splitlines() if line.startswith("| `")]
    assert sorted(line.split("`")[1] for line in table) == ["+sweeps=", *SWEEPS]
    for name, line in ((line.split("`")[1], line) for line in table[1:]):
        if name not in (*SINGLE, *OWN):
            params = composed("train", f"+sweeps={name}").hydra.sweeper.params
            jobs = math.prod(len(str(values).split(",")) for values in params.values())
            assert jobs == int(line.split("|")[3]), name


@pytest.mark.parametrize(
    ("entry_point", "name"),
    [("train", name) for name in SWEEPS if name not in (*SINGLE, *OWN)]
    + [("evaluate", "passes"), ("evaluate", "gaussian")],
)
def test_first_jobs_and_last_compose(entry_point: str, name: str) -> None:
    config = composed(entry_point, f"+sweeps={name}")
    assert config.hydra.mode == RunMode.MULTIRUN
    params = {str(key): str(value).split(",") for key, value in config.hydra.sweeper.params.items()}
    for key, values in params.items():
        assert len(set(values)) == len(values) > 1, key
    for which in (0, 1, -1):
        composed(entry_point, f"+sweeps={name}", *(f"{k}={v[which]}" for k, v in params.items()))


@pytest.mark.parametrize("name", SINGLE)
def test_the_trainings_of_shipped_weights_compose(name: str) -> None:
    config = composed("train", f"+sweeps={name}")
    assert config.hydra.mode != RunMode.MULTIRUN
    camera = config.dataset.simulation.camera
    assert list(config.dataset.image_size) == [camera.height, camera.width]
    assert config.model.name == name.removeprefix("full_")


def test_the_experiment_of_the_monitor_composes() -> None:
    config = composed("monitor", "+sweeps=monitor")
    assert config.hydra.mode != RunMode.MULTIRUN
    settings = ExperimentSettings.of(config.experiment)
    cases = settings.cases()
    assert len({case.name for case in cases}) == len(cases) == 1 + 6 * 3 + 2 + 5
    shipped = composed("train", "+sweeps=full_unical").dataset.simulation
    own = config.experiment.simulation
    assert (own.camera, own.lidar, own.rig) == (shipped.camera, shipped.lidar, shipped.rig)
    assert own.seed not in (
        shipped.seed,
        composed("train", "dataset=unseen_rigs").dataset.simulation.seed,
    )


def test_only_the_vertical_resolution_changes_with_the_beams() -> None:
    demo = composed("train", "dataset=demo").dataset
    roots = set()
    for beams in (16, 32, 64):
        key = "dataset.simulation.lidar.beams"
        dataset = composed("train", "+sweeps=beams", f"{key}={beams}").dataset
        roots |= {dataset.root, dataset.recording.root}
        assert dict(dataset.simulation.lidar) == {**demo.simulation.lidar, "beams": beams}
        assert dict(dataset.simulation.camera) == dict(demo.simulation.camera)
    assert roots == {"data/beams_16", "data/beams_32", "data/beams_64"}
