"""Every key has a reader, or the run does not begin."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, open_dict

from uncal.configuration import CONFIG_DIR
from uncal.errors import ConfigurationError
from uncal.settings.readers import refuse_unread
from uncal.settings.shipped import shipped_config

SWEEPS = sorted(path.stem for path in (Path(CONFIG_DIR).parent / "sweeps").glob("*.yaml"))


def check(name: str, *overrides: str) -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose(name, list(overrides), return_hydra_config=True)
    choices = {str(k): v for k, v in config.hydra.runtime.choices.items() if isinstance(v, str)}
    with open_dict(config):
        config.pop("hydra")
    refuse_unread(config, shipped_config(name, choices))


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["dataset=demo_events", "interval=hierarchical"],
        ["dataset=dsec", "model/backbone=mobilevit_s", "model/head=mlp"],
        ["dataset=kitti_odometry", "logger=null", "callbacks.overlays=null"],
        ["mcd.insert={after: [Linear], p: 0.1, exclude: [head.2]}"],
        ["+callbacks.stop._target_=lightning.pytorch.callbacks.EarlyStopping"],
        ["+trainer.limit_train_batches=3", "+trainer.callbacks=null"],
        ["+sweeps/network=no_dropout"],
        ["+model.optimization.optimizer.amsgrad=true"],
        ["+width=7", "model.ridge=${width}"],
        ["model.optimization.optimizer={_target_: torch.optim.SGD, lr: 0.1, _partial_: true}"],
        *(["+sweeps=" + name] for name in SWEEPS),
    ],
)
def test_what_is_read_passes(overrides: list[str]) -> None:
    check("train", *overrides)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("+sweps=passes", "sweps: nothing reads this key"),
        ("+seeds=1", "did you mean seed?"),
        ("+mcd.passs=5", r"mcd\.passs: .* did you mean mcd\.passes\?"),
        ("+head_dropout=0.1", r"did you mean model\.head_dropout\?"),
        ("+dataset.strid=2", r"did you mean dataset\.stride\?"),
        ("+dataset.simulation.lidar.beem=2", r"did you mean dataset\.simulation\.lidar\.beams\?"),
        ("+dataset.zzz=2", r"dataset\.zzz: nothing reads this key; dataset has .*camera"),
        ("+dataset.recording.stridee=2", r"KittiRaw does not take it; .*recording\.stride\?"),
        ("+trainer.max_epoch=2", r"Trainer does not take it; did you mean trainer\.max_epochs\?"),
        ("+model.optimization.optimizer.lrr=1", r"AdamW does not take it; .*optimizer\.lr\?"),
        ("+model.network.windw=1", r"does not take it; did you mean model\.network\.window\?"),
        ("+callbacks.stop.patience=1", r"callbacks\.stop\.patience: nothing reads this key"),
        ("+callbacks.stop=null", r"callbacks\.stop: nothing reads this key"),
        ("+split.fraction=1", r"did you mean split\.fractions\?"),
        ("+decalibration.rotation=1", "does not take it"),
        ("+interval.level=[0.9]", r"did you mean interval\.levels\?"),
        ("model.optimization.optimizer._target_=torch.optim.Adan", "cannot be imported"),
    ],
)
def test_what_nothing_reads_is_refused_with_the_nearest_key(override: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        check("train", override)


def test_all_of_them_are_named_at_once() -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)seeds: .*mcd\.passs: "):
        check("train", "+mcd.passs=5", "+seeds=1")


def test_evaluation_refuses_what_nothing_reads() -> None:
    with pytest.raises(ConfigurationError, match=r"mcd\.pass: .* did you mean mcd\.passes\?"):
        check("evaluate", "ckpt=best.ckpt", "+mcd.pass=4")


def test_evaluation_takes_what_it_documents() -> None:
    check("evaluate", "ckpt=best.ckpt", "mcd.passes=50", "interval=hierarchical")
    check("evaluate", "ckpt=best.ckpt", "+sweeps=passes", "store=outputs/trained")


def test_benchmark_and_simulation_refuse_too() -> None:
    check("benchmark", "+cases.mine={name: mine, size: [8, 8], batches: [1], model: []}")
    with pytest.raises(ConfigurationError, match=r"cases\.mine\.sizes: .*cases"):
        check("benchmark", "+cases.mine={name: mine, sizes: [8, 8], batches: [1], model: []}")
    with pytest.raises(ConfigurationError, match=r"did you mean simulation\.n_rigs\?"):
        check("simulate", "+simulation.nrigs=3")
    with pytest.raises(ConfigurationError, match=r"worker: .*did you mean workers\?"):
        check("simulate", "+worker=3")


def test_a_file_of_the_users_own_may_not_invent_keys(tmp_path: Path) -> None:
    (tmp_path / "dataset").mkdir()
    (tmp_path / "dataset" / "mine.yaml").write_text(
        "defaults: [kitti, _self_]\nname: mine\nlebel: mine\n"
    )
    search = f"hydra.searchpath=[file://{tmp_path}]"
    with pytest.raises(ConfigurationError, match=r"dataset\.lebel: .*did you mean dataset\.label"):
        check("train", search, "dataset=mine")


def test_outside_hydra_there_is_no_job() -> None:
    from uncal.settings.shipped import shipped_for_this_job

    HydraConfig.instance().cfg = None
    assert shipped_for_this_job() is None


def test_choices_that_do_not_ship_fall_back_to_the_default() -> None:
    config: DictConfig = shipped_config("train", {"dataset": "mine", "model/backbone": "theirs"})
    assert config.dataset.name == "demo"
