"""Everything that decides what trained weights are, and what a stochastic pass of them gives."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import cast

import lightning
from omegaconf import DictConfig, OmegaConf

from uncal.data.datamodule import CalibrationDataModule
from uncal.models.module import CalibrationModule
from uncal.weights.digest import (
    INFERENCE_CODE,
    TRAINING_CODE,
    digest_of_code,
    digest_of_files,
    digest_of_names,
    digest_of_network,
)

LOOK_ON: tuple[str, ...] = (
    "uncal.callbacks.",
    "lightning.pytorch.callbacks.LearningRateMonitor",
    "lightning.pytorch.callbacks.ModelCheckpoint",
)
"""Callbacks that change nothing that is learnt: those of this package, by where they live, and two
of Lightning's. Any other, such as early stopping, may."""

NOT_LEARNT: tuple[str, ...] = (
    "default_root_dir",
    "enable_model_summary",
    "enable_progress_bar",
    "log_every_n_steps",
    "accelerator",
    "devices",
)
"""Settings of the trainer that change no weights, or that device and processes stand for."""


def data_ingredients(config: DictConfig, data: CalibrationDataModule) -> dict[str, object]:
    """What training and passes have in common; looks at every file of the recordings, once."""
    recording = _plain(config.dataset.recording)
    recording.pop("root", None)
    return {
        "files": digest_of_files(Path(config.dataset.root)),
        "recording": recording,
        "image size": list(data.image_size),
        "focal length": config.dataset.get("focal_px"),
        "decalibration": _plain(config.decalibration),
    }


def training_ingredients(
    config: DictConfig,
    data: CalibrationDataModule,
    module: CalibrationModule,
    trainer: lightning.Trainer,
    shared: Mapping[str, object],
) -> dict[str, object]:
    """Everything that decides what a training learns.

    What changes only the inference is left out: passes, masks, interval method, levels, and who
    calibrates the uncertainty or tests.

    Returns:
        Plain values; the same on every machine for the same data, settings and versions.
    """
    trainer_settings = _plain(config.trainer)
    callbacks = _plain(config.callbacks)
    checkpoint = callbacks.get("checkpoint")
    monitored = checkpoint.get("monitor") if isinstance(checkpoint, dict) else None
    return {
        **shared,
        "training frames": digest_of_names(data.splits["train"]),
        "validation frames": digest_of_names(data.splits["validation"]),
        "seed": config.seed,
        "model": _plain(config.model),
        "inserted dropout": _plain(config.mcd.insert) if config.mcd.insert else None,
        "quantile levels": list(config.interval.quantile_levels),
        "augmentation": _plain(config.augmentation),
        "batch size": config.dataset.loader.batch_size,
        "validations": config.dataset.validations,
        "chosen by": monitored,
        "trainer": {k: v for k, v in trainer_settings.items() if k not in NOT_LEARNT},
        "device": trainer.strategy.root_device.type,
        "processes": trainer.world_size,
        "callbacks": {k: v for k, v in callbacks.items() if v and not _looks_on(v)},
        "code": digest_of_code(TRAINING_CODE),
        "network code": dict(digest_of_network(module.estimator)),
        "versions": _versions(),
    }


def pass_ingredients(
    config: DictConfig,
    module: CalibrationModule,
    trainer: lightning.Trainer,
    shared: Mapping[str, object],
) -> dict[str, object]:
    """All but their number that decides what the stochastic passes of trained weights give."""
    identity = module.engine.identity()
    return {
        **shared,
        "weights": identity.weights,
        "rates": list(identity.rates),
        "layers": None if config.mcd.layers is None else list(config.mcd.layers),
        "strategy": config.mcd.strategy,
        "chunk": config.mcd.chunk,
        "seeds": [config.seed, config.mcd.seed],
        "model": _plain(config.model),
        # Passes go on from an estimate that all frames of a window share.
        "window": _plain(config.window),
        "precision": str(config.trainer.precision),
        "device": trainer.strategy.root_device.type,
        "code": digest_of_code(INFERENCE_CODE),
        "network code": dict(digest_of_network(module.estimator)),
        "versions": _versions(),
    }


def _looks_on(callback: object) -> bool:
    return isinstance(callback, dict) and str(callback.get("_target_")).startswith(LOOK_ON)


def _versions() -> Mapping[str, str]:
    return {name: version(name) for name in ("torch", "lightning", "transformers")}


def _plain(section: DictConfig) -> dict[str, object]:
    return cast("dict[str, object]", OmegaConf.to_container(section, resolve=True))
