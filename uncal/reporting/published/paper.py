"""The paper's Table 1, Table 2 and point errors, read from ``wacv2025.yaml`` in this folder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import yaml  # type: ignore[import-untyped]

from uncal.geometry import DOF_NAMES, DOF_UNITS

MCD_CP = "MC dropout + conformal"
MCD_ALONE = "MC dropout alone, normal quantiles"


@dataclass(frozen=True)
class PublishedValue:
    """One cell of Table 1 or 2; ``text`` is the value as printed, ``level`` percent."""

    table: int
    data: str
    method: str
    dof: str
    unit: str
    level: float
    metric: str
    text: str

    @property
    def value(self) -> float:
        """The number."""
        return float(self.text)


class PublishedError(NamedTuple):
    """Mean errors of the estimate on real KITTI, as printed; per axis or in total is unstated."""

    source: str
    translation: str
    rotation: str


class PublishedSetting(NamedTuple):
    """Where the paper's numbers on one data set come from."""

    data: str
    network: str
    split: str
    dropout: str


@dataclass(frozen=True)
class PublishedPaper:
    """All numbers taken from the paper, and where they stand in it.

    Attributes:
        title: of the paper.
        authors: their family names.
        venue: with the year.
        address: where to read it.
        values: cells of Table 1, then of Table 2, in the order printed.
        errors: point errors on real KITTI.
        settings: one per data set.
        passes: N of MC dropout.
        decalibration: range of the artificial decalibration.
        doubts: cells that cannot be right as printed.
    """

    title: str
    authors: str
    venue: str
    address: str
    values: tuple[PublishedValue, ...]
    errors: tuple[PublishedError, ...]
    settings: tuple[PublishedSetting, ...]
    passes: int
    decalibration: str
    doubts: tuple[str, ...]

    def source(self, place: str) -> str:
        """A sentence's worth of reference."""
        return f"{self.authors}, “{self.title}”, {self.venue}, {place}"

    def table(self, number: int) -> tuple[PublishedValue, ...]:
        """The cells of one table."""
        return tuple(each for each in self.values if each.table == number)


@cache
def published_paper() -> PublishedPaper:
    """The paper that this package implements.

    >>> paper = published_paper()
    >>> cell = paper.table(1)[0]
    >>> cell.data, cell.dof, cell.level, cell.metric, cell.value
    ('real KITTI', 'X', 90.0, 'picp', 89.4)
    """
    text = files(__package__).joinpath("wacv2025.yaml").read_text(encoding="utf-8")
    content = yaml.safe_load(text)
    settings = content["settings"]
    first = dict(content["table_1"])
    levels = [float(level) for level in first.pop("levels").split()]
    cells = [(dof, level) for dof in DOF_NAMES for level in levels]
    values = [
        _value(1, data, MCD_CP, dof, level, metric, cell)
        for data, metrics in first.items()
        for metric, line in metrics.items()
        for (dof, level), cell in zip(cells, line.split(), strict=True)
    ]
    values += [
        _value(2, "real KITTI", MCD_ALONE, dof, float(level), "picp", cell)
        for level, line in content["table_2"].items()
        for dof, cell in zip(DOF_NAMES, line.split(), strict=True)
    ]
    return PublishedPaper(
        **{key: content[key] for key in ("title", "authors", "venue", "address")},
        values=tuple(values),
        errors=tuple(PublishedError(n, *texts) for n, texts in content["point_errors"].items()),
        settings=tuple(
            PublishedSetting(data=data, **about)
            for data, about in settings.items()
            if isinstance(about, dict)
        ),
        passes=int(settings["passes"]),
        decalibration=settings["decalibration"],
        doubts=tuple(content["doubts"]),
    )


def _value(
    table: int, data: str, method: str, dof: str, level: float, metric: str, text: str
) -> PublishedValue:
    unit = "%" if metric == "picp" else DOF_UNITS[DOF_NAMES.index(dof)]
    return PublishedValue(table, data, method, dof, unit, level, metric, text)
