from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from uncal.data.network_input import NetworkInput
from uncal.edges.sweep import COLUMNS
from uncal.errors import ConfigurationError
from uncal.models.alignment import AlignmentEstimator
from uncal.models.estimator import PoseEstimator
from uncal.recordings.frame import FrameId
from uncal.runs.assembly import (
    build_data,
    build_module,
    check_pairing,
    image_size,
    refuse_missing_gpu,
    say_simulated,
    validation_interval,
)
from uncal.settings.configuration import CONFIG_DIR


def composed(*overrides: str) -> DictConfig:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        return compose("train", list(overrides))


def test_a_gpu_that_is_not_there_is_said_in_words_of_the_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    for name in ("gpu", "cuda", "mps"):
        with pytest.raises(ConfigurationError, match=rf"^trainer\.accelerator={name}: .* use cpu"):
            refuse_missing_gpu(name)
    for name in ("cpu", "auto"):
        refuse_missing_gpu(name)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    refuse_missing_gpu("gpu")


@pytest.mark.parametrize("backbone", ["edges", "mobilevit_xxs", "mobilevit_s"])
@pytest.mark.parametrize("head", ["geometric", "mlp"])
def test_every_model_option_builds(backbone: str, head: str) -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("train", [f"model/backbone={backbone}", f"model/head={head}"])
    module = build_module(config)
    rates = set(module.engine.identity().rates)
    assert {0.25, 0.05} <= rates
    assert module.recipe["seed"] == 0


@pytest.mark.parametrize("backbone", ["edges", "mobilevit_xxs"])
@pytest.mark.parametrize(
    ("representation", "channels"), [("voxel_grid", 12), ("histogram", 4), ("time_surface", 4)]
)
def test_every_event_representation_builds(
    backbone: str, representation: str, channels: int
) -> None:
    choices = [f"model/backbone={backbone}", f"model/inputs/events={representation}"]
    config = composed("dataset=dsec", *choices)
    module = build_module(config)
    kind = AlignmentEstimator if backbone == "edges" else PoseEstimator
    assert isinstance(module.estimator, kind)
    assert {0.25, 0.10} <= set(module.engine.identity().rates)
    x = torch.zeros(2, channels, 64, 96)
    K = torch.tensor([[90.0, 0.0, 48.0], [0.0, 90.0, 32.0], [0.0, 0.0, 1.0]]).expand(2, 3, 3)
    inputs = NetworkInput(
        x=x,
        inverse_depth=x[:, :1],
        K=K,
        T_init=torch.eye(4).expand(2, 4, 4),
        target=torch.zeros(2, 6),
        unit_index=torch.arange(2),
        frames=[FrameId("rig", "drive", i) for i in range(2)],
        unit=torch.arange(2),
        edges=torch.full((2, 5, len(COLUMNS)), torch.nan),
    )
    assert module(inputs).shape == (2, 6)
    assert config.model.inputs.edges == (2048 if backbone == "edges" else 0)


def test_what_needs_a_solver_is_refused_before_anything_is_trained() -> None:
    mobilevit = "model/backbone=mobilevit_xxs"
    with pytest.raises(ConfigurationError, match=r"window\.frames=4.*model/backbone=edges"):
        build_module(composed(mobilevit, "window.frames=4"))
    with pytest.raises(ConfigurationError, match=r"mcd\.spread=total.*model/backbone=edges"):
        build_module(composed(mobilevit, "mcd.spread=total"))
    build_module(composed("window.frames=4", "mcd.spread=total"))


def test_quantiles_need_a_network_with_a_head_for_them() -> None:
    head, mobilevit = "model/head=quantile", "model/backbone=mobilevit_xxs"
    for choices in ([], [head]):
        with pytest.raises(ConfigurationError, match=f"{mobilevit} {head}"):
            build_module(composed("interval=cqr", *choices))
    with pytest.raises(ConfigurationError, match=f"add {head}"):
        build_module(composed("interval=cqr", mobilevit))
    build_module(composed("interval=cqr", mobilevit, head))


@pytest.mark.parametrize(
    ("dataset", "model"),
    [("demo", "unical"), ("kitti", "unical"), ("dsec", "muliev"), ("demo_events", "muliev")],
)
def test_a_dataset_chooses_the_model_that_can_read_it(dataset: str, model: str) -> None:
    config = composed(f"dataset={dataset}")
    assert config.model.name == model
    check_pairing(config, instantiate(config.model.inputs))


@pytest.mark.parametrize(
    ("dataset", "model", "remedy"),
    [("demo_events", "unical", "choose model=muliev"), ("kitti", "muliev", "choose model=unical")],
)
def test_a_model_that_cannot_read_the_dataset_is_refused_before_anything_is_made(
    dataset: str, model: str, remedy: str, tmp_path: Path
) -> None:
    root = tmp_path / "nothing"
    config = composed(f"dataset={dataset}", f"model={model}", f"dataset.root={root}")
    assert config.model.name == model
    with pytest.raises(ConfigurationError, match=f"model={model} .*dataset={dataset}.*{remedy}"):
        build_data(config)
    assert not root.exists()


def test_a_blind_model_can_read_anything() -> None:
    config = composed("dataset=dsec", "model.inputs.channels=[inverse_depth,intensity]")
    check_pairing(config, instantiate(config.model.inputs))


def test_the_recipe_holds_plain_values_only() -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("train", ["dataset=kitti", "dataset.root=/elsewhere"])
    recipe = build_module(config).recipe
    again = OmegaConf.create(recipe)
    assert again.dataset.recording.root == "/elsewhere"
    assert not any(OmegaConf.is_config(value) for value in recipe.values())


def test_a_key_that_nothing_reads_is_refused_even_when_added_by_force() -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("train", ["+mcd.passs=5"])
    with pytest.raises(ConfigurationError, match=r"mcd\.passs"):
        build_module(config)


@pytest.mark.parametrize(
    ("epochs", "validations", "expected"), [(24, 4, 6), (10, 4, 5), (7, 4, 7), (3, 9, 1), (1, 1, 1)]
)
def test_the_last_epoch_is_always_validated(epochs: int, validations: int, expected: int) -> None:
    every = validation_interval(epochs, validations)
    assert every == expected
    assert epochs % every == 0


def test_no_epochs_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="max_epochs=0"):
        validation_interval(0, 4)


@pytest.mark.parametrize("size", [[80], [80, 208, 3], "80x208", [16, 208], [80.5, 208]])
def test_a_bad_image_size_is_named(size: object) -> None:
    value = OmegaConf.create({"size": size}).size
    with pytest.raises(ConfigurationError, match="image_size"):
        image_size(value)


def test_a_simulation_that_stands_in_for_recordings_says_so(tmp_path: Path) -> None:
    config = OmegaConf.create({"dataset": {"root": str(tmp_path), "label": "DSEC"}})
    say_simulated(config)
    assert config.dataset.label == "DSEC"
    (tmp_path / "simulation.json").write_text("{}")
    say_simulated(config)
    assert config.dataset.label == "simulated (a stand-in for DSEC)"
    say_simulated(config)
    assert config.dataset.label == "simulated (a stand-in for DSEC)"
