"""What the entry points share: from weights to report, and what is kept of a run."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import lightning
from omegaconf import DictConfig

from uncal.data.datamodule import CalibrationDataModule
from uncal.errors import ConfigurationError
from uncal.models.module import CalibrationModule
from uncal.reporting.run_record import RunRecord, command_line
from uncal.runs.checkpoint import load_weights, save_weights
from uncal.settings.configuration import in_multirun, job_folder, job_overrides
from uncal.uncertainty.dropout.pass_memory import PassMemory
from uncal.weights.digest import digest_of, digest_of_code
from uncal.weights.ingredients import data_ingredients, pass_ingredients
from uncal.weights.load_or_train import Weights

log = logging.getLogger(__name__)


def make_record(
    entry_point: str,
    config: DictConfig,
    module: CalibrationModule,
    trainer: lightning.Trainer,
    weights: Mapping[str, object],
) -> RunRecord:
    """The record of a run that begins."""
    decisive = {
        "weights": dict(weights),
        "settings": module.recipe,
        "levels": [float(level) for level in config.interval.levels],
        "code": digest_of_code((".",)),
    }
    return RunRecord(
        job_folder(),
        digest_of(decisive),
        command=command_line(entry_point, job_overrides()),
        label=config.dataset.label,
        seed=config.seed,
        device=trainer.strategy.root_device.type,
        settings=module.recipe,
    )


def finished_earlier(record: RunRecord, retrain: bool) -> float | None:
    """What a job of a multirun returned when it ran before, if nothing has changed since.

    Returns:
        The mean ratio; None if the job must run.
    """
    earlier = None if retrain or not in_multirun() else record.finished_earlier()
    if earlier is None:
        return None
    log.info("%s: finished at %s, kept as it is", record.path.parent, earlier["finished"])
    return float(str(earlier["mean_ratio"]))


def weights_to_report(
    config: DictConfig,
    module: CalibrationModule,
    trainer: lightning.Trainer,
    data: CalibrationDataModule,
    weights: Weights,
    record: RunRecord,
    *,
    calibrated: bool,
    checkpoint: str,
    shared: Mapping[str, object] | None = None,
) -> float:
    """The way that every run goes from weights to tables: load, calibrate, test, report, record.

    Returns:
        Mean over the DoF of mean absolute error / mean absolute decalibration.

    Raises:
        ConfigurationError: there is no report among the callbacks.
    """
    if weights.learnt:
        load_weights(module, weights.path, calibrated=calibrated)
    module.run.notes.append(weights.sentence())
    _remember_passes(config, module, trainer, data, shared)
    trainer.test(module, datamodule=data, verbose=False)
    mean_ratio = module.run.mean_ratio
    if mean_ratio is None:
        raise ConfigurationError("callbacks.report is missing: the run has no result without it")
    if trainer.is_global_zero:
        own = job_folder() / "checkpoints" / checkpoint
        fresh = weights.learnt and not weights.reused
        if not (fresh and own.is_file() and own.samefile(weights.path)):
            save_weights(module, own)
        _keep_results(record, module, weights, mean_ratio)
    return mean_ratio


def _remember_passes(
    config: DictConfig,
    module: CalibrationModule,
    trainer: lightning.Trainer,
    data: CalibrationDataModule,
    shared: Mapping[str, object] | None,
) -> None:
    """Keep the stochastic passes of trained weights, and use those that are kept already.

    Not with several processes, whose frames differ, nor with fixed masks, which a network must
    meet itself before it can tell that they fit, nor without parameters, where nothing is random.
    """
    if not module.learns or config.store is None:
        return
    if trainer.world_size > 1 or module.masks is not None:
        return
    shared = shared or data_ingredients(config, data)
    named = digest_of(pass_ingredients(config, module, trainer, shared))
    memory = PassMemory(Path(config.store) / "passes" / named, config.mcd.passes)
    if config.get("retrain"):
        memory.forget()
    module.remember(memory)


def _keep_results(
    record: RunRecord, module: CalibrationModule, weights: Weights, mean_ratio: float
) -> None:
    """Write the record of a run that has its results, and the passes that are new."""
    passes = {}
    if module.memory is not None:
        module.memory.save()
        splits = ("uncertainty_calibration", "test")
        passes = {split: module.memory.origin(split) for split in splits}
    trained = weights.trained
    record.write(
        mean_ratio=mean_ratio,
        weights={
            "fingerprint": weights.fingerprint,
            "reused": weights.reused,
            "path": str(weights.path),
            "training_seconds": None if trained is None else trained.seconds,
            "epochs": None if trained is None else trained.epochs,
        },
        passes=passes,
    )
