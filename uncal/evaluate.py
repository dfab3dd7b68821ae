"""The table of a trained checkpoint again: ``python -m uncal.evaluate ckpt=…/best.ckpt``."""

from __future__ import annotations

import logging
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
from uncal.models.module import CalibrationModule

log = logging.getLogger(__name__)


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
    asked = {key: value for key, value in config.mcd.items() if value is not None}
    run.mcd = OmegaConf.merge(recipe.mcd, asked)
    if config.get("interval") is None:
        run.interval = recipe.interval
    else:
        run.interval = config.interval
        log.info("intervals by %s", run.interval.calibrator._target_)
    lightning.seed_everything(run.seed, workers=True, verbose=False)
    data = build_data(run)
    module = build_module(run)
    load_weights(module, Path(config.ckpt), calibrated=run.interval == recipe.interval)
    trainer = build_trainer(run)
    trainer.test(module, datamodule=data, verbose=False)
    return Report.of(trainer).results.summary.mean_ratio


def load_weights(module: CalibrationModule, path: Path, calibrated: bool) -> None:
    """Load a checkpoint's weights.

    Args:
        module: of the same network.
        path: the checkpoint.
        calibrated: whether its calibrator is of the module's kind, and wanted.
    """
    state = torch.load(path, map_location="cpu", weights_only=True)["state_dict"]
    own = [key for key in state if key.startswith(("calibrator.", "masks."))]
    if not calibrated:
        state = {key: value for key, value in state.items() if key not in own}
    elif module.masks is None:
        state.pop("masks.seed", None)
    missing, unknown = module.load_state_dict(state, strict=False)
    wrong = [key for key in (*missing, *unknown) if not key.startswith(("calibrator.", "masks."))]
    if wrong:
        raise ConfigurationError(f"ckpt={path}: {', '.join(wrong[:3])}: not of this network")


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
