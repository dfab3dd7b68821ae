"""What a run was, as its folder tells: command, data, weights, interval method."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml  # type: ignore[import-untyped]
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

import uncal.uncertainty
from uncal.reporting.predictions import Promise
from uncal.reporting.published.paper import MCD_ALONE, MCD_CP
from uncal.reporting.run_record import read_run
from uncal.uncertainty.calibrator import IntervalCalibrator

UNKNOWN = "not recorded"

METHODS: Mapping[str, str] = {
    "ConformalCalibrator": MCD_CP,
    "GaussianIntervals": MCD_ALONE,
    "AbsoluteCalibrator": "conformal without σ (absolute)",
    "QuantileCalibrator": "conformalized quantile regression",
    "MondrianCalibrator": f"{MCD_CP}, per known group (Mondrian)",
    "HierarchicalCalibrator": f"{MCD_CP}, for new groups (hierarchical)",
}
"""Calibrator class → the words used in tables."""

_HEADING = re.compile(r"# Results on (?P<label>.*) data")


@dataclass(frozen=True)
class Record:
    """What is known of a run; what is not is None.

    Attributes:
        command: that made it.
        label: what the data are.
        seed: the run's.
        commit: of the code.
        version: of uncal.
        finished: ISO time.
        device: such as cpu.
        calibrator: class of the interval method.
        split: by what frames were split.
        passes: number of stochastic passes.
        network: name of the model.
        fingerprint: of the weights.
        reused: whether the weights were trained by an earlier run.
        weights_path: the checkpoint.
        training_seconds: how long that training took.
        stored_passes: split → whether its passes were computed or reused.
        recorded: whether there is a run.json that can be read.
    """

    command: str | None
    label: str | None
    seed: str | None
    commit: str | None
    version: str | None
    finished: str | None
    device: str | None
    calibrator: str | None
    split: str | None
    passes: str | None
    network: str | None
    fingerprint: str | None
    reused: bool | None
    weights_path: str | None
    training_seconds: float | None
    stored_passes: Mapping[str, str]
    recorded: bool

    @property
    def method(self) -> str:
        """The interval method in words."""
        if self.calibrator is None:
            return f"interval method {UNKNOWN}"
        return METHODS.get(self.calibrator, self.calibrator)

    @property
    def alone(self) -> bool:
        """Whether the intervals are those of the paper's Table 2."""
        return self.method == MCD_ALONE

    @property
    def promise(self) -> Promise:
        """What the interval method promises; of one that is not known, nothing."""
        kind = getattr(uncal.uncertainty, self.calibrator or "", None)
        if not (isinstance(kind, type) and issubclass(kind, IntervalCalibrator)):
            return "none"
        if not kind.guaranteed:
            return "none"
        return "by group" if kind.needs_groups else "exact"


def read_record(folder: Path) -> Record:
    """Read run.json; where it or an entry is missing, Hydra's record and the report's heading.

    Args:
        folder: of a run.
    """
    content = read_run(folder)
    found: Mapping[str, object] = content or {}
    settings = _settings(folder, found)
    weights = _mapping(found.get("weights"))
    reused, seconds = weights.get("reused"), weights.get("training_seconds")
    target = _setting(settings, "interval.calibrator._target_")
    return Record(
        command=_text(found, "command"),
        label=_text(found, "label") or _label(folder),
        seed=_text(found, "seed") or _setting(settings, "seed"),
        commit=_text(found, "commit"),
        version=_text(found, "version"),
        finished=_text(found, "finished"),
        device=_text(found, "device"),
        calibrator=target.rpartition(".")[2] if target else None,
        split=_setting(settings, "split.by"),
        passes=_setting(settings, "mcd.passes"),
        network=_setting(settings, "model.name"),
        fingerprint=_text(weights, "fingerprint"),
        reused=reused if isinstance(reused, bool) else None,
        weights_path=_text(weights, "path"),
        training_seconds=float(seconds) if isinstance(seconds, int | float) else None,
        stored_passes={
            split.replace("_", " "): str(origin)
            for split, origin in _mapping(found.get("passes")).items()
        },
        recorded=content is not None,
    )


def _mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, dict) else {}


def _text(content: Mapping[str, object], key: str) -> str | None:
    value = content.get(key)
    return None if value is None or value == "" else str(value)


def _settings(folder: Path, found: Mapping[str, object]) -> DictConfig:
    """Of run.json, else the configuration that Hydra keeps of every job."""
    kept = _mapping(found.get("settings"))
    path = folder / ".hydra" / "config.yaml"
    if kept or not path.is_file():
        return OmegaConf.create(dict(kept))
    try:
        loaded = OmegaConf.load(path)
    except (OSError, ValueError, yaml.YAMLError):
        return OmegaConf.create({})
    return loaded if isinstance(loaded, DictConfig) else OmegaConf.create({})


def _setting(settings: DictConfig, key: str) -> str | None:
    try:
        value = OmegaConf.select(settings, key)
    except OmegaConfBaseException:  # a reference to something that only lived in the run
        return None
    return None if value is None else str(value)


def _label(folder: Path) -> str | None:
    report = folder / "results.md"
    if not report.is_file():
        return None
    heading = _HEADING.match(report.read_text(encoding="utf-8", errors="replace"))
    return heading["label"] if heading else None
