import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from uncal.assembly import build_module, image_size, validation_interval
from uncal.configuration import CONFIG_DIR
from uncal.errors import ConfigurationError


@pytest.mark.parametrize("backbone", ["correlation", "mobilevit_xxs", "mobilevit_s"])
@pytest.mark.parametrize("head", ["geometric", "mlp"])
def test_every_model_option_builds(backbone: str, head: str) -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("train", [f"model/backbone={backbone}", f"model/head={head}"])
    module = build_module(config)
    rates = set(module.engine.identity().rates)
    assert {0.25, 0.05} <= rates
    assert module.recipe["seed"] == 0


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
