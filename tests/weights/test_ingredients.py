from pathlib import Path
from types import SimpleNamespace
from typing import cast

import lightning
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, open_dict

from uncal.data.datamodule import CalibrationDataModule
from uncal.recordings.frame import FrameId
from uncal.runs.assembly import build_module
from uncal.settings.configuration import CONFIG_DIR
from uncal.weights.digest import digest_of
from uncal.weights.ingredients import (
    data_ingredients,
    pass_ingredients,
    training_ingredients,
)

FRAMES = [FrameId("rig", "drive", index) for index in range(8)]


def composed(root: Path, *overrides: str) -> DictConfig:
    """A training's configuration, with folders that Hydra would otherwise fill in."""
    folders = ["overlays.folder", "report.folder", "figures.folder", "interval_overlays.folder"]
    folders += ["checkpoint.dirpath", "last.dirpath"]
    filled = [f"callbacks.{key}={root}/run" for key in folders]
    filled += [f"dataset.root={root}/data", f"trainer.default_root_dir={root}/run"]
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        return compose("train", [*filled, *overrides])


def data_of(config: DictConfig, training: list[FrameId]) -> CalibrationDataModule:
    splits = {"train": training, "validation": FRAMES[6:7], "test": FRAMES[7:]}
    image_size = tuple(config.dataset.image_size)
    return cast(CalibrationDataModule, SimpleNamespace(splits=splits, image_size=image_size))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("ingredients")
    (root / "data").mkdir()
    (root / "data" / "scan.bin").write_bytes(b"1234")
    return root


@pytest.fixture(scope="module")
def shipped(root: Path) -> str:
    """Digest of a training as it ships."""
    return training(root)


def training(root: Path, *overrides: str, frames: int = 6) -> str:
    """Digest of what a training with these overrides learns from."""
    config = composed(root, *overrides)
    trainer = lightning.Trainer(accelerator="cpu", logger=False, enable_checkpointing=False)
    data = data_of(config, FRAMES[:frames])
    shared = data_ingredients(config, data)
    return digest_of(training_ingredients(config, data, build_module(config), trainer, shared))


@pytest.mark.parametrize(
    "inference",
    [
        "mcd.passes=50",
        "mcd.masks=fixed",
        "mcd.seed=7",
        "mcd.layers=['*evidence*']",
        "interval=gaussian",
        "interval=absolute",
        "interval.levels=[0.5]",
        "interval.sigma_floor=1e-3",
        "split.test=unseen",
        "dataset.loader.workers=3",
        "dataset.loader.eval_batch_size=3",
        "dataset.label=other",
        "callbacks.overlays.frames=9",
        "callbacks.control=null",
        "callbacks.figures=null",
        "trainer.log_every_n_steps=1",
    ],
)
def test_what_changes_only_the_inference_does_not_retrain(
    root: Path, shipped: str, inference: str
) -> None:
    assert training(root, inference) == shipped


@pytest.mark.parametrize(
    "learnt",
    [
        "seed=1",
        "model.head_dropout=0.5",
        "model.optimization.optimizer.lr=1e-5",
        "model/head=mlp",
        "model/head=quantile",
        "interval.quantile_levels=[0.1,0.9]",
        "mcd.insert={after: [Conv2d], p: 0.1}",
        "trainer.max_epochs=3",
        "trainer.precision=bf16-mixed",
        "+trainer.accumulate_grad_batches=2",
        "dataset.loader.batch_size=3",
        "dataset.image_size=[96,208]",
        "dataset.camera=image_03",
        "decalibration.rotation_deg=2",
        "augmentation.mirror=0",
        "callbacks.checkpoint.monitor=loss/validation",
        "+callbacks.stop._target_=lightning.pytorch.callbacks.EarlyStopping",
    ],
)
def test_what_changes_the_training_retrains(root: Path, shipped: str, learnt: str) -> None:
    assert training(root, learnt) != shipped


def test_other_training_frames_or_another_file_retrain(root: Path, shipped: str) -> None:
    assert training(root) == shipped
    assert training(root, frames=5) != shipped
    scan = root / "data" / "another.bin"
    scan.write_bytes(b"1234")
    before = training(root)
    assert before != shipped
    scan.write_bytes(b"12345")
    assert training(root) not in (before, shipped)
    scan.unlink()


def test_the_callbacks_that_ship_only_look_on(root: Path, shipped: str) -> None:
    config = composed(root)
    assert {"report", "checkpoint", "learning_rate"} <= set(config.callbacks)
    for name in set(config.callbacks) - {"checkpoint"}:  # what it monitors counts
        assert training(root, f"~callbacks.{name}") == shipped, name


@pytest.mark.parametrize(
    ("override", "same"),
    [
        ("interval=gaussian", True),
        ("mcd.passes=7", True),
        ("mcd.seed=7", False),
        ("mcd.layers=['*evidence*']", False),
        ("mcd.strategy=loop", False),
    ],
)
def test_passes_are_known_by_what_decides_them(root: Path, override: str, same: bool) -> None:
    trainer = lightning.Trainer(accelerator="cpu", logger=False, enable_checkpointing=False)
    found = []
    for overrides in ([], [override]):
        config = composed(root, *overrides)
        module = build_module(config)
        with open_dict(config):
            # The same weights: made with one seed of torch, not with the run's.
            for parameter in module.parameters():
                parameter.data.zero_()
        shared = data_ingredients(config, data_of(config, FRAMES))
        found.append(digest_of(pass_ingredients(config, module, trainer, shared)))
    assert (found[0] == found[1]) == same
