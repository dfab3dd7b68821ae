"""Weights that come with the package: safetensors with the settings that rebuild their network."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from pickle import UnpicklingError
from typing import cast

import torch
from omegaconf import DictConfig, OmegaConf
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from uncal.errors import ConfigurationError

_PACKAGE = Path(__file__).resolve().parents[1]

FOLDERS: tuple[Path, ...] = (_PACKAGE.parent / "weights", _PACKAGE / "shipped")
"""Where shipped weights are: beside the package in a checkout, inside it in a wheel."""


def shipped_names() -> list[str]:
    """Names that ``weights=`` knows."""
    return sorted({path.stem for folder in FOLDERS for path in folder.glob("*.safetensors")})


def find_weights(name: str) -> Path:
    """The file of shipped weights, or of somebody's own.

    Raises:
        ConfigurationError: there is none.
    """
    candidates = [Path(name), *(folder / f"{name}.safetensors" for folder in FOLDERS)]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise ConfigurationError(
        f"weights={name}: no such file, and no weights of that name come with uncal; known are "
        f"{', '.join(shipped_names()) or 'none'}. For a checkpoint of your own use ckpt=…"
    )


def save_shipped(
    state: dict[str, Tensor],
    recipe: dict[str, object],
    path: Path,
    beside: dict[str, Tensor] | None = None,
) -> None:
    """Write a module's state, its recipe and further tensors as one file without pickles."""
    path.parent.mkdir(parents=True, exist_ok=True)
    everything = state | (beside or {})
    tensors = {
        name: value.detach().cpu().contiguous().clone() for name, value in everything.items()
    }
    save_file(tensors, path, metadata={"uncal_recipe": json.dumps(recipe)})


def load_shipped(path: Path) -> tuple[dict[str, Tensor], DictConfig]:
    """Read such a file.

    Raises:
        ConfigurationError: it is damaged, or not of this project.
    """
    try:
        with safe_open(path, "pt") as file:
            recipe = json.loads(file.metadata()["uncal_recipe"])
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise ConfigurationError(
            f"weights={path}: not weights that uncal wrote ({error}); take another copy"
        ) from error
    return state, cast(DictConfig, OmegaConf.create(recipe))


def load_checkpoint(path: Path) -> tuple[dict[str, Tensor], DictConfig]:
    """State and settings of a Lightning checkpoint that ``uncal.train`` wrote.

    Raises:
        ConfigurationError: no such file, or not a checkpoint of this project.
    """
    if not path.is_file():
        raise ConfigurationError(
            f"ckpt={path}: no such file; runs keep theirs under outputs/*/*/checkpoints/best.ckpt"
        )
    try:
        with warnings.catch_warnings():  # torch asks to file an issue about a foreign pickle
            warnings.simplefilter("ignore")
            content = torch.load(path, map_location="cpu", weights_only=True)
        state, recipe = content["state_dict"], content["uncal_recipe"]
    except Exception as error:
        raise ConfigurationError(
            f"ckpt={path}: not a checkpoint that uncal.train wrote ({_reason(error)}); runs keep "
            "theirs under outputs/*/*/checkpoints/best.ckpt"
        ) from error
    return state, cast(DictConfig, OmegaConf.create(recipe))


def _reason(error: Exception) -> str:
    """Why a file is no checkpoint, without torch's advice to trust it."""
    if isinstance(error, KeyError) and error.args[0] in ("state_dict", "uncal_recipe"):
        return f"it has no {error}"
    if isinstance(error, UnpicklingError) and "allowed global" in str(error):
        return "it is a pickle that may run code, which was refused: nothing of it was run"
    if isinstance(error, OSError):
        return str(error.strerror or error)
    # The unpickler stumbles over other bytes in any way.
    return "its bytes are not those of a checkpoint"
