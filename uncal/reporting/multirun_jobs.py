"""The jobs of a Hydra multirun, read back from the folders that they left."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml  # type: ignore[import-untyped]

from uncal.reporting.tables import COLUMNS

FAILED = "failed.txt"
"""In the folder of a job that raised: why."""

UNFINISHED = "no results.csv: still running, interrupted, or without callbacks.report"

REPLICATES = ("seed", "mcd.seed")
"""Keys whose values repeat an experiment instead of changing it."""

STATE = ("results.csv", "joint.csv", "control.csv", "run.json", FAILED, ".hydra/overrides.yaml")
"""The files of a job that a summary depends on."""

_NUMBERS = [column for column in COLUMNS if column not in ("dof", "unit", "in_band")]

_HEADING = re.compile(r"# Results on (?P<label>.*) data")
_SEED = re.compile(r"^seed: *(?P<seed>\S+) *$", re.MULTILINE)


@dataclass(frozen=True)
class Job:
    """One job of a multirun.

    Attributes:
        folder: the job's, relative to the multirun's.
        overrides: key → value, as on a command line; without the keys of Hydra itself.
        seed: of the composed configuration; None where it has none.
        label: what the data are, as in the heading of the job's results.md; None without one.
        rows: of the job's results.csv, column → text as in the file; empty if it failed.
        failure: why there are no rows; None if there are.
        joint: level → row of the job's joint.csv, where there is one.
        control: DoF → row of the job's control.csv, where there is one.
        weights: fingerprint of the trained weights; None where the job's run.json has none.
        reused: whether those weights were found instead of trained; None where that is not known.
        failed: whether the job raised; a job without results that did not may be running.
    """

    folder: str
    overrides: Mapping[str, str]
    seed: str | None
    label: str | None
    rows: tuple[Mapping[str, str], ...]
    failure: str | None
    joint: Mapping[float, Mapping[str, str]] = field(default_factory=dict)
    control: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    weights: str | None = None
    reused: bool | None = None
    failed: bool = False

    @property
    def mask_seed(self) -> str | None:
        """``mcd.seed`` if it was set; else it follows the seed and says nothing of its own."""
        return self.overrides.get("mcd.seed")


def read_jobs(folder: Path) -> list[Job]:
    """All jobs below a multirun's folder, in the order of their folders' numbers.

    Files may be missing or half there, because other processes are at work on them: a job then
    counts as unfinished, and the next summary, after the change, has it right.

    Args:
        folder: ``hydra.sweep.dir``.

    Returns:
        Finished, failed and unfinished jobs; a folder without Hydra's record is no job's.
    """
    return [_read_job(each, each.relative_to(folder).as_posix()) for each in job_folders(folder)]


def job_folders(folder: Path) -> list[Path]:
    """Where jobs are, in the order of their numbers.

    Args:
        folder: ``hydra.sweep.dir``.
    """
    records = folder.glob("**/.hydra/overrides.yaml")
    return sorted((path.parent.parent for path in records), key=_numbers_as_numbers)


def swept_keys(jobs: Sequence[Job]) -> tuple[str, ...]:
    """The overrides whose value differs between the jobs, without :data:`REPLICATES`, in order.

    Args:
        jobs: of one multirun.

    >>> jobs = [Job(n, {"a": n, "b": "1"}, None, None, (), None) for n in ("0", "1")]
    >>> swept_keys(jobs)
    ('a',)
    """
    keys = dict.fromkeys(key for job in jobs for key in job.overrides if key not in REPLICATES)
    return tuple(key for key in keys if len({job.overrides.get(key) for job in jobs}) > 1)


def as_mapping(overrides: Iterable[object]) -> dict[str, str]:
    """Overrides as key → value.

    Args:
        overrides: as on a command line.

    >>> as_mapping(["+sweeps=passes", "mcd.passes=5", "~logger"])
    {'sweeps': 'passes', 'mcd.passes': '5', 'logger': ''}
    """
    pairs = (str(item).partition("=") for item in overrides)
    return {key.lstrip("+~"): value for key, _, value in pairs}


def _numbers_as_numbers(path: Path) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", path.as_posix())
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def _read_job(path: Path, folder: str) -> Job:
    overrides = _overrides(path)
    seed = _SEED.search(_text(path / ".hydra" / "config.yaml"))
    label = _HEADING.match(_text(path / "results.md"))
    rows, failure = _results(path)
    known = bool(rows)
    weights, reused = _weights(path)
    return Job(
        folder=folder,
        overrides=overrides,
        seed=seed["seed"] if seed and seed["seed"] != "null" else None,
        label=label["label"] if label else None,
        rows=rows,
        failure=failure,
        joint={float(row["level"]): row for row in _table(path / "joint.csv")} if known else {},
        control={row["dof"]: row for row in _table(path / "control.csv")} if known else {},
        weights=weights,
        reused=reused,
        failed=(path / FAILED).is_file(),
    )


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def _table(path: Path) -> tuple[Mapping[str, str], ...]:
    return tuple(csv.DictReader(_text(path).splitlines()))


def _overrides(path: Path) -> dict[str, str]:
    try:
        listed = yaml.safe_load(_text(path / ".hydra" / "overrides.yaml"))
    except yaml.YAMLError:  # Hydra is writing it just now
        listed = None
    return as_mapping(listed or [])


def _weights(path: Path) -> tuple[str | None, bool | None]:
    """Fingerprint of the weights and whether they were found instead of trained."""
    try:
        weights = json.loads(_text(path / "run.json") or "{}").get("weights") or {}
    except json.JSONDecodeError:
        return None, None
    return weights.get("fingerprint"), weights.get("reused")


def _results(path: Path) -> tuple[tuple[Mapping[str, str], ...], str | None]:
    """The rows, or why there are none; a job that failed may have left those of an earlier one."""
    if (path / FAILED).is_file():
        return (), " ".join(_text(path / FAILED).split()) or "for a reason unknown"
    rows = _table(path / "results.csv")
    if not rows:
        return (), UNFINISHED
    missing = [column for column in COLUMNS if rows[0].get(column) is None]
    if missing:
        return (), f"results.csv has no {', '.join(missing)}: not written by this version of uncal"
    try:
        _ = [float(row[column]) for row in rows for column in _NUMBERS]
    except (TypeError, ValueError) as error:
        return (), f"results.csv is damaged: {error}"
    return rows, None
