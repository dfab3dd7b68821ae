"""summary.csv of a multirun as what its figures are drawn from."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from uncal.errors import UncalError
from uncal.geometry import DOF_NAMES
from uncal.reporting.multirun_jobs import REPLICATES

Rows = tuple[Mapping[str, str], ...]


@dataclass(frozen=True)
class Spread:
    """A quantity over replicates.

    Attributes:
        mean: over those that have it.
        low: the lowest.
        high: the highest.
        count: how many.
    """

    mean: float
    low: float
    high: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread | None:
        """None unless all replicates have it, finite.

        Args:
            values: one per replicate; NaN where it is missing.

        >>> Spread.of([1.0, 3.0])
        Spread(mean=2.0, low=1.0, high=3.0, count=2)
        """
        if not values or not all(map(math.isfinite, values)):
            return None
        return cls(sum(values) / len(values), min(values), max(values), len(values))

    def over(self, unit: float) -> Spread:
        """The same in another unit.

        Args:
            unit: how much that is, not 0.
        """
        return Spread(self.mean / unit, self.low / unit, self.high / unit, self.count)


@dataclass(frozen=True)
class Group:
    """The jobs of one combination of swept values.

    Attributes:
        values: of the swept keys.
        runs: the rows of each job.
    """

    values: tuple[str, ...]
    runs: tuple[Rows, ...]

    def spread(self, column: str, level: float, dofs: Sequence[str] = DOF_NAMES) -> Spread | None:
        """Mean of a column over some DoF, and its spread over replicates.

        Args:
            column: of summary.csv.
            level: coverage asked for, percent.
            dofs: over which to average.
        """
        return Spread.of([_mean(rows, column, level, dofs) for rows in self.runs])


@dataclass(frozen=True)
class Sweep:
    """A multirun.

    Attributes:
        keys: swept ones, without those that repeat an experiment.
        groups: in the order of the jobs.
        levels: coverage asked for, percent, ascending.
        label: what the data are.
        repeated: what differs between the jobs of a group, such as "mask seeds"; may be empty.
    """

    keys: tuple[str, ...]
    groups: tuple[Group, ...]
    levels: tuple[float, ...]
    label: str
    repeated: str

    @property
    def replicates(self) -> int:
        """Most jobs of one combination of swept values."""
        return max(len(group.runs) for group in self.groups)

    @property
    def spread_words(self) -> str:
        """What marks, bands and bars are, as a sentence for captions."""
        if self.replicates == 1:
            return "One run per value."
        return (
            f"Marks: means over the {self.repeated} ({self.replicates} runs); bands or bars: from "
            "the lowest to the highest of them."
        )

    def has(self, column: str) -> bool:
        """Whether any job has a column.

        Args:
            column: of summary.csv.
        """
        return any(row.get(column) for group in self.groups for run in group.runs for row in run)

    def finite(self, column: str, level: float) -> bool:
        """Whether any jobs have a column with finite numbers.

        Args:
            column: of summary.csv.
            level: coverage asked for, percent.
        """
        return any(group.spread(column, level) for group in self.groups)


Quantity = Callable[[Group], "Spread | None"]
"""What is drawn of the jobs of one combination of swept values."""


def mean_of(column: str, level: float, dofs: Sequence[str] = DOF_NAMES) -> Quantity:
    """The mean of a column over some DoF.

    Args:
        column: of summary.csv.
        level: coverage asked for, percent.
        dofs: over which to average.
    """
    return lambda group: group.spread(column, level, dofs)


def read_sweep(path: Path) -> Sweep | None:
    """Read a multirun's ``summary.csv``.

    Args:
        path: the file.

    Returns:
        None if there is no such file, or no rows.

    Raises:
        UncalError: it is damaged.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            rows = list(reader)
            columns = list(reader.fieldnames or [])
        if not rows:
            return None
        before = columns[: columns.index("dof")]
        keys = tuple(name for name in before if name not in REPLICATES)
        levels = tuple(sorted({float(row["level"]) for row in rows}))
        runs: dict[tuple[str, ...], dict[str, list[Mapping[str, str]]]] = {}
        for row in rows:
            group = runs.setdefault(tuple(row[key] for key in keys), {})
            group.setdefault(row["folder"], []).append(row)
    except FileNotFoundError:
        return None
    except (KeyError, ValueError, csv.Error) as error:
        raise UncalError(
            f"{path}: {error}; expected the summary of a multirun as uncal writes it. It is "
            "written anew when the multirun is started again."
        ) from error
    groups = tuple(
        Group(values, tuple(tuple(run) for run in jobs.values())) for values, jobs in runs.items()
    )
    labels = filter(None, dict.fromkeys(row.get("label") for row in rows))
    repeated = [
        name
        for key, name in zip(REPLICATES, ("seeds", "mask seeds"), strict=True)
        if len({row.get(key) for row in rows}) > 1
    ]
    return Sweep(keys, groups, levels, " and ".join(labels), " and ".join(repeated))


def numbers(values: Sequence[str]) -> list[float] | None:
    """Values as numbers; None unless all are.

    Args:
        values: of one swept key.

    >>> numbers(["5", "0.10"]), numbers(["frame", "5"])
    ([5.0, 0.1], None)
    """
    try:
        return [float(value) for value in values]
    except ValueError:
        return None


def _mean(rows: Rows, column: str, level: float, dofs: Sequence[str]) -> float:
    """NaN if the column is missing; a DoF without decalibration has NaN and is left out."""
    own = [row for row in rows if float(row["level"]) == level and row["dof"] in dofs]
    values = [float(row.get(column) or math.nan) for row in own]
    kept = [value for value in values if not math.isnan(value)]
    return sum(kept) / len(kept) if kept else math.nan
