"""What another process needs of trained weights: their settings and their state."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import lightning
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.plugins.io import TorchCheckpointIO
from omegaconf import DictConfig
from torch import Tensor

from uncal.errors import ConfigurationError
from uncal.models.module import CalibrationModule
from uncal.reporting.layout import replaced_whole
from uncal.weights.shipped import load_checkpoint, load_shipped

OWN: tuple[str, ...] = ("calibrator.", "ellipsoid.", "masks.", "monitor.")
"""Parts of the state that belong to the calibration (or to the monitor), not to the weights."""


def load_weights(module: CalibrationModule, path: Path, calibrated: bool) -> None:
    """Load a checkpoint, or shipped weights, of the same network.

    ``calibrated``: their calibrator is of the module's kind, and wanted.

    Raises:
        ConfigurationError: the weights are another network's.
    """
    state, _ = _read(path)
    own = [key for key in state if key.startswith(OWN)]
    if not calibrated:
        state = {key: value for key, value in state.items() if key not in own}
    elif module.masks is None:
        state.pop("masks.seed", None)
    _load(module, state, path)


def check_start(module: CalibrationModule, path: Path, epochs: int) -> None:
    """Refuse a checkpoint (``ckpt=``) that a training of so many epochs cannot go on from.

    Raises:
        ConfigurationError: no such file, not a checkpoint of this project, another network's,
            weights without the state of their training, or of more epochs already.
    """
    state, _ = load_checkpoint(path)
    _check_shapes(module, state, path)
    missing = [key for key in module.state_dict() if key not in state and not key.startswith(OWN)]
    unknown = [key for key in state if key not in module.state_dict() and not key.startswith(OWN)]
    if missing or unknown:
        raise ConfigurationError(
            f"ckpt={path}: {', '.join((*missing, *unknown)[:3])}: not of this network; give the "
            "settings under model= that it was trained with"
        )
    content = torch.load(path, map_location="cpu", weights_only=True)
    if "optimizer_states" not in content:
        raise ConfigurationError(
            f"ckpt={path}: holds weights, but not the state of their training, which ckpt= goes on "
            f"with; give a run's last.ckpt, or start a training from the weights: "
            f"model.weights={path}"
        )
    seen = int(content["epoch"]) + 1
    if seen > epochs:
        raise ConfigurationError(
            f"ckpt={path}: has {seen} epochs behind it, trainer.max_epochs={epochs} ends before: "
            f"give a number from {seen} on, which counts from the first epoch"
        )


def start_from(module: CalibrationModule, path: Path) -> None:
    """Begin a training with a checkpoint's, or shipped, weights instead of random numbers.

    Raises:
        ConfigurationError: the weights are another network's.
    """
    state, _ = _read(path)
    _load(module, {k: v for k, v in state.items() if not k.startswith(OWN)}, path)


def save_weights(module: CalibrationModule, path: Path) -> None:
    """Write a checkpoint for :mod:`uncal.evaluate`: weights, calibrator, settings of this run."""
    save_whole({"state_dict": module.state_dict(), "uncal_recipe": module.recipe}, path)


def read_recipe(path: Path) -> DictConfig:
    """The settings (:data:`uncal.runs.assembly.RECIPE`) that a checkpoint's weights came from.

    Raises:
        ConfigurationError: no such file, or not of this project.
    """
    return _read(path)[1]


def last_checkpoint(trainer: lightning.Trainer) -> Path | None:
    """Where a trainer keeps what it has after every epoch; None if it does not."""
    for callback in trainer.checkpoint_callbacks:
        if isinstance(callback, ModelCheckpoint) and callback.filename == "last":
            return Path(str(callback.dirpath)) / "last.ckpt"
    return None


def _read(path: Path) -> tuple[dict[str, Tensor], DictConfig]:
    return load_shipped(path) if path.suffix == ".safetensors" else load_checkpoint(path)


def _check_shapes(module: CalibrationModule, state: dict[str, Tensor], path: Path) -> None:
    shapes = {key: value.shape for key, value in module.state_dict().items()}
    other = [
        key
        for key, value in state.items()
        if not key.startswith(OWN) and key in shapes and shapes[key] != value.shape
    ]
    if other:
        raise ConfigurationError(f"{path}: {', '.join(other[:3])}: of another size of network")


def _load(module: CalibrationModule, state: dict[str, Tensor], path: Path) -> None:
    _check_shapes(module, state, path)
    missing, unknown = module.load_state_dict(state, strict=False)
    wrong = [key for key in (*missing, *unknown) if not key.startswith(OWN)]
    if wrong:
        raise ConfigurationError(f"{path}: {', '.join(wrong[:3])}: not of this network")


def save_whole(content: object, path: Path) -> None:
    """``torch.save``, after which the file is new as a whole, or as it was; makes its folder."""
    # Of a full disk torch's own writer says nothing that could be understood.
    buffer = io.BytesIO()
    torch.save(content, buffer)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced_whole(path) as partial:
        partial.write_bytes(buffer.getbuffer())


class WholeCheckpoints(TorchCheckpointIO):
    """Writes Lightning's checkpoints beside their place and moves them there in one step.

    Lightning's own move comes from the system's folder for temporary files. From there to another
    disk it is a copy, which a killed process or a full disk cuts short over the last good file.
    """

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: object = None
    ) -> None:
        """Write; options of remote file systems are not used."""
        save_whole(checkpoint, Path(path))
