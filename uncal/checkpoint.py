"""What another process needs of a checkpoint: its settings and its weights."""

from __future__ import annotations

import os
from pathlib import Path
from typing import cast

import torch
from omegaconf import DictConfig, OmegaConf

from uncal.errors import ConfigurationError
from uncal.models.module import CalibrationModule


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


def save_weights(module: CalibrationModule, path: Path) -> None:
    """Write a checkpoint for :mod:`uncal.evaluate`: weights, calibrator and settings of this run.

    Args:
        module: trained and calibrated.
        path: the checkpoint; its folder is made if it is not there.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    torch.save({"state_dict": module.state_dict(), "uncal_recipe": module.recipe}, partial)
    partial.replace(path)


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
