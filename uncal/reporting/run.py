"""A run's folder, read whole: its record (run.json) and its tables (the CSV files)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd
import torch
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

import uncal.uncertainty
from uncal.errors import UncalError
from uncal.geometry import DOF_NAMES, DOF_SCALE
from uncal.metrics.pose_error import PoseErrors, pose_errors
from uncal.reporting.evaluation import Guarantee, band_caveat, guarantee_of
from uncal.reporting.frames import PREDICTIONS, RESULTS, TABLES, Schema, read_csv
from uncal.reporting.published.paper import MCD_ALONE, MCD_CP
from uncal.reporting.run_record import NAME, read_record
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator

UNKNOWN = "not recorded"

FAILED = "failed.txt"
"""In the folder of a job that raised: why."""

METHODS: Mapping[str, str] = {
    "ConformalCalibrator": MCD_CP,
    "GaussianIntervals": MCD_ALONE,
    "AbsoluteCalibrator": "conformal without σ (absolute)",
    "QuantileCalibrator": "conformalized quantile regression",
    "MondrianCalibrator": f"{MCD_CP}, per known group (Mondrian)",
    "HierarchicalCalibrator": f"{MCD_CP}, for new groups (hierarchical)",
}
"""Calibrator class → the words used in tables."""


@dataclass(frozen=True)
class Run:
    """One run's folder.

    Attributes:
        folder: where it is.
        record: content of run.json; empty without one that can be read.
        name: such as "Run 2" or "Run 3, job 0", by which a comparison refers to it.
        distinction: what sets it apart from other jobs of its multirun, such as "mcd.passes=5".
    """

    folder: Path
    record: Mapping[str, object]
    name: str = ""
    distinction: str = ""

    @cached_property
    def tables(self) -> Mapping[Schema, pd.DataFrame]:
        """Those whose files are there, read when first asked for; a damaged one raises."""
        present = [schema for schema in TABLES if (self.folder / schema.file).is_file()]
        return {schema: read_csv(self.folder / schema.file, schema) for schema in present}

    @property
    def per_dof(self) -> pd.DataFrame:
        """results.csv."""
        return self.tables[RESULTS]

    @property
    def settings(self) -> Mapping[str, object]:
        """All that another process needs to repeat the run."""
        return self.mapping("settings")

    @property
    def weights(self) -> Mapping[str, object]:
        """Fingerprint, path, whether they were reused, how long their training took."""
        return self.mapping("weights")

    @property
    def label(self) -> str:
        """What the data are."""
        return self.entry("label") or f"data {UNKNOWN}"

    @property
    def calibrator(self) -> str | None:
        """Class of the interval method."""
        target = self.setting("interval.calibrator._target_")
        return target.rpartition(".")[2] if target else None

    @property
    def calibrator_class(self) -> type[IntervalCalibrator] | None:
        """The interval method; None if it is none of ours."""
        kind = getattr(uncal.uncertainty, self.calibrator or "", None)
        return kind if isinstance(kind, type) and issubclass(kind, IntervalCalibrator) else None

    @property
    def method(self) -> str:
        """The interval method in words."""
        name = self.calibrator
        return METHODS.get(name, name) if name else f"interval method {UNKNOWN}"

    @property
    def guarantee(self) -> Guarantee:
        """What the interval method guarantees; of one that is not known, nothing."""
        kind = self.calibrator_class
        return "none" if kind is None else guarantee_of(kind)

    @property
    def caveat(self) -> str | None:
        """:func:`band_caveat` as far as the settings tell; None where they do not."""
        kind, split_by = self.calibrator_class, self.setting("split.by")
        if kind is None or split_by is None:
            return None
        return band_caveat(guarantee_of(kind), split_by, self.setting("split.test") or "own")

    @property
    def source(self) -> str:
        """Name, data and method in one cell."""
        job = f" ({self.distinction})" if self.distinction else ""
        return f"{self.name}{job}: {self.label}; {self.method}"

    @property
    def origin(self) -> str:
        """The command of the run, its seed, commit and data."""
        command = self.entry("command") or f"command {UNKNOWN} (no {NAME})"
        seed, commit = (self.entry(key) or UNKNOWN for key in ("seed", "commit"))
        return f"{self.name}: {command} · seed {seed} · commit {commit} · {self.label}"

    @property
    def missing(self) -> list[str]:
        """One sentence for each file that is not there."""
        lost = {} if self.record else {NAME: "command, commit and what was reused"}
        lost |= {schema.file: schema.lost for schema in TABLES if schema not in self.tables}
        return [f"no {file}, hence without {what}" for file, what in lost.items()]

    @cached_property
    def summary(self) -> PoseErrors | None:
        """Errors of the whole pose, from the single predictions; None without them."""
        predictions = self.tables.get(PREDICTIONS)
        if predictions is None:
            return None
        scale = torch.tensor(DOF_SCALE, dtype=torch.float64)
        truth, estimate = (
            torch.tensor(predictions[column].to_numpy()).reshape(-1, len(DOF_NAMES)) / scale
            for column in ("truth", "estimate")
        )
        return pose_errors(estimate, truth, int(self.per_dof["n_calibration"].iloc[0]))

    def mapping(self, key: str) -> Mapping[str, object]:
        """An entry of the record that is a mapping; empty where it is not."""
        value = self.record.get(key)
        return value if isinstance(value, dict) else {}

    def entry(self, key: str) -> str | None:
        """An entry of the record as text."""
        value = self.record.get(key)
        return None if value is None or value == "" else str(value)

    def setting(self, key: str) -> str | None:
        """A setting as text, such as ``mcd.passes``; None where it is not there."""
        try:
            value = OmegaConf.select(OmegaConf.create(dict(self.settings)), key)
        except OmegaConfBaseException:  # a reference to something that only lived in the run
            return None
        return None if value is None else str(value)


def read_run(folder: Path, name: str = "") -> Run:
    """Read what a run has left; only results.csv must be there.

    Raises:
        UncalError: the run failed, there are no results, or a file is damaged.
    """
    if (reason := why_failed(folder)) is not None:
        raise UncalError(
            f"{folder}: this run failed ({reason}), so it has nothing to compare. Run it again, or "
            "leave it out."
        )
    if not (folder / RESULTS.file).is_file():
        raise UncalError(
            f"{folder}: no {RESULTS.file}, so this is no folder of a finished run. Expected a "
            "folder that python -m uncal.train or uncal.evaluate has written and named at its end, "
            "or a multirun's folder with such folders in it."
        )
    run = Run(folder, read_record(folder) or {}, name)
    _ = run.tables  # a damaged one is named here
    return run


def why_failed(folder: Path) -> str | None:
    """The reason in one line why a job of a multirun failed; None if it did not."""
    path = folder / FAILED
    if not path.is_file():
        return None
    return " ".join(path.read_text(encoding="utf-8").split()) or "for a reason unknown"
