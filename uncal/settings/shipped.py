"""The configuration as it is shipped, with a run's choices but none of its values."""

from __future__ import annotations

from functools import cache

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.utils import create_config_search_path
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, open_dict

from uncal.settings.configuration import CONFIG_DIR
from uncal.settings.sweep_source import GROUP


def shipped_config(name: str, choices: dict[str, str]) -> DictConfig:
    """Compose a shipped configuration from shipped files alone, without Hydra's own node."""
    return _shipped(name, tuple(sorted(choices.items()))).copy()


@cache
def _shipped(name: str, choices: tuple[tuple[str, str], ...]) -> DictConfig:
    loader = ConfigLoaderImpl(create_config_search_path(CONFIG_DIR))
    ours = {
        group: option
        for group, option in choices
        if group.partition("/")[0] not in ("hydra", GROUP)
        and option in loader.get_group_options(group.partition("@")[0])
    }
    # A choice within a group that does not ship may have no place.
    outer = {group: option for group, option in ours.items() if not {"/", "@"} & set(group)}
    for chosen in (ours, outer):
        try:
            return _compose(loader, name, chosen)
        except HydraException:
            continue
    return _compose(loader, name, {})


def shipped_for_this_job() -> DictConfig | None:
    """The shipped configuration with the choices of the job that Hydra runs; None outside Hydra."""
    if not HydraConfig.initialized():
        return None
    hydra = HydraConfig.get()
    choices = {str(k): v for k, v in hydra.runtime.choices.items() if isinstance(v, str)}
    return shipped_config(str(hydra.job.config_name), choices)


def _compose(loader: ConfigLoaderImpl, name: str, choices: dict[str, str]) -> DictConfig:
    config = loader.load_configuration(
        name, [f"{group}={option}" for group, option in choices.items()], RunMode.RUN
    )
    with open_dict(config):
        config.pop("hydra", None)
    return config
