"""Train, calibrate the uncertainty, test: ``python -m uncal.train dataset=demo``."""

from __future__ import annotations

import logging

import hydra
import lightning
from omegaconf import DictConfig

from uncal.assembly import build_data, build_module, build_trainer
from uncal.callbacks.report import Report
from uncal.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.errors import UncalError
from uncal.memory import keep_freed_memory

log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="train")
@exits_on_error
def main(config: DictConfig) -> float:
    """One run, from recordings to the paper's table.

    Args:
        config: conf/train.yaml with its groups and the command line's overrides.

    Returns:
        Mean over the DoF of mean absolute error / mean absolute decalibration on the test split;
        a sweeper minimises it.
    """
    keep_freed_memory()
    quiet_libraries()
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    data = build_data(config)
    module = build_module(config)
    trainer = build_trainer(config)

    try:
        trainer.fit(module, datamodule=data, ckpt_path=config.ckpt)
    except SystemExit as stop:  # how Lightning passes Ctrl-C on
        raise UncalError(
            "interrupted; go on after the last finished epoch with python -m uncal.train ckpt="
            f"{config.callbacks.checkpoint.dirpath}/last.ckpt and the same settings"
        ) from stop
    trainer.test(module, datamodule=data, ckpt_path=best_checkpoint(trainer), verbose=False)
    return Report.of(trainer).results.summary.mean_ratio


def best_checkpoint(trainer: lightning.Trainer) -> str:
    """Path of the checkpoint that validated best.

    Args:
        trainer: after ``fit``.

    Returns:
        The path.

    Raises:
        UncalError: no checkpoint was written.
    """
    callback = trainer.checkpoint_callback
    path = getattr(callback, "best_model_path", "")
    if not path:
        raise UncalError("no checkpoint was written: keep callbacks.checkpoint and a validation")
    return str(path)


if __name__ == "__main__":
    main()
