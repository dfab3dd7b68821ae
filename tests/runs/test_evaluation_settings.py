"""What an evaluation takes from the command line, and what from the weights."""

from __future__ import annotations

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from uncal.runs.assembly import RECIPE
from uncal.runs.evaluation_settings import NOTHING_TRAINS, focal_of, with_settings_of
from uncal.settings.configuration import CONFIG_DIR


def composed(name: str, *words: str) -> DictConfig:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        return compose(name, list(words))


@pytest.fixture(scope="module")
def recipe() -> DictConfig:
    """Of weights trained in another way than by default."""
    config = composed("train", "mcd.passes=7", "dataset.stride=3", "split.by=drive", "seed=5")
    whole = OmegaConf.to_container(config, resolve=False)
    assert isinstance(whole, dict)
    whole["callbacks"] = whole["trainer"] = whole["logger"] = None
    plain = OmegaConf.to_container(OmegaConf.create(whole), resolve=True)
    assert isinstance(plain, dict)
    return OmegaConf.create({key: plain[key] for key in RECIPE})


def asked(recipe: DictConfig, *words: str) -> DictConfig:
    return with_settings_of(composed("evaluate", *words), recipe, words, RECIPE)


def test_nothing_asked_is_as_trained(recipe: DictConfig) -> None:
    run = asked(recipe)
    for key in RECIPE:
        assert run[key] == recipe[key], key


def test_a_key_replaces_that_key_alone(recipe: DictConfig) -> None:
    run = asked(recipe, "mcd.masks=fixed", "window.frames=4")
    assert (run.mcd.masks, run.mcd.passes, run.window.frames) == ("fixed", 7, 4)
    assert run.dataset == recipe.dataset


def test_a_group_replaces_the_whole_group(recipe: DictConfig) -> None:
    run = asked(recipe, "interval=gaussian")
    assert "Gaussian" in run.interval.calibrator._target_
    assert run.mcd == recipe.mcd


def test_other_recordings_bring_their_split_and_keep_the_focal_length(recipe: DictConfig) -> None:
    run = asked(recipe, "dataset=kitti", "dataset.root=/data/kitti", "split.by=frame")
    assert (run.dataset.name, run.dataset.recording.root) == ("kitti", "/data/kitti")
    assert run.dataset.focal_px == focal_of(recipe) == 230.0
    assert run.dataset.image_size is None
    assert run.split.by == "frame"
    assert tuple(run.split.fractions) == NOTHING_TRAINS
    assert run.model == recipe.model
    assert run.seed == 5


def test_shares_and_sizes_that_are_asked_for_are_kept(recipe: DictConfig) -> None:
    words = ("dataset=kitti", "split.fractions=[0.1,0.1,0.4,0.4]", "dataset.image_size=[96,320]")
    run = asked(recipe, *words)
    assert list(run.split.fractions) == [0.1, 0.1, 0.4, 0.4]
    assert list(run.dataset.image_size) == [96, 320]


def test_the_root_of_the_same_recordings_may_move(recipe: DictConfig) -> None:
    run = asked(recipe, "dataset.root=/elsewhere")
    assert run.dataset.recording.root == "/elsewhere"
    assert run.dataset.stride == 3
