"""The summary of a multirun: summary.csv for programs, summary.md for people."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from uncal.multirun.folder import FIGURES, RECORD, SUMMARY, Multirun, Planned, read_captions
from uncal.multirun.jobs import REPLICATES, STATE, job_folders, shown, swept_keys
from uncal.reporting.layout import write_whole
from uncal.reporting.sections import Section

if TYPE_CHECKING:
    import pandas as pd

    from uncal.multirun.sweep import Sweep

_WITHOUT_RESULTS = "Jobs without results"


def write_summary(folder: Path, command: str, planned: Planned = None) -> Multirun:
    """Write ``summary.md`` and, once a job has results, ``summary.csv`` into a multirun's folder.

    Jobs that run in parallel call this at the same time. Who reads early may write late, so each
    looks again after writing, and starts over if a job has changed meanwhile.
    The arguments are those of :class:`Multirun`.
    """
    record = json.dumps({"command": command, "planned": planned}, indent=1, ensure_ascii=False)
    write_whole(folder / RECORD, f"{record}\n")
    for _ in range(10):  # enough for everyone, and an end in any case
        before = _state(folder)
        multirun = Multirun(folder, command, planned)
        if not multirun.finished:
            (folder / SUMMARY).unlink(missing_ok=True)
        else:
            text, path = multirun.csv(), folder / SUMMARY
            # Its time tells whether the figures show what is in it.
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                write_whole(path, text)
        write_whole(folder / "summary.md", summary_markdown(multirun))
        if _state(folder) == before:
            break
    return multirun


def summary_markdown(multirun: Multirun) -> str:
    """The sections as Markdown, with the figures that lie in the multirun's folder."""
    known = {job.entry("label"): None for job in multirun.found if job.table is not None}
    labels = " and ".join(label for label in known if label)
    jobs, *others = summary_sections(multirun)
    figures = [
        f"![{title}]({FIGURES}/{name}.png)\n\n{caption}"
        for name, title, caption in read_captions(multirun.folder)
    ]
    paragraphs = [f"# Multirun on {labels} data" if labels else "# Multirun"]
    paragraphs += [f"    {multirun.command}", *jobs.notes]
    for section in others:
        if section.title == _WITHOUT_RESULTS and figures:
            paragraphs += ["## Figures", *figures]
            figures = []
        paragraphs += section.markdown()
    paragraphs += ["## Figures", *figures] if figures else []
    return "\n\n".join(paragraphs) + "\n"


def summary_sections(multirun: Multirun) -> list[Section]:
    """The jobs in words; all DoF in one table, a table per level, errors; jobs without results."""
    sections, sweep = [], None
    if multirun.frame is not None:
        # Pandas takes a second to import, which a run that is no multirun has no use for.
        from uncal.multirun.sweep import Sweep
        from uncal.multirun.tables import summary_tables

        sweep = Sweep(multirun.frame)
        sections = summary_tables(sweep)
    if without := _without_results(multirun):
        sections.append(Section(_WITHOUT_RESULTS, [], without))
    return [Section("Jobs", [], _job_notes(multirun, sweep)), *sections]


def continuation(command: str, folder: Path) -> str:
    """The command that resumes a multirun: the same, with its folder.

    >>> continuation("python -m uncal.train -m mcd.passes=5,10", Path("outputs/many"))
    'python -m uncal.train -m mcd.passes=5,10 hydra.sweep.dir=outputs/many'
    """
    if any(part.startswith("hydra.sweep.dir=") for part in shlex.split(command)):
        return command
    return f"{command} {shlex.quote(f'hydra.sweep.dir={folder}')}"


def _job_notes(multirun: Multirun, sweep: Sweep | None) -> list[str]:
    finished = multirun.finished
    total = max(len(multirun.jobs), len(multirun.planned or ()))
    text = f"Jobs: {total}, with results: {len(finished)}."
    if sweep is not None:
        text += (
            f" {_range(sweep.frame['n_test'])} frames in the test set, "
            f"{_range(sweep.frame['n_calibration'])} in the uncertainty calibration set."
        )
        if sweep.repeated:
            over = (f"the {name} {', '.join(values)}" for name, values in sweep.repeated.items())
            text += f" Mean ± standard deviation over {' and '.join(over)}."
    seeds = dict.fromkeys(job.seed for job in finished if job.seed is not None)
    if len(seeds) == 1:
        text += f" Seed {next(iter(seeds))}."
    known = [job.weights["reused"] for job in finished if "reused" in job.weights]
    if known:
        text += f" {known.count(False)} of {len(known)} jobs trained, "
        text += f"{known.count(True)} reused weights."
    notes = [text]
    leftover = [f"`{job.name}`" for job in multirun.found if job not in multirun.jobs]
    if leftover:
        folders = "folder" if len(leftover) == 1 else "folders"
        listed = ", ".join(leftover)
        notes.append(f"Left out: {len(leftover)} {folders} of an earlier multirun ({listed}).")
    if len(finished) < total:
        notes.append("If it is no longer running, this command resumes it:")
        notes.append(f"    {continuation(multirun.command, multirun.folder)}")
    return notes


def _range(sizes: pd.Series[int]) -> str:
    low, high = sizes.min(), sizes.max()
    return f"{low}" if low == high else f"{low}-{high}"


def _without_results(multirun: Multirun) -> list[str]:
    def settings(overrides: Mapping[str, str], keys: Iterable[str]) -> str:
        """What sets a job apart; the command has the rest."""
        pairs = shown(overrides, keys)
        return f" ({pairs})" if pairs else ""

    jobs, planned = multirun.jobs, multirun.planned or ()
    keys = [*swept_keys(jobs), *REPLICATES]
    lines = [
        f"`{job.name}`{settings(job.overrides, keys)}: {job.failure}"
        for job in jobs
        if job.table is None
    ]
    begun = [job.overrides for job in jobs]
    differ = [key for key in (planned or [{}])[0] if len({each.get(key) for each in planned}) > 1]
    return lines + [f"not started{settings(p, differ)}" for p in planned if p not in begun]


def _state(folder: Path) -> set[tuple[str, int, int]]:
    """What there is and when it was written."""
    found = set()
    for path in (job / name for job in job_folders(folder) for name in STATE):
        with suppress(FileNotFoundError):
            stat = path.stat()
            found.add((str(path), stat.st_mtime_ns, stat.st_size))
    return found
