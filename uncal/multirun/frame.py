"""A multirun as one tidy frame: a row per job, level and DoF, beside the values swept."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from uncal.errors import UncalError
from uncal.multirun.jobs import REPLICATES, Job, swept_keys
from uncal.reporting.frames import read_numbers
from uncal.reporting.layout import write_whole

if TYPE_CHECKING:
    import pandas as pd

SUMMARY = "summary.csv"

COLUMNS: tuple[str, ...] = (
    *("dof", "unit", "level", "picp", "mpiw", "is", "ratio", "mae_after", "n_test"),
    *("n_calibration", "coverage_low", "coverage_high", "mae_before"),
)
"""What summary.csv takes from every job's results.csv."""

OPTIONAL: tuple[str, ...] = (
    *("together", "joint", "joint_low", "joint_high", "bonferroni"),
    *("mae_single", "mae_blind", "contribution", "contribution_low", "contribution_high"),
)
"""And from joint.csv (the same for all DoF of a level) and control.csv (for all levels of a DoF),
where there are such files."""

_OWN = ("weights", "reused", "label", "folder")
"""Fingerprint of the weights, whether they were reused, what the data are, the job's folder."""


def jobs_frame(jobs: Sequence[Job]) -> pd.DataFrame:
    """The finished jobs' tables below each other; swept keys and seeds are text, "" where unset."""
    import pandas as pd

    keys, parts = swept_keys(jobs), []
    for job in jobs:
        if job.table is None:
            continue
        swept = {key: job.overrides.get(key, "") for key in keys}
        own = {
            "seed": job.seed or "",
            "mcd.seed": job.mask_seed or "",
            "weights": job.weights.get("fingerprint", ""),
            "reused": job.weights.get("reused", ""),
            "label": job.label or "",
            "folder": job.folder,
        }
        parts.append(job.table.assign(**{k: str(v) for k, v in (swept | own).items()}))
    frame: pd.DataFrame = pd.concat(parts, ignore_index=True)
    before = [*keys, *REPLICATES]
    order = [*before, *(name for name in frame.columns if name not in before)]
    ordered: pd.DataFrame = frame[order]
    return ordered


def summary_csv(jobs: Sequence[Job]) -> str:
    """One row per job, level and DoF; columns that no job has are left out.

    Swept keys, seeds, :data:`COLUMNS`, :data:`OPTIONAL`, then what is the job's own. A cell is
    empty where a job has no such number, "nan" where it has and it is NaN.
    """
    frame = jobs_frame(jobs)
    names = [*swept_keys(jobs), *REPLICATES, *COLUMNS, *OPTIONAL, *_OWN]
    text = frame[[name for name in names if name in frame.columns]].astype(object)
    optional = [name for name in OPTIONAL if name in frame.columns]
    text = text.map(lambda v: repr(float(v)) if isinstance(v, float) else v)
    if optional:
        lacking = frame[optional].isna().groupby([frame["folder"], frame["level"]]).transform("all")
        text[optional] = text[optional].mask(lacking, "")
    used = (text != "").any()
    # Empty for a checkpoint that the user named.
    used["weights"] |= any("fingerprint" in job.weights for job in jobs)
    kept: pd.DataFrame = text.loc[:, used]
    return kept.to_csv(index=False, lineterminator="\n")


def write_summary_csv(path: Path, jobs: Sequence[Job]) -> None:
    """Write it if it has changed: its time then tells whether the figures show what is in it."""
    text = summary_csv(jobs)
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        write_whole(path, text)


def read_summary(path: Path) -> pd.DataFrame | None:
    """Read a multirun's ``summary.csv``; None if there is no such file, or no rows.

    Raises:
        UncalError: it is damaged.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            names = next(csv.reader(file), [])
        text = [*names[: names.index("dof")], "dof", "unit", *_OWN]
        frame = read_numbers(path, text)
        _ = frame["level"], frame["label"], frame["folder"]
    except FileNotFoundError:
        return None
    except (KeyError, ValueError) as error:
        raise UncalError(
            f"{path}: {error}; expected the summary of a multirun as uncal writes it. It is "
            "written anew when the multirun is started again."
        ) from error
    return None if frame.empty else frame


def keys_of(frame: pd.DataFrame) -> list[str]:
    """The swept keys, which stand before ``dof``, without those that repeat an experiment."""
    before = list(frame.columns[: list(frame.columns).index("dof")])
    return [name for name in before if name not in REPLICATES]


def replicates(frame: pd.DataFrame) -> dict[str, list[str]]:
    """What repeats the experiment: "seeds", "mask seeds" or both, with the values."""
    values = {
        name: [value for value in frame[key].unique() if value]
        for key, name in REPLICATES.items()
        if key in frame.columns
    }
    return {name: found for name, found in values.items() if len(found) > 1}
