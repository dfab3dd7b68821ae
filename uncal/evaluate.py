"""The table of a trained checkpoint again: ``python -m uncal.evaluate ckpt=…/best.ckpt``."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import hydra
import lightning
import torch
from omegaconf import DictConfig, OmegaConf

from uncal.assembly import build_data, build_module, build_trainer
from uncal.callbacks.report import Report
from uncal.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.errors import ConfigurationError
from uncal.memory import keep_freed_memory


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="evaluate")
@exits_on_error
def main(config: DictConfig) -> float:
    """Test a checkpoint with the settings it was trained with.

    Args:
        config: conf/evaluate.yaml with the command line's overrides.

    Returns:
        Mean over the DoF of mean absolute error / mean absolute decalibration.
    """
    keep_freed_memory()
    quiet_libraries()
    recipe = read_recipe(Path(config.ckpt))
    OmegaConf.set_struct(config, False)  # the recipe brings keys of its own
    run = OmegaConf.merge(config, recipe)
    if config.dataset.root is not None:
        run.dataset.root = run.dataset.recording.root = config.dataset.root
    if config.dataset.workers is not None:
        run.dataset.loader.workers = config.dataset.workers
    run = cast(DictConfig, run)
    lightning.seed_everything(run.seed, workers=True, verbose=False)
    data = build_data(run)
    module = build_module(run)
    trainer = build_trainer(run)
    trainer.test(module, datamodule=data, ckpt_path=config.ckpt, verbose=False)
    return Report.of(trainer).summary.mean_ratio


def read_recipe(path: Path) -> DictConfig:
    """The settings inside a checkpoint.

    Args:
        path: a checkpoint that ``uncal.train`` wrote.

    Returns:
        The parts of the configuration named by :data:`uncal.assembly.RECIPE`.

    Raises:
        ConfigurationError: no such file, or not a checkpoint of this project.
    """
    if not path.is_file():
        raise ConfigurationError(
            f"ckpt={path}: no such file; runs keep theirs under outputs/*/*/checkpoints/best.ckpt"
        )
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        recipe = content["uncal_recipe"]
    except Exception as error:
        raise ConfigurationError(
            f"ckpt={path}: not a checkpoint that uncal.train wrote ({error})"
        ) from error
    return cast(DictConfig, OmegaConf.create(recipe))


if __name__ == "__main__":
    main()
