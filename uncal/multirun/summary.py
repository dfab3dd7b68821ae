"""The summary of a multirun: summary.csv for programs, summary.md for people."""

from __future__ import annotations

import csv
import json
import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from uncal.multirun.frame import SUMMARY, jobs_frame, replicates, write_summary_csv
from uncal.multirun.jobs import REPLICATES, STATE, Job, job_folders, read_jobs, swept_keys
from uncal.multirun.tables import camera_table, error_table, level_table, pose_table
from uncal.reporting.layout import markdown_lines, write_whole
from uncal.reporting.sections import Section

if TYPE_CHECKING:
    import pandas as pd

FIGURES = "figures"
CAPTIONS = "captions.csv"
"""In the folder of figures: name, title and caption of each."""

RECORD = "multirun.json"
"""Beside the summary: the command, and the jobs that were planned."""

_NOTES = (
    "MPIW: mean width of the intervals. PICP: empirical coverage. IS: interval score, the lower "
    "the better. after / before: mean over the DoF of mean absolute error after / before.",
    "`summary.csv` has the numbers unrounded, one row per job, level and DoF, with IS and MAE; "
    "the columns are those of `results.csv`, `joint.csv` and `control.csv` in the jobs' folders.",
)

_INFINITE = "∞: the uncertainty calibration set is too small for that level."

_JOINT = (
    "Six at once: how often all six intervals hold, which is not guaranteed. Joint box and "
    "Bonferroni: regions that hold all six DoF at the nominal level."
)

_CAMERA = (
    "(error with another frame's image - error) / decalibration, all mean absolute: what the "
    "camera contributes to the estimate. Near 0 the network calibrates blind."
)

Planned = Sequence[Mapping[str, str]] | None
"""The overrides of every job to come; None if unknown."""


