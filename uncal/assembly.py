"""From a configuration to the objects of a run; shared by the entry points."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import lightning
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from uncal.data.datamodule import CalibrationDataModule
from uncal.errors import ConfigurationError
from uncal.models.module import CalibrationModule
from uncal.recordings.frame import Recording
from uncal.simulation.cache import ensure_simulated
from uncal.simulation.settings import SimulationSettings

log = logging.getLogger(__name__)

RECIPE = ("seed", "dataset", "model", "split", "mcd", "interval", "decalibration", "augmentation")
"""The parts of a configuration that a checkpoint carries: what another process needs to use it."""


def build_data(config: DictConfig) -> CalibrationDataModule:
    """Find the recording (simulate it first if it is a simulated one) and split it.

    Args:
        config: the run's configuration.

    Returns:
        The data module.

    Raises:
        UncalError: the recording or a setting cannot be used; the message says which and why.
    """
    dataset = config.dataset
    if "simulation" in dataset:
        plain = OmegaConf.to_container(dataset.simulation, resolve=True)
        settings = SimulationSettings.from_mapping(cast(Mapping[str, object], plain))
        ensure_simulated(settings, Path(dataset.root))
    recording: Recording = instantiate(dataset.recording)
    log.info("%s data: %d frames in %s", dataset.label, len(recording.frame_ids), dataset.root)
    return CalibrationDataModule(
        recording=recording,
        image_size=image_size(dataset.image_size),
        decalibration=instantiate(config.decalibration),
        split=instantiate(config.split),
        loader=instantiate(dataset.loader),
        inputs=instantiate(config.model.inputs),
        augmentation=instantiate(config.augmentation),
        seed=config.seed,
    )


def build_module(config: DictConfig) -> CalibrationModule:
    """Make the network and the LightningModule around it, untrained.

    Args:
        config: the run's configuration.

    Returns:
        The module; its ``recipe`` goes into every checkpoint.

    Raises:
        ConfigurationError: a setting is unknown or out of its range.
    """
    model = config.model
    refuse_unknown("mcd", config.mcd, ("passes", "chunk"))
    refuse_unknown("interval", config.interval, ("levels", "sigma_floor"))
    inputs = instantiate(model.inputs)
    module = CalibrationModule(
        network=instantiate(model.network, in_channels=inputs.n_channels),
        decalibration=instantiate(config.decalibration),
        optimizer=instantiate(model.optimization.optimizer),
        warmup_fraction=model.optimization.warmup_fraction,
        displacement_weight=model.displacement_weight,
        ridge=model.ridge,
        passes=config.mcd.passes,
        chunk=config.mcd.chunk,
        sigma_floor=config.interval.sigma_floor,
        seed=config.seed,
    )
    module.recipe = cast(
        "dict[str, object]",
        {key: _plain(config[key]) for key in RECIPE},
    )
    return module


def build_trainer(config: DictConfig) -> lightning.Trainer:
    """Make the trainer with the configured callbacks and loggers.

    Validations are spread evenly and always include the last epoch.

    Args:
        config: the run's configuration.

    Returns:
        The trainer.
    """
    epochs = config.trainer.max_epochs
    every = validation_interval(epochs, config.dataset.validations)
    trainer: lightning.Trainer = instantiate(
        config.trainer,
        callbacks=[instantiate(callback) for callback in config.callbacks.values() if callback],
        logger=instantiate(config.logger),
        check_val_every_n_epoch=every,
    )
    return trainer


def refuse_unknown(name: str, section: DictConfig, known: Sequence[str]) -> None:
    """Catch keys that ``+name.key=value`` added although nothing reads them.

    Args:
        name: of the section.
        section: of the configuration.
        known: the keys that are read.

    Raises:
        ConfigurationError: another key is there.
    """
    unknown = [str(key) for key in section if key not in known]
    if unknown:
        raise ConfigurationError(
            f"{', '.join(f'{name}.{key}' for key in unknown)}: nothing reads this; "
            f"{name} has {', '.join(known)}"
        )


def validation_interval(epochs: int, validations: int) -> int:
    """Smallest interval that divides the epochs and makes no more validations than asked for.

    Args:
        epochs: epochs of the training.
        validations: how many validations at most.

    Returns:
        Epochs from one validation to the next.

    Raises:
        ConfigurationError: one of the two is not positive.

    >>> validation_interval(24, 4), validation_interval(7, 4), validation_interval(1, 4)
    (6, 7, 1)
    """
    if epochs < 1 or validations < 1:
        raise ConfigurationError(
            f"trainer.max_epochs={epochs}, dataset.validations={validations}: "
            "both must be at least 1"
        )
    return next(n for n in range(1, epochs + 1) if epochs % n == 0 and epochs // n <= validations)


def image_size(value: object) -> tuple[int, int]:
    """Check a configured image size.

    Args:
        value: what the configuration says.

    Returns:
        (H, W) in pixels.

    Raises:
        ConfigurationError: not two integers of at least 32.
    """
    numbers = list(cast("list[int]", value)) if OmegaConf.is_list(value) else []
    if len(numbers) != 2 or any(not isinstance(n, int) or n < 32 for n in numbers):
        raise ConfigurationError(
            f"dataset.image_size={value}: expected [H, W], two integers of at least 32 pixels"
        )
    return numbers[0], numbers[1]


def _plain(value: object) -> object:
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
