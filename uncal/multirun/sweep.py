"""The jobs of a multirun as its tables and figures need them: grouped once, values per job."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import TypeAlias

import numpy as np
import pandas as pd

from uncal.geometry import DOF_NAMES
from uncal.multirun.folder import REPLICATES

KEY_NAMES = {
    "mcd.passes": "stochastic passes",
    "mcd.masks": "masks",
    "model.backbone_dropout": "backbone dropout rate",
    "model.head_dropout": "head dropout rate",
    "dataset.simulation.lidar.beams": "LiDAR beams",
    "dataset.simulation.n_rigs": "rigs",
    "split.train_frames": "training frames",
    "interval": "interval method",
    "split.by": "split by",
    "split.test": "test set",
}
"""What swept keys are called in a figure; others by themselves."""

Quantity: TypeAlias = tuple[str, float, Sequence[str]]
"""Column, nominal coverage in percent, and the DoF over which to average."""


class Sweep:
    """The frame of a :class:`uncal.multirun.folder.Multirun`, grouped by the values swept."""

    def __init__(self, frame: pd.DataFrame) -> None:
        self.frame = frame
        before = list(frame.columns[: list(frame.columns).index("dof")])
        self.keys = [name for name in before if name not in REPLICATES]
        self.levels = sorted({float(level) for level in frame["level"]})
        self.label = " and ".join(filter(None, frame["label"].unique()))
        found = {REPLICATES[key]: frame[key].unique() for key in before if key in REPLICATES}
        seeds = {name: [value for value in values if value] for name, values in found.items()}
        # What repeats the experiment: "seeds", "mask seeds" or both, with the values.
        self.repeated = {name: values for name, values in seeds.items() if len(values) > 1}
        # Without a swept key the folder tells jobs apart, unless it is a seed that does.
        by = self.keys or ([] if self.repeated else ["folder"])
        self.groups: dict[tuple[str, ...], list[str]] = {}
        for row in frame.drop_duplicates("folder")[[*by, "folder"]].itertuples(index=False):
            group = tuple(map(str, row[: len(by)])) or ("all",)
            self.groups.setdefault(group, []).append(str(row[-1]))
        self.replicates = max(map(len, self.groups.values()))
        self.names = [", ".join(values) if self.keys else "all" for values in self.groups]
        self.words = ", ".join(map(key_name, self.keys)) or " and ".join(self.repeated)

    @cached_property
    def over(self) -> str | None:
        """The swept number with the most values; None if there is none with two."""
        numbers = self.frame[self.keys].apply(pd.to_numeric, errors="coerce")
        counts = numbers.loc[:, numbers.notna().all()].nunique()
        return str(counts.idxmax()) if counts.max() > 1 else None  # the first of several

    @cached_property
    def jobs(self) -> pd.DataFrame:
        """Per job: folder, row (of the group), x (value of the number), others (other keys)."""
        rows = []
        for row, (values, folders) in enumerate(self.groups.items()):
            swept = dict(zip(self.keys, values, strict=False))
            x = float(swept.pop(self.over)) if self.over else math.nan
            rows += [(folder, row, x, ", ".join(swept.values())) for folder in folders]
        jobs: pd.DataFrame = pd.DataFrame(rows, columns=["folder", "row", "x", "others"])
        return jobs

    @property
    def others(self) -> list[str]:
        """What the lines of a figure over a number differ in."""
        return list(self.jobs["others"].unique()) if len(self.keys) > 1 else []

    @property
    def spread(self) -> str:
        """What marks, bands and bars are."""
        if self.replicates == 1:
            return "One run per value."
        return (
            f"Marks: means over the {' and '.join(self.repeated)} ({self.replicates} runs); bands "
            "or bars: from the lowest to the highest of them."
        )

    def per_job(self, quantity: Quantity, method: str = "mean") -> pd.Series[float]:
        """Folder → mean over the DoF that have a value; empty where no job has the column."""
        column, level, dofs = quantity
        if column not in self.frame.columns:
            return pd.Series(dtype=float)
        own = self.frame[(self.frame["level"] == level) & self.frame["dof"].isin(dofs)]
        found: pd.Series[float] = own.groupby("folder")[column].agg(method)
        return found

    def values(self, quantity: Quantity) -> pd.DataFrame:
        """The jobs with a value: means over the DoF, of groups in which all jobs have one."""
        means = self.jobs["folder"].map(self.per_job(quantity)).astype(float)
        jobs: pd.DataFrame = self.jobs.assign(value=means)
        finite = np.isfinite(jobs["value"]).groupby(jobs["row"]).transform("all")
        kept: pd.DataFrame = jobs.loc[finite]
        return kept

    def band(self, level: float, by: str) -> tuple[pd.Series[float], pd.Series[float]]:
        """Lower and upper end of the reference band by row or by x: sample sizes may differ."""
        low, high = (self.values((f"coverage_{end}", level, DOF_NAMES)) for end in ("low", "high"))
        return low.groupby(by)["value"].min(), high.groupby(by)["value"].max()

    def differs(self, quantities: Iterable[Quantity]) -> bool:
        """Whether there is anything to see: values, and not the same in every row."""
        means = [self.values(q).groupby("row")["value"].mean() for q in quantities]
        several = len(self.groups) == 1 or any(each.nunique() > 1 for each in means)
        return several and any(len(each) for each in means)


def key_name(key: str) -> str:
    """What a swept key is called in a figure."""
    return KEY_NAMES.get(key, key)


def sentence(words: str) -> str:
    """A name as the first word of a line; a key stays as it is typed.

    >>> sentence("stochastic passes"), sentence("trainer.max_epochs")
    ('Stochastic passes', 'trainer.max_epochs')
    """
    return words if "." in words else words[:1].upper() + words[1:]
