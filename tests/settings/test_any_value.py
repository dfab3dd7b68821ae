"""Whatever a setting is set to ends in a run or in one UncalError, before any frame is read."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import cast

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from omegaconf import DictConfig, OmegaConf, open_dict

from uncal.errors import UncalError
from uncal.recordings.frame import FrameId
from uncal.runs.assembly import build_module, build_trainer, check_pairing
from uncal.settings.check import refuse_values
from uncal.settings.configuration import CONFIG_DIR
from uncal.settings.guard import names_the_setting
from uncal.settings.readers import refuse_unread
from uncal.settings.shipped import shipped_config
from uncal.simulation.settings import SimulationSettings

pytestmark = pytest.mark.slow

CHOICES: tuple[tuple[str, ...], ...] = (
    (),
    ("dataset=demo_events", "interval=hierarchical"),
    ("dataset=kitti_odometry", "model/backbone=mobilevit_xxs", "model/head=mlp"),
    ("dataset=dsec", "model/backbone=mobilevit_xxs", "interval=mondrian"),
    ("model/backbone=mobilevit_xxs", "model/head=quantile", "interval=cqr"),
)
VALUES: tuple[object, ...] = (
    *(None, "", "abc", True, False, 0, 1, -1, 2, 7, 10**12, -(10**12)),
    *(0.5, -0.5, 1.0, 1.5, 1e300, float("nan"), float("inf"), -float("inf")),
    *([], [0], [-1, 2], ["abc"], [0.5, 0.9], [1] * 40, {}, {"a": 1}, {"_target_": "no.such"}),
)
FRAMES = [FrameId(f"rig{r}", f"drive{d}", i) for r in range(8) for d in range(3) for i in range(20)]


@pytest.fixture(scope="module", autouse=True)
def hydra_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """What callbacks refer to as the run's folder."""
    folder = tmp_path_factory.mktemp("run")
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("train", return_hydra_config=True)
    with open_dict(config):
        config.hydra.runtime.output_dir = str(folder)
    HydraConfig.instance().set_config(config)
    yield folder
    HydraConfig.instance().cfg = None


@cache
def composed(base: int) -> tuple[bytes, DictConfig]:
    """A configuration, pickled since that is copied eight times faster, and what ships."""
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("train", list(CHOICES[base]), return_hydra_config=True)
    choices = {str(k): v for k, v in config.hydra.runtime.choices.items() if isinstance(v, str)}
    with open_dict(config):
        config.pop("hydra")
    return pickle.dumps(config), shipped_config("train", choices)


def keys_of(node: object, path: str = "") -> Iterator[str]:
    """Every key, groups too."""
    if isinstance(node, dict):
        for name, value in node.items():
            here = f"{path}.{name}" if path else str(name)
            yield here
            yield from keys_of(value, here)


@cache
def places() -> list[tuple[int, str]]:
    """Every key of every choice; composed when the test runs, not when it is collected."""
    return [
        (base, key)
        for base in range(len(CHOICES))
        for key in keys_of(OmegaConf.to_container(pickle.loads(composed(base)[0])))
    ]


PLACE = st.integers(0, 2**32).map(lambda number: places()[number % len(places())])


def begin(config: DictConfig, shipped: DictConfig) -> None:
    """Everything that a training does before it looks at a recording."""
    refuse_unread(config, shipped)
    refuse_values(config, shipped)
    if "simulation" in config.dataset:
        plain = OmegaConf.to_container(config.dataset.simulation, resolve=True)
        SimulationSettings.from_mapping(cast("dict[str, object]", plain))
    build_module(config)
    build_trainer(config)
    check_pairing(config, instantiate(config.model.inputs))
    guarded = names_the_setting("split", "dataset")(instantiate)
    guarded(config.split).split(FRAMES)
    for group in (config.decalibration, config.augmentation, config.window, config.dataset.loader):
        guarded(group)


def refusal(config: DictConfig, shipped: DictConfig) -> str | None:
    """What a training says of its settings; None if it would go on to the recordings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            begin(config, shipped)
        except UncalError as error:
            return str(error)
    return None


@settings(
    max_examples=600, deadline=None, derandomize=True, database=None,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
@given(PLACE, st.sampled_from(VALUES))
def test_any_value_of_any_key(place: tuple[int, str], value: object) -> None:
    base, key = place
    pickled, shipped = composed(base)
    config = pickle.loads(pickled)
    with open_dict(config):
        OmegaConf.update(config, key, value, merge=False)
    said = refusal(config, shipped)
    assert said is None or len(said) > 10


@settings(max_examples=100, deadline=None, derandomize=True, database=None)
@given(PLACE, st.sampled_from("xzq"), st.integers(0, 40))
def test_any_misspelt_key_is_named(place: tuple[int, str], letter: str, where: int) -> None:
    base, key = place
    group, _, name = key.rpartition(".")
    wrong = name[: where % len(name)] + letter + name[where % len(name) :]
    if name.startswith("_"):
        return
    pickled, shipped = composed(base)
    config = pickle.loads(pickled)
    with open_dict(config):
        OmegaConf.update(config, f"{group}.{wrong}" if group else wrong, 1, force_add=True)
    with pytest.raises(UncalError, match=wrong):
        refuse_unread(config, shipped)
