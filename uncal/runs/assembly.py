"""From a configuration to the objects of a run; shared by the entry points."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import lightning
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from torch import nn

from uncal.data.datamodule import CalibrationDataModule
from uncal.data.image_size import size_at_focal
from uncal.data.network_input import CAMERAS, InputSettings
from uncal.errors import ConfigurationError, FrameError, RecordingError
from uncal.geometry.decalibration import DecalibrationRange
from uncal.inference.inference_settings import (
    DropoutSettings,
    IntervalSettings,
    choice,
    read_settings,
)
from uncal.models.alignment import AlignmentEstimator
from uncal.models.edge_alignment import EdgeAlignment, EdgeAlignmentEstimator
from uncal.models.estimator import PoseEstimator
from uncal.models.evidence import EvidenceNetwork
from uncal.models.module import CalibrationModule
from uncal.recordings.frame import Recording
from uncal.runs.checkpoint import WholeCheckpoints
from uncal.settings.guard import names_the_setting
from uncal.simulation.manifest import MANIFEST_NAME
from uncal.simulation.settings import SimulationSettings
from uncal.simulation.writer import ensure_simulated
from uncal.uncertainty.dropout.layers import dropout_rates, insert_dropout

log = logging.getLogger(__name__)

MODELS = {"rgb": "unical", "events": "muliev"}
DATASETS = {"rgb": "demo, kitti or kitti_odometry", "events": "demo_events or dsec"}
"""What to choose for a camera, for messages."""

RECIPE = (
    *("seed", "dataset", "model", "split", "mcd", "interval", "window", "decalibration"),
    "augmentation",
)
"""The parts of a configuration that a checkpoint carries: what another process needs to use it."""


def build_data(config: DictConfig) -> CalibrationDataModule:
    """Find the recording (simulate it first if it is a simulated one) and split it.

    Raises:
        UncalError: the recording or a setting cannot be used; the message says which and why.
    """
    dataset = config.dataset
    inputs: InputSettings = instantiate(config.model.inputs)
    check_pairing(config, inputs)
    # Made before the recordings are, so that what they refuse costs nothing.
    decalibration, split = instantiate(config.decalibration), instantiate(config.split)
    loader, augmentation = instantiate(dataset.loader), instantiate(config.augmentation)
    window = instantiate(config.window)
    if "simulation" in dataset:
        plain = OmegaConf.to_container(dataset.simulation, resolve=True)
        settings = SimulationSettings.from_mapping(cast(Mapping[str, object], plain))
        ensure_simulated(settings, Path(dataset.root))
    say_simulated(config)
    recording: Recording = instantiate(dataset.recording)
    log.info("%s data: %d frames in %s", dataset.label, len(recording.frame_ids), dataset.root)
    focal_px = dataset.get("focal_px")
    return CalibrationDataModule(
        recording=recording,
        image_size=image_size(dataset.image_size)
        if dataset.image_size is not None
        else recorded_size(recording, focal_px),
        decalibration=decalibration,
        split=split,
        loader=loader,
        inputs=inputs,
        augmentation=augmentation,
        seed=config.seed,
        window=window,
        focal_px=focal_px,
    )


def recorded_size(recording: Recording, focal_px: float | None) -> tuple[int, int]:
    """(H, W) that the images of all rigs cover at a focal length (None: their own), in 8 pixels.

    One readable frame per rig is looked at.

    Raises:
        RecordingError: no frame can be read.
    """
    rigs: dict[str, tuple[int, int]] = {}
    first = ""
    for frame_id in recording.frame_ids:
        if frame_id.rig in rigs:
            continue
        try:
            frame = recording.load(frame_id)
        except FrameError as error:
            first = first or str(error)
            continue
        if frame.image is not None:
            source = (frame.image.shape[0], frame.image.shape[1])
        else:
            assert frame.events is not None
            source = frame.events.size
        focal = float(frame.K[0, 0])
        rigs[frame_id.rig] = size_at_focal(source, focal, focal_px or focal)
    if rigs:
        heights, widths = zip(*rigs.values(), strict=True)
        return min(heights), min(widths)
    raise RecordingError(
        f"none of the {len(recording.frame_ids)} frames can be read; the first: {first}"
    )


def say_simulated(config: DictConfig) -> None:
    """Put "simulated" into the label of a simulation that stands in for real recordings."""
    dataset = config.dataset
    if (Path(dataset.root) / MANIFEST_NAME).is_file() and "simulated" not in dataset.label:
        dataset.label = f"simulated (a stand-in for {dataset.label})"
        log.warning("%s was simulated: the results say so", dataset.root)


def check_pairing(config: DictConfig, inputs: InputSettings) -> None:
    """Make sure that the dataset has what the model reads, or say what to choose instead."""
    modality = choice("dataset.modality", config.dataset.get("modality", "rgb"), CAMERAS)
    if inputs.camera in (None, modality):
        return
    raise ConfigurationError(
        f"model={config.model.name} reads {inputs.camera}, but dataset={config.dataset.name} "
        f"gives {modality}: choose model={MODELS[modality]}, or a dataset that gives "
        f"{inputs.camera} ({DATASETS[str(inputs.camera)]})"
    )


@names_the_setting("model", "mcd", "interval")
def build_module(config: DictConfig) -> CalibrationModule:
    """Make the network and the LightningModule around it, untrained.

    Its ``recipe`` goes into every checkpoint.

    Raises:
        ConfigurationError: a setting is unknown or out of its range.
    """
    model = config.model
    dropout = read_settings(DropoutSettings, "mcd", config.mcd)
    intervals = read_settings(IntervalSettings, "interval", config.interval)
    inputs = instantiate(model.inputs)
    network = instantiate(model.network, in_channels=inputs.n_channels)
    if dropout.insert is not None:
        added = insert_dropout(network, **dropout.insert)  # type: ignore[arg-type]
        log.info("dropout inserted: %s", ", ".join(added))
    decalibration: DecalibrationRange = instantiate(config.decalibration)
    module = CalibrationModule(
        estimator=_estimator(config, network, decalibration),
        optimizer=instantiate(model.optimization.optimizer),
        warmup_fraction=model.optimization.warmup_fraction,
        engine=dropout.engine,
        spread=dropout.spread,
        fixed_masks=dropout.masks == "fixed",
        calibrator=intervals.make(network, dropout, decalibration.bounds),
        groups=intervals.groups,
        mask_seed=dropout.seed,
    )
    _try_out(module, config)
    module.recipe = {key: _plain(config[key]) for key in RECIPE}
    return module


def _try_out(module: CalibrationModule, config: DictConfig) -> None:
    """Ask now what the first step and the first pass would ask after hours."""
    module.make_optimizer([nn.Parameter(torch.zeros(1))])
    rates = dropout_rates(module.estimator, module.engine.select)
    if config.mcd.passes > 1 and not any(rates.values()):
        raise ConfigurationError(
            f"mcd.passes={config.mcd.passes}, but no dropout layer has a rate above 0, so that all "
            "passes are the same: raise model.head_dropout or model.backbone_dropout, put some in "
            "with mcd.insert, or ask once (mcd.passes=1 with interval=absolute)"
        )


def _estimator(
    config: DictConfig, network: nn.Module, decalibration: DecalibrationRange
) -> nn.Module:
    model = config.model
    if isinstance(network, EvidenceNetwork):
        start = model.get("start")
        return AlignmentEstimator(
            network,
            decalibration.bounds,
            list(model.rounds),
            instantiate(model.learning),
            start and _edge_alignment(config, start, decalibration),
            16.0 if start is None else start.inflation,
            model.get("reaches"),
        )
    if isinstance(network, EdgeAlignment):
        return EdgeAlignmentEstimator(network, decalibration.bounds, instantiate(model.search))
    _refuse_what_needs_a_solver(config)
    return PoseEstimator(
        network,
        decalibration.bounds,
        ridge=model.ridge,
        displacement_weight=model.displacement_weight,
        quantile_levels=tuple(config.interval.quantile_levels),
    )


def _edge_alignment(
    config: DictConfig, start: DictConfig, decalibration: DecalibrationRange
) -> EdgeAlignmentEstimator:
    network = instantiate(start.network, in_channels=instantiate(config.model.inputs).n_channels)
    return EdgeAlignmentEstimator(network, decalibration.bounds, instantiate(start.search))


def _refuse_what_needs_a_solver(config: DictConfig) -> None:
    """Before a training, not after it."""
    if config.window.frames > 1:
        raise ConfigurationError(
            f"window.frames={config.window.frames} adds up the normal equations of several frames, "
            "and this network has none: use model/backbone=edges, or window.frames=1"
        )
    if config.mcd.spread in ("solver", "total"):
        raise ConfigurationError(
            f"mcd.spread={config.mcd.spread} needs the covariance of a solver, which this network "
            "has not: use mcd.spread=dropout, or model/backbone=edges"
        )


@names_the_setting("trainer", "callbacks", "logger")
def build_trainer(config: DictConfig) -> lightning.Trainer:
    """Make the trainer with the configured callbacks and loggers.

    Validations are spread evenly and always include the last epoch.
    """
    refuse_missing_gpu(str(config.trainer.accelerator))
    epochs = config.trainer.max_epochs
    every = validation_interval(epochs, config.dataset.validations)
    callbacks = [callback for callback in config.callbacks.values() if callback]
    logger = config.get("logger")  # ~logger takes it away
    if not logger:
        # Lightning would refuse it at the first step: it has nothing to log to.
        callbacks = [c for c in callbacks if not c._target_.endswith(".LearningRateMonitor")]
    trainer: lightning.Trainer = instantiate(
        config.trainer,
        callbacks=[instantiate(callback) for callback in callbacks],
        # Of None Lightning makes a logger of its own.
        logger=instantiate(logger) if logger else False,
        check_val_every_n_epoch=every,
        plugins=[*(config.trainer.get("plugins") or []), WholeCheckpoints()],
    )
    return trainer


def refuse_missing_gpu(accelerator: str) -> None:
    """Say in the words of the settings that torch finds no such device."""
    there = {"cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    there["gpu"] = any(there.values())
    if not there.get(accelerator, True):
        raise ConfigurationError(
            f"trainer.accelerator={accelerator}: torch finds none here; use cpu, or auto, which "
            "takes a GPU where there is one"
        )


def validation_interval(epochs: int, validations: int) -> int:
    """Smallest interval that divides the epochs and makes no more validations than asked for.

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
    """(H, W) in pixels of a setting, which must be two integers of at least 32."""
    numbers = list(cast("list[int]", value)) if OmegaConf.is_list(value) else []
    if len(numbers) != 2 or any(not isinstance(n, int) or n < 32 for n in numbers):
        raise ConfigurationError(
            f"dataset.image_size={value}: expected [H, W], two integers of at least 32 pixels"
        )
    return numbers[0], numbers[1]


def _plain(value: object) -> object:
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
