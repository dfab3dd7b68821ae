"""Every key has a reader, or the run does not begin."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uncal.errors import ConfigurationError
from uncal.settings.configuration import CONFIG_DIR
from uncal.settings.readers import refuse_unread
from uncal.settings.shipped import shipped_config, shipped_for_this_job

Configured = Callable[..., tuple[DictConfig, DictConfig]]


@pytest.mark.parametrize(
    "choices",
    [
        ["dataset=demo_events", "interval=hierarchical"],
        ["dataset=dsec", "model/backbone=mobilevit_s", "model/head=mlp", "~logger"],
        ["+sweeps=passes", "+model.optimization.optimizer.amsgrad=true"],
        ["+sweeps/network=no_dropout", "dataset=kitti_odometry", "callbacks.overlays=null"],
    ],
)
def test_what_the_shipped_groups_bring_is_read(configured: Configured, choices: list[str]) -> None:
    refuse_unread(*configured("train", choices=choices))


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["mcd.insert={after: [Linear], p: 0.1, exclude: [head.2]}"],
        ["callbacks.stop={_target_: lightning.pytorch.callbacks.EarlyStopping, patience: 3}"],
        ["trainer.limit_train_batches=3", "model.optimization.optimizer.amsgrad=true"],
        ["width=7", "model.displacement_weight=${width}"],
        ["model.optimization.optimizer={_target_: torch.optim.SGD, lr: 0.1, _partial_: true}"],
    ],
)
def test_what_is_read_passes(configured: Configured, words: list[str]) -> None:
    refuse_unread(*configured("train", *words))


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("sweeps=passes", "sweeps: nothing reads this key"),
        ("seeds=1", r"did you mean seed\?"),
        ("mcd.passs=5", r"mcd\.passs: .* did you mean mcd\.passes\?"),
        ("head_dropout=0.1", r"did you mean model\.head_dropout\?"),
        ("dataset.strid=2", r"did you mean dataset\.stride\?"),
        ("dataset.simulation.lidar.beem=2", r"did you mean dataset\.simulation\.lidar\.beams\?"),
        ("dataset.zzz=2", r"dataset\.zzz: nothing reads this key; dataset has .*camera"),
        ("dataset.recording.stridee=2", r"KittiRaw does not take it; .*recording\.stride\?"),
        ("trainer.max_epoch=2", r"Trainer does not take it; did you mean trainer\.max_epochs\?"),
        ("model.optimization.optimizer.lrr=1", r"AdamW does not take it; .*optimizer\.lr\?"),
        ("model.network.windw=1", r"does not take it; did you mean model\.network\.window\?"),
        ("callbacks.stop.patience=1", r"callbacks\.stop\.patience: nothing reads this key"),
        ("callbacks.stop=null", r"callbacks\.stop: nothing reads this key"),
        ("split.fraction=1", r"did you mean split\.fractions\?"),
        ("decalibration.rotation=1", "does not take it"),
        ("interval.level=[0.9]", r"did you mean interval\.levels\?"),
        ("model.optimization.optimizer._target_=torch.optim.Adan", "cannot be imported"),
    ],
)
def test_what_nothing_reads_is_refused_with_the_nearest_key(
    configured: Configured, word: str, said: str
) -> None:
    with pytest.raises(ConfigurationError, match=said):
        refuse_unread(*configured("train", word))


def test_all_of_them_are_named_at_once(configured: Configured) -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)mcd\.passs: .*seeds: "):
        refuse_unread(*configured("train", "mcd.passs=5", "seeds=1"))


def test_evaluation_refuses_what_nothing_reads(configured: Configured) -> None:
    refuse_unread(*configured("evaluate", "weights=unical", "mcd.passes=50"))
    with pytest.raises(ConfigurationError, match=r"mcd\.pass: .* did you mean mcd\.passes\?"):
        refuse_unread(*configured("evaluate", "mcd.pass=4"))


def test_benchmark_and_simulation_refuse_too(configured: Configured) -> None:
    mine = "cases.mine={name: mine, size: [8, 8], batches: [1], model: []}"
    refuse_unread(*configured("benchmark", mine))
    with pytest.raises(ConfigurationError, match=r"cases\.mine\.sizes: .*cases"):
        refuse_unread(*configured("benchmark", mine.replace("size:", "sizes:")))
    with pytest.raises(ConfigurationError, match=r"did you mean simulation\.n_rigs\?"):
        refuse_unread(*configured("simulate", "simulation.nrigs=3"))
    with pytest.raises(ConfigurationError, match=r"worker: .*did you mean workers\?"):
        refuse_unread(*configured("simulate", "worker=3"))


def test_a_file_of_the_users_own_may_not_invent_keys(tmp_path: Path) -> None:
    (tmp_path / "dataset").mkdir()
    (tmp_path / "dataset" / "mine.yaml").write_text(
        "defaults: [kitti, _self_]\nname: mine\nlebel: mine\n"
    )
    search = f"hydra.searchpath=[file://{tmp_path}]"
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose("train", [search, "dataset=mine"])
    with pytest.raises(ConfigurationError, match=r"dataset\.lebel: .*did you mean dataset\.label"):
        refuse_unread(config, shipped_config("train", {"dataset": "mine"}))


def test_outside_hydra_there_is_no_job() -> None:
    HydraConfig.instance().cfg = None
    assert shipped_for_this_job() is None


def test_choices_that_do_not_ship_fall_back_to_the_default() -> None:
    config = shipped_config("train", {"dataset": "mine", "model/backbone": "theirs"})
    assert config.dataset.name == "demo"
