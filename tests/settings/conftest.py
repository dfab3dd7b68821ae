"""Configurations composed once; what a test changes, it changes in a copy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import cast

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf, open_dict

from uncal.settings.configuration import CONFIG_DIR
from uncal.settings.shipped import shipped_config

Configured = Callable[..., tuple[DictConfig, DictConfig]]


@cache
def composed(name: str, choices: tuple[str, ...]) -> tuple[DictConfig, DictConfig]:
    """A configuration as a user chooses it, and as it ships with the same choices."""
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        config = compose(name, list(choices), return_hydra_config=True)
    chosen = {str(k): v for k, v in config.hydra.runtime.choices.items() if isinstance(v, str)}
    with open_dict(config):
        config.pop("hydra")
    return config, shipped_config(name, chosen)


@pytest.fixture(scope="session")
def configured() -> Configured:
    """Compose, then set ``key=value`` words, values as YAML; new keys are added."""

    def make(name: str, *words: str, choices: Sequence[str] = ()) -> tuple[DictConfig, DictConfig]:
        config, shipped = composed(name, tuple(choices))
        config = config.copy()
        with open_dict(config):
            for word in words:
                key, text = word.split("=", 1)
                plain = OmegaConf.to_container(OmegaConf.from_dotlist([f"value={text}"]))
                value = cast("dict[str, object]", plain)["value"]
                OmegaConf.update(config, key, value, merge=False, force_add=True)
        return config, shipped

    return make
