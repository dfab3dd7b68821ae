"""The jobs of a Hydra multirun, read back from the folders that they left."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from omegaconf import OmegaConf

from uncal.reporting.tables import COLUMNS

FAILED = "failed.txt"
"""In the folder of a job that raised: why."""

UNFINISHED = "no results.csv: still running, interrupted, or without callbacks.report"

_HEADING = re.compile(r"# Results on (?P<label>.*) data")


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
    """

    folder: str
    overrides: Mapping[str, str]
    seed: str | None
    label: str | None
    rows: tuple[Mapping[str, str], ...]
    failure: str | None


def read_jobs(folder: Path) -> list[Job]:
    """All jobs below a multirun's folder, in the order of their folders' numbers.

    Args:
        folder: ``hydra.sweep.dir``.

    Returns:
        Finished, failed and unfinished jobs; a folder without Hydra's record is no job's.
    """
    records = folder.glob("**/.hydra/overrides.yaml")
    folders = sorted((path.parent.parent for path in records), key=_numbers_as_numbers)
    return [_read_job(each, each.relative_to(folder).as_posix()) for each in folders]


def swept_keys(jobs: Sequence[Job]) -> tuple[str, ...]:
    """The overrides whose value differs between the jobs, without ``seed``, in their order.

    Args:
        jobs: of one multirun.

    >>> jobs = [Job(n, {"a": n, "b": "1"}, None, None, (), None) for n in ("0", "1")]
    >>> swept_keys(jobs)
    ('a',)
    """
    keys = dict.fromkeys(key for job in jobs for key in job.overrides if key != "seed")
    return tuple(key for key in keys if len({job.overrides.get(key) for job in jobs}) > 1)


def _numbers_as_numbers(path: Path) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", path.as_posix())
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def _read_job(path: Path, folder: str) -> Job:
    rows, failure = _results(path)
    return Job(folder, _overrides(path), _seed(path), _label(path), rows, failure)


def _overrides(path: Path) -> dict[str, str]:
    listed = OmegaConf.load(path / ".hydra" / "overrides.yaml")
    pairs = (str(item).partition("=") for item in listed)
    return {key.lstrip("+~"): value for key, _, value in pairs}


def _seed(path: Path) -> str | None:
    config = path / ".hydra" / "config.yaml"
    seed = OmegaConf.select(OmegaConf.load(config), "seed") if config.is_file() else None
    return None if seed is None else str(seed)


def _label(path: Path) -> str | None:
    report = path / "results.md"
    if not report.is_file():
        return None
    heading = _HEADING.match(report.read_text(encoding="utf-8"))
    return heading["label"] if heading else None


def _results(path: Path) -> tuple[tuple[Mapping[str, str], ...], str | None]:
    """The rows, or why there are none; a job that failed may have left those of an earlier one."""
    failed, table = path / FAILED, path / "results.csv"
    if failed.is_file():
        reason = " ".join(failed.read_text(encoding="utf-8").split())
        return (), reason or "for a reason unknown"
    if not table.is_file():
        return (), UNFINISHED
    with table.open(encoding="utf-8", newline="") as file:
        rows = tuple(csv.DictReader(file))
    missing = [column for column in COLUMNS if not rows or rows[0].get(column) is None]
    if missing:
        return (), f"results.csv has no {', '.join(missing)}: not written by this version of uncal"
    return rows, None
