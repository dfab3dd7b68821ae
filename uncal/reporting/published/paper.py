"""The paper's Table 1, Table 2 and point errors, read from ``wacv2025.yaml`` in this folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import pandas as pd
import yaml  # type: ignore[import-untyped]

from uncal.geometry import DOF_NAMES, DOF_UNITS

MCD_CP = "MC dropout + conformal"
MCD_ALONE = "MC dropout alone, normal quantiles"


@dataclass(frozen=True, eq=False)
class PublishedPaper:
    """All numbers taken from the paper, and where they stand in it.

    Attributes:
        reference: authors, title, venue.
        address: where to read it.
        values: cells of Table 1, then of Table 2, in the order printed: table, data, method, dof,
            unit, level (percent), metric and text, the value as printed.
        errors: source → mean translation and rotation error on real KITTI, as printed; whether
            per axis or in total is not stated.
        settings: data set → network, split and dropout.
        passes: N of MC dropout.
        decalibration: range of the artificial decalibration.
        doubts: cells that cannot be right as printed.
    """

    reference: str
    address: str
    values: pd.DataFrame
    errors: Mapping[str, tuple[str, str]]
    settings: Mapping[str, Mapping[str, str]]
    passes: int
    decalibration: str
    doubts: tuple[str, ...]

    def source(self, place: str) -> str:
        """A sentence's worth of reference."""
        return f"{self.reference}, {place}"

    def table(self, number: int) -> pd.DataFrame:
        """The cells of one table."""
        cells: pd.DataFrame = self.values[self.values["table"] == number]
        return cells


@cache
def published_paper() -> PublishedPaper:
    """The paper that this package implements.

    >>> published_paper().table(1).iloc[0][["data", "dof", "metric", "text"]].tolist()
    ['real KITTI', 'X', 'picp', '89.4']
    """
    content = yaml.safe_load(files(__package__).joinpath("wacv2025.yaml").read_text("utf-8"))
    first = content.pop("table_1")
    levels = [float(level) for level in first.pop("levels").split()]
    cells = [(dof, level) for dof in DOF_NAMES for level in levels]
    units = dict(zip(DOF_NAMES, DOF_UNITS, strict=True))
    rows = [
        (1, data, MCD_CP, dof, "%" if metric == "picp" else units[dof], level, metric, text)
        for data, metrics in first.items()
        for metric, line in metrics.items()
        for (dof, level), text in zip(cells, line.split(), strict=True)
    ]
    rows += [
        (2, "real KITTI", MCD_ALONE, dof, "%", float(level), "picp", text)
        for level, line in content.pop("table_2").items()
        for dof, text in zip(DOF_NAMES, line.split(), strict=True)
    ]
    names = ["table", "data", "method", "dof", "unit", "level", "metric", "text"]
    return PublishedPaper(values=pd.DataFrame(rows, columns=names), **content)
