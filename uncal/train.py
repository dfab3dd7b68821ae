"""Train, calibrate the uncertainty, test: ``python -m uncal.train dataset=demo``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from omegaconf import DictConfig

from uncal.errors import ConfigurationError, DivergenceError, UncalError
from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error, job_folder, quiet_libraries
from uncal.settings.help_page import show_help

if TYPE_CHECKING:
    import lightning

    from uncal.data.datamodule import CalibrationDataModule
    from uncal.models.module import CalibrationModule
    from uncal.weights.load_or_train import Weights


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="train")
@exits_on_error
def main(config: DictConfig) -> float:
    """One run, from recordings to the paper's table.

    Returns:
        Mean over the DoF of mean absolute error / mean absolute decalibration on the test split;
        a sweeper minimises it.
    """
    # Here and not above: they take seconds, which --help has no use for.
    import lightning

    from uncal.runs.assembly import build_data, build_module, build_trainer, say_simulated
    from uncal.runs.checkpoint import check_start, last_checkpoint, read_recipe, start_from
    from uncal.runs.weights_to_report import finished_earlier, make_record, weights_to_report
    from uncal.settings.check import check_settings
    from uncal.system.memory import keep_freed_memory
    from uncal.weights.ingredients import data_ingredients, training_ingredients
    from uncal.weights.load_or_train import Weights, WeightStore, load_or_train, stays_trained
    from uncal.weights.shipped import find_weights

    keep_freed_memory()
    quiet_libraries()
    check_settings(config)
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    say_simulated(config)
    # Network and trainer first: what their settings are worth is known before any frame is read.
    module = build_module(config)
    if config.model.get("weights") is not None:
        start_from(module, find_weights(config.model.weights))
    trainer = build_trainer(config)
    if config.ckpt is not None:
        check_start(module, Path(config.ckpt), config.trainer.max_epochs)
    data = build_data(config)

    shared = data_ingredients(config, data)
    ingredients = training_ingredients(config, data, module, trainer, shared)
    record = make_record("uncal.train", config, module, trainer, ingredients)
    earlier = finished_earlier(record, config.retrain)
    if earlier is not None:
        return earlier
    record.begin()

    if not module.learns:
        weights = untrained(config.ckpt)
    elif config.ckpt is not None or config.store is None:
        last = last_checkpoint(trainer)
        path = fit(trainer, module, data, config.ckpt, f"ckpt={last} and the same settings")
        weights = Weights(path, "", reused=False, trained=None)
    else:
        weights = load_or_train(
            WeightStore(Path(config.store), ingredients),
            partial(fit_or_resume, trainer, module, data),
            run=job_folder(),
            epochs=config.trainer.max_epochs,
            last=last_checkpoint(trainer),
            retrain=config.retrain,
        )
    with stays_trained(weights.path):
        calibrated = weights.learnt and read_recipe(weights.path) == module.recipe
        parts = (config, module, trainer, data, weights, record)
        return weights_to_report(
            *parts, calibrated=calibrated, checkpoint=weights.path.name, shared=shared
        )


def untrained(start: str | None) -> Weights:
    """What stands for the weights of a model without parameters, which none can go on from.

    Its checkpoint is written after the test, with the calibrator, for :mod:`uncal.evaluate`.
    """
    from uncal.weights.load_or_train import CHECKPOINT, Weights

    if start is not None:
        raise ConfigurationError(
            f"ckpt={start}: this model has no parameters, so that no training can go on; "
            "python -m uncal.evaluate tests a checkpoint"
        )
    path = job_folder() / "checkpoints" / CHECKPOINT
    return Weights(path, "", reused=False, trained=None, learnt=False)


def fit(
    trainer: lightning.Trainer,
    module: CalibrationModule,
    data: CalibrationDataModule,
    start: str | Path | None,
    continuation: str,
) -> Path:
    """Train, from nothing or from a checkpoint.

    Raises:
        UncalError: interrupted, diverged, stopped by an error, or no checkpoint was written.
    """
    import torch

    from uncal.callbacks.divergence import diverged
    from uncal.runs.checkpoint import save_weights
    from uncal.weights.load_or_train import how_to_finish

    kept = job_folder() / "checkpoints" / "stopped.ckpt"
    try:
        trainer.fit(module, datamodule=data, ckpt_path=start)
    except DivergenceError:
        raise
    except torch.linalg.LinAlgError as error:  # type: ignore[attr-defined]
        # Before a loss is NaN: the solver adds a prior, so that only such numbers stop it.
        raise diverged(trainer, "the normal equations are not finite") from error
    except UncalError as error:
        if trainer.global_step == 0 or not trainer.is_global_zero:
            raise
        save_weights(module, kept)
        raise UncalError(f"{error}\n{how_to_finish(kept)}") from error
    except SystemExit as stop:  # how Lightning passes Ctrl-C on
        raise UncalError(
            f"interrupted; go on after the last finished epoch with {continuation}"
        ) from stop
    path = getattr(trainer.checkpoint_callback, "best_model_path", "")
    if path:
        return Path(str(path))
    if trainer.global_step == 0:
        raise UncalError("not one step of training: none of its frames can be read")
    if trainer.is_global_zero:
        save_weights(module, kept)
    raise UncalError(
        "the training ended before its first validation (trainer.max_steps, trainer.max_time), so "
        f"that no epoch is known to be the best.\n{how_to_finish(kept)}"
    )


def fit_or_resume(
    trainer: lightning.Trainer,
    module: CalibrationModule,
    data: CalibrationDataModule,
    start: Path | None,
) -> Path:
    """Train, or go on with an interrupted training in the folder that has its checkpoints.

    Returns:
        The checkpoint that validated best, before or after the interruption.
    """
    from lightning.pytorch.callbacks import ModelCheckpoint

    from uncal.runs.checkpoint import last_checkpoint

    if start is not None:
        for callback in trainer.checkpoint_callbacks:
            if isinstance(callback, ModelCheckpoint):
                # Elsewhere Lightning would forget which checkpoint was best so far.
                callback.dirpath = str(start.parent)
    last = last_checkpoint(trainer)
    continuation = f"the same command, which finds {last} (retrain=true would start anew)"
    return fit(trainer, module, data, start, continuation)


if __name__ == "__main__":
    show_help("hydra/default.yaml")
    quote_arguments()
    main()
