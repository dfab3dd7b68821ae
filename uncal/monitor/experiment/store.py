"""Rows of the experiment on disk, drive by drive, so that a killed one goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import pandas as pd

from uncal.errors import ConfigurationError
from uncal.geometry.transforms import DOF_NAMES
from uncal.monitor.experiment.observe import VECTORS, Row
from uncal.reporting.layout import write_whole

PARTS, ABOUT = "observations", "experiment.json"

_NUMBERS = [f"{name} {dof}" for name in VECTORS for dof in DOF_NAMES]


class Store:
    """One CSV file for each drive that a watcher has seen.

    Args:
        folder: of the run.
        about: what must be the same for going on: weights, references, settings.

    Raises:
        ConfigurationError: the folder holds another experiment.
    """

    def __init__(self, folder: Path, about: Mapping[str, object]) -> None:
        self.folder = folder / PARTS
        self.folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(about, indent=1, sort_keys=True)
        path = folder / ABOUT
        if path.is_file():
            known = json.loads(path.read_text(encoding="utf-8"))
            other = [key for key, value in json.loads(text).items() if known.get(key) != value]
            if other:
                raise ConfigurationError(
                    f"{folder}: holds an experiment with other {', '.join(other)}; go on with the "
                    "same, or give another folder (hydra.run.dir=…)"
                )
        write_whole(path, text)

    def has(self, name: str) -> bool:
        """Whether a part is there.

        Args:
            name: of case, drive and watcher.
        """
        return self._path(name).is_file()

    def add(self, name: str, rows: Iterable[Row]) -> None:
        """Write a part, whole or not at all.

        Args:
            name: of case, drive and watcher.
            rows: of it.
        """
        write_whole(self._path(name), pd.DataFrame(list(rows)).to_csv(index=False))

    def rows(self, names: Iterable[str]) -> pd.DataFrame:
        """Those parts that are there, one below the other.

        Args:
            names: in the order wanted.
        """
        return pd.concat([read_rows(self._path(name)) for name in names if self.has(name)])

    def _path(self, name: str) -> Path:
        return self.folder / f"{name.replace(' ', '_')}.csv"


def read_rows(path: Path) -> pd.DataFrame:
    """Rows as they were, empty words kept as such.

    Args:
        path: of a CSV file that the experiment wrote.
    """
    return pd.read_csv(
        path,
        keep_default_na=False,
        na_values={name: [""] for name in _NUMBERS},
        dtype={"dof": str, "drive": str},
    )
