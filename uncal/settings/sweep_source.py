"""Lets Hydra find the group ``sweeps`` from any folder, in a checkout and in a wheel."""

from __future__ import annotations

from pathlib import Path

from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.plugins.search_path_plugin import SearchPathPlugin

GROUP = "sweeps"


class SweepSource(FileConfigSource):
    """The folder ``sweeps`` as a configuration group, and nothing that lies beside it.

    A plain ``file://`` of its parent would make groups of ``docs``, ``outputs`` and ``.git`` too,
    all of which Hydra's help walks through.

    Args:
        provider: who asked for it.
        path: ``uncal://sweeps``; where that is follows from the installed package.
    """

    def __init__(self, provider: str, path: str) -> None:
        super().__init__(provider, f"{self.scheme()}://{sweeps_parent(_PACKAGE)}")

    @staticmethod
    def scheme() -> str:
        """The part before ``://``."""
        return "uncal"

    def is_group(self, config_path: str) -> bool:
        """Whether there is such a folder; empty for the root."""
        return config_path == "" or (_inside(config_path) and super().is_group(config_path))

    def is_config(self, config_path: str) -> bool:
        """Whether there is such a file, such as sweeps/passes."""
        return _inside(config_path) and super().is_config(config_path)

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """Groups and configurations in a folder; empty for the root."""
        if config_path:
            return super().list(config_path, results_filter)
        return [] if results_filter == ObjectType.CONFIG else [GROUP]


class SweepSearchPath(SearchPathPlugin):
    """Puts :class:`SweepSource` after the configuration of every entry point."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Add it."""
        search_path.append("uncal", f"{SweepSource.scheme()}://{GROUP}")


def sweeps_parent(package: Path) -> Path:
    """The folder that holds ``sweeps``: the checkout, or the package of a wheel."""
    beside = package.parent
    return beside if (beside / GROUP / "passes.yaml").is_file() else package


def sweeps_folder() -> Path:
    """The folder ``sweeps`` of this installation."""
    return sweeps_parent(_PACKAGE) / GROUP


def register() -> None:
    """Make Hydra know the sweeps; a second call does nothing."""
    for plugin in (SweepSource, SweepSearchPath):
        Plugins.instance().register(plugin)


def _inside(config_path: str) -> bool:
    return config_path == GROUP or config_path.startswith(f"{GROUP}/")


_PACKAGE = Path(__file__).resolve().parents[1]