@dataclass(frozen=True)
class MultirunRecord:
    """What started a multirun.

    Attributes:
        command: the command line.
        planned: the overrides of every job to come; None if unknown.
    """

    command: str
    planned: Planned = None

    @classmethod
    def read(cls, folder: Path) -> MultirunRecord | None:
        """The record in a multirun's folder; None where there is none that can be read."""
        try:
            return cls(**json.loads((folder / RECORD).read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return None


def write_summary(folder: Path, command: str, planned: Planned = None) -> list[Job]:
    """Write ``summary.md`` and, once a job has results, ``summary.csv`` into a multirun's folder.

    Jobs that run in parallel call this at the same time. Who reads early may write late, so each
    looks again after writing, and starts over if a job has changed meanwhile.

    Args:
        folder: ``hydra.sweep.dir``.
        command: the command line that started the multirun.
        planned: the overrides of every job to come; None if unknown. Folders of other jobs, of
            an earlier multirun, are then counted and left out.
    """
    record = MultirunRecord(command, planned)
    write_whole(folder / RECORD, f"{json.dumps(asdict(record), indent=1, ensure_ascii=False)}\n")
    for _ in range(10):  # enough for everyone, and an end in any case
        before = _state(folder)
        found = read_jobs(folder)
        jobs = [job for job in found if planned is None or job.overrides in planned]
        if any(job.table is not None for job in jobs):
            write_summary_csv(folder / SUMMARY, jobs)
        else:
            (folder / SUMMARY).unlink(missing_ok=True)
        write_whole(folder / "summary.md", summary_markdown(found, record, folder))
        if _state(folder) == before:
            break
    return jobs


def summary_markdown(found: Sequence[Job], record: MultirunRecord, folder: Path) -> str:
    """The sections as Markdown, with the figures that lie in the multirun's folder."""
    labels = dict.fromkeys(job.label for job in found if job.table is not None and job.label)
    heading = f"# Multirun on {' and '.join(labels)} data" if labels else "# Multirun"
    jobs, *others = summary_sections(found, record, folder)
    lines = [heading, "", f"    {record.command}"]
    for note in jobs.notes:
        lines += ["", note]
    figures = _figures(folder)
    for section in others:
        if section.title == _WITHOUT_RESULTS:
            lines += figures
            figures = []
        lines += ["", f"## {section.title}", "", *markdown_lines(section.grid)]
        lines += [*([""] if section.grid and section.notes else [])]
        lines += [f"- {note}" for note in section.notes]
    return "\n".join([*lines, *figures]) + "\n"


_WITHOUT_RESULTS = "Jobs without results"


def summary_sections(found: Sequence[Job], record: MultirunRecord, folder: Path) -> list[Section]:
    """The jobs in words; all DoF in one table, a table per level, errors; jobs without results."""
    planned = record.planned
    jobs = [job for job in found if planned is None or job.overrides in planned]
    finished = [job for job in jobs if job.table is not None]
    frame = jobs_frame(jobs) if finished else None
    sections = [Section("Jobs", [], _job_notes(found, jobs, frame, record, folder))]
    if frame is not None:
        sections += _tables(frame)
    without = _without_results(jobs, planned or ())
    return [*sections, *([Section(_WITHOUT_RESULTS, [], without)] if without else [])]


def continuation(command: str, folder: Path) -> str:
    """The command that resumes a multirun: the same, with its folder.

    >>> continuation("python -m uncal.train -m mcd.passes=5,10", Path("outputs/many"))
    'python -m uncal.train -m mcd.passes=5,10 hydra.sweep.dir=outputs/many'
    """
    if any(part.startswith("hydra.sweep.dir=") for part in shlex.split(command)):
        return command
    return f"{command} {shlex.quote(f'hydra.sweep.dir={folder}')}"


def _tables(frame: pd.DataFrame) -> list[Section]:
    levels = sorted({float(level) for level in frame["level"]})
    first = f"All DoF, {levels[0]:g}% intervals"
    sections = [Section(first, pose_table(frame, levels[0]))]
    sections += [Section(f"{level:g}% intervals", level_table(frame, level)) for level in levels]
    infinite = frame["mpiw"].map(math.isinf).any()
    joint = "together" in frame.columns
    notes = [*_NOTES, *([_JOINT] if joint else []), *([_INFINITE] if infinite else [])]
    sections[-1] = Section(sections[-1].title, sections[-1].grid, notes)
    if "contribution" in frame.columns:
        errors = "Mean absolute error of one pass without dropout and of the MC mean"
        sections += [
            Section(errors, error_table(frame)),
            Section("What the camera contributes", camera_table(frame), [_CAMERA]),
        ]
    return sections


def _job_notes(
    found: Sequence[Job],
    jobs: Sequence[Job],
    frame: pd.DataFrame | None,
    record: MultirunRecord,
    folder: Path,
) -> list[str]:
    finished = [job for job in jobs if job.table is not None]
    total = max(len(jobs), len(record.planned or ()))
    text = f"Jobs: {total}, with results: {len(finished)}."
    if frame is not None:
        text += (
            f" {_range(frame['n_test'])} frames in the test set, "
            f"{_range(frame['n_calibration'])} in the uncertainty calibration set."
        )
        if repeated := replicates(frame):
            over = " and ".join(f"the {name} {', '.join(v)}" for name, v in repeated.items())
            text += f" Mean ± standard deviation over {over}."
    seeds = dict.fromkeys(job.seed for job in finished if job.seed is not None)
    if len(seeds) == 1:
        text += f" Seed {next(iter(seeds))}."
    known = [job.weights["reused"] for job in finished if "reused" in job.weights]
    if known:
        text += f" {known.count(False)} of {len(known)} jobs trained, "
        text += f"{known.count(True)} reused weights."
    notes = [text]
    leftover = [f"`{job.folder}`" for job in found if job not in jobs]
    if leftover:
        folders = "folder" if len(leftover) == 1 else "folders"
        listed = ", ".join(leftover)
        notes.append(f"Left out: {len(leftover)} {folders} of an earlier multirun ({listed}).")
    if len(finished) < total:
        notes.append("If it is no longer running, this command resumes it:")
        notes.append(f"    {continuation(record.command, folder)}")
    return notes


def _range(sizes: pd.Series[int]) -> str:
    low, high = sizes.min(), sizes.max()
    return f"{low}" if low == high else f"{low}-{high}"


def _figures(folder: Path) -> list[str]:
    listed = folder / FIGURES / CAPTIONS
    if not listed.is_file():
        return []
    lines = ["", "## Figures"]
    for row in csv.DictReader(listed.read_text(encoding="utf-8").splitlines()):
        lines += ["", f"![{row['title']}]({FIGURES}/{row['name']}.png)", "", row["caption"]]
    return lines


def _without_results(jobs: Sequence[Job], planned: Sequence[Mapping[str, str]]) -> list[str]:
    shown = [*swept_keys(jobs), *REPLICATES]
    lines = [
        f"`{job.folder}`{_settings(job.overrides, shown)}: {job.failure}"
        for job in jobs
        if job.table is None
    ]
    begun = [job.overrides for job in jobs]
    differ = [key for key in (planned or [{}])[0] if len({each.get(key) for each in planned}) > 1]
    return lines + [f"not started{_settings(p, differ)}" for p in planned if p not in begun]


def _settings(overrides: Mapping[str, str], keys: Iterable[str]) -> str:
    """What sets a job apart; the command has the rest."""
    pairs = ", ".join(f"{key}={overrides[key]}" for key in keys if key in overrides)
    return f" ({pairs})" if pairs else ""


def _state(folder: Path) -> set[tuple[str, int, int]]:
    """What there is and when it was written."""
    found = set()
    for job in job_folders(folder):
        for name in STATE:
            try:
                stat = (job / name).stat()
            except FileNotFoundError:
                continue
            found.add((f"{job}/{name}", stat.st_mtime_ns, stat.st_size))
    return found
