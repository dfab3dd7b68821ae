"""Every value within its bounds, or the run does not begin; all faults are named at once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from uncal.errors import ConfigurationError
from uncal.settings.bounds import BOUNDS
from uncal.settings.check import refuse_removed, refuse_values
from uncal.settings.configuration import CONFIG_DIR

Configured = Callable[..., tuple[DictConfig, DictConfig]]


def faults(config: DictConfig, shipped: DictConfig) -> dict[str, str]:
    """Key=value → the rest of the sentence."""
    with pytest.raises(ConfigurationError) as refused:
        refuse_values(config, shipped)
    lines = str(refused.value).splitlines()
    return dict(line.split(": ", 1) for line in lines)


WRONG = {
    "seed=-1": "a whole number from 0 to 4294967295; the default is 0",
    "retrain=maybe": "true or false; the default is false",
    "store=5": "text that is not empty",
    "window.frames=0": "a whole number from 1 to 1000; the default is 1",
    "decalibration.rotation_deg=abc": "a number above 0 and up to 45",
    "decalibration.translation_cm=-1": "a number above 0 and up to 1000",
    "augmentation.mirror=2": "a number from 0 to 1; the default is 0.5",
    "augmentation.brightness=-0.1": "a number of at least 0 and below 1",
    "mcd.passes=1.5": "a whole number from 1 to 10000; the default is 25",
    "mcd.strategy=fast": "auto or shared or batch or loop",
    "mcd.masks=true": "random or fixed",
    "mcd.chunk=0": "a whole number from 1 to 1000000 or auto or null",
    "mcd.layers=head": "a list of one or more, each text",
    "interval.levels=[]": "a list of one or more, each a number above 0 and below 1",
    "interval.sigma_floor=-1": "a number from 0 to 1",
    "interval.quantile_levels=[0.9,0.1]": "a list of 2, each a number above 0 and below 1, rising",
    "interval.groups=car": "rig or drive",
    "dataset.stride=0": "a whole number from 1 to 1000000; the default is 1",
    "dataset.image_size=[80]": "a list of 2, each a whole number from 32 to 4096 or null",
    "dataset.validations=0": "a whole number from 1 to 1000000",
    "dataset.root=''": "text that is not empty",
    "dataset.loader.batch_size=0": "a whole number from 1 to 65536; the default is 16",
    "dataset.loader.workers=-2": "a whole number from 0 to 256; the default is 0",
    "dataset.loader.cache=1": "true or false",
    "split.by=street": "frame or block or drive or rig or official",
    "split.fractions=[0.5,0.2,0.2,0.2]": "a list of 4, each a number from 0 to 1, that sum to 1",
    "split.unseen_rigs=1": "a number of at least 0 and below 1",
    "split.train_frames=0": "a whole number from 1 to 1000000 or null",
    "model.head_dropout=1.0": "a number of at least 0 and below 1; the default is 0.05",
    "model.backbone_dropout=1.5": "a number of at least 0 and below 1; the default is 0.25",
    "model.optimization.warmup_fraction=2": "a number from 0 to 1",
    "model.optimization.optimizer.lr=0": "a number above 0 and up to 1e+09",
    "model.inputs=5": "a group of keys",
    "trainer.max_epochs=abc": "a whole number from 1 to 1000000",
    "trainer.gradient_clip_val=.nan": "a number from 0 to 1000000000 or null",
    "trainer.enable_model_summary=5": "true or false",
    "callbacks.overlays.frames=-1": "a whole number from 0 to 10000; the default is 3",
    "callbacks.interval_overlays.dof=Nod": "X or Y or Z or Roll or Pitch or Yaw",
    "callbacks.interval_overlays.level=90": "a number above 0 and below 1",
    "callbacks.checkpoint.monitor=loss": "loss/train or loss/validation or relative error/mean",
    "callbacks.uncertainty.monitored=0": "a whole number from 1 to 1000000 or null",
}
"""What a user may type, and what the message expects instead."""


def test_all_faults_are_named_at_once_with_value_and_what_was_expected(
    configured: Configured,
) -> None:
    found = faults(*configured("train", *WRONG))
    for override, expected in WRONG.items():
        key, value = override.split("=", 1)
        # As YAML shows it.
        shown = {"''": '""', ".nan": "nan"}.get(value, value.replace(",", ", "))
        assert found[f"{key}={shown}"].startswith(f"expected {expected}"), override
    assert len(found) == len(WRONG)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["interval.levels=[1.0]"], r"interval\.levels=\[1\.0\]: expected a list .* below 1"),
        (["interval.levels=[0.9,0.9]"], "all different"),
        (["interval.levels=0.9"], "expected a list"),
        (["model.optimization.optimizer.lr=.inf"], r"lr=inf: expected"),
        (["callbacks.report=null"], "callbacks.report=null: the run has no result without it"),
        (["callbacks.checkpoint=null"], "nothing would be kept"),
        (["callbacks=null"], "callbacks=null: expected a group"),
        (["split.fractions=[0.7,0.2,0.1,0.0]"], "each need a share above 0"),
        (["split=null"], "split=null: expected a group"),
        (["dataset.simulation=null"], "dataset.simulation=null: expected a group"),
        (["mcd.passes=null"], "mcd.passes=null: expected a whole number"),
        (["mcd.passes=${nowhere}"], "mcd.passes: Interpolation key 'nowhere' not found"),
        (["dataset.recording.camera=5"], "KittiRaw expects str"),
        (["mcd.insert={after: Linear, p: 2}"], r"insert.p=2: expected a number above 0"),
        (["model.network.widths=[a]"], "widths.*: expected a list"),
        (["trainer.limit_val_batches=0"], "limit_val_batches=0: expected a number above 0"),
        (["trainer.fast_dev_run=true"], "fast_dev_run: keeps no checkpoint"),
    ],
)
def test_refusals(configured: Configured, words: list[str], said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        refuse_values(*configured("train", *words))


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ([], ["callbacks.overlays=null", "logger=null", "store=null", "model.start=null"]),
        ([], ["trainer.gradient_clip_val=null", "trainer.devices=auto", "trainer.precision=16"]),
        ([], ["split.test=unseen", "split.fractions=[0.7,0.15,0.15,0.0]", "trainer.devices=[0]"]),
        ([], ["mcd.insert={after: [Linear], p: 0.1}", "mcd.chunk=null", "mcd.layers=[head]"]),
        ([], ["mcd.passes=${window.frames}", "trainer.max_epochs=3", "dataset.image_size=null"]),
        ([], ["trainer.limit_train_batches=0.5", "dataset.drives=2011_09_26/0001"]),
        (["dataset=demo_events", "interval=hierarchical"], ["dataset.sequences=[zurich_city_0*]"]),
        (["model=edges"], []),
        ([], ["model.start.network.surround=[4.0,4,2.5]"]),
        (["model=edges"], ["model.network.surround=[0,4,2.5]"]),
    ],
)
def test_what_is_right_passes(configured: Configured, choices: list[str], words: list[str]) -> None:
    refuse_values(*configured("train", *words, choices=choices))


def test_what_a_run_reads_cannot_be_taken_away(configured: Configured) -> None:
    _, shipped = configured("train")
    fine = ["~logger", "~callbacks.overlays", "~model.optimization.optimizer.weight_decay", "a=1"]
    refuse_removed(fine, shipped)
    wrong = ["~mcd.passes", "~seed", "~dataset", "~model/head", "~callbacks.report"]
    with pytest.raises(ConfigurationError) as refused:
        refuse_removed([*fine, *wrong], shipped)
    assert [line.split(":")[0] for line in str(refused.value).splitlines()] == wrong


def test_other_entry_points(configured: Configured) -> None:
    refuse_values(*configured("evaluate", "weights=unical", "mcd.passes=50"))
    refuse_values(*configured("benchmark", "cases=null", "ckpt=best.ckpt"))
    refuse_values(*configured("benchmark", "cases.s=null"))
    found = faults(*configured("benchmark", "device=tpu", "passes=0", "compile=5", "rounds=abc"))
    assert set(found) == {"device=tpu", "passes=0", "compile=5", "rounds=abc"}
    found = faults(*configured("simulate", "workers=0", "progress=5"))
    assert set(found) == {"workers=0", "progress=5"}


def test_without_the_shipped_configuration_the_bounds_still_count() -> None:
    config = OmegaConf.create({"mcd": {"passes": 0}, "anything": "else"})
    with pytest.raises(ConfigurationError, match=r"mcd\.passes=0: expected a whole number"):
        refuse_values(config, None)


def test_every_bound_is_of_a_key_that_ships() -> None:
    """A key that was renamed must not leave its bounds behind."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in Path(CONFIG_DIR).rglob("*.yaml"))
    for key in BOUNDS:
        last = key.rpartition(".")[2].strip("*")
        known = f"{last}:" in text or f"{last}=" in text or key in NOT_IN_YAML
        assert known, key


NOT_IN_YAML = {
    *("mcd.insert.after", "mcd.insert.exclude", "mcd.insert.p", "dataset.focal_px"),
    "trainer.limit_*_batches",
}
"""Keys under one that ships as null, or that an evaluation sets."""
