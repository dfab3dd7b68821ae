"""The experiment's tables as CSV files and one Markdown page."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pandas as pd

from uncal.geometry import DOF_NAMES
from uncal.monitor.experiment.summary import WATCHERS, unit_of
from uncal.reporting.layout import Grid, markdown_lines, number, write_whole

NAME = "monitor"

ABOUT: dict[str, str] = {
    "detection": "Share of drives in which the move is noticed within the rest of the drive, and "
    "the median delay in frames from the first moved frame (0: at once), of those drives.",
    "alarms": "Drives at rest, from the first full window on. An alarm is a run of frames that say "
    "that the extrinsic is wrong; upper: one-sided 95 % bound, if alarms were a Poisson process.",
    "error": "Mean over the last window of each drive, of the DoF that moved (its unit) and of all "
    "translations and rotations (norm). Monitor: the extrinsic in use; mean and single: the "
    "nominal one corrected by that estimate.",
    "coverage": "Share of frames with a full window whose 90 % interval holds the decalibration of "
    "the extrinsic in use, per DoF and for the joint box. While the window holds frames of both "
    "sides of a step, there is no one truth.",
    "updates": "Changes of the extrinsic in use; harmful: the root mean square over the DoF, in "
    "units of the range of decalibrations (10 cm, 1°), is larger after it. Largest harm: by how "
    "much.",
    "faults": "Share of frames with the verdict untrusted, before the fault (from the first full "
    "window on) and during it; share of drives flagged at least once; median delay in frames; "
    "share of faulty frames that say instead that the LiDAR has moved; updates during the fault.",
    "blind": "The monitor, and the same one fed with the images of another drive (which never "
    "updates). Response: change of the running mean against the same drive without the step, over "
    "the true change; 1 follows the move, 0 does not.",
}

TITLES: dict[str, str] = {
    "detection": "Detection of a move",
    "alarms": "False alarms",
    "error": "Error at the end of the drive",
    "coverage": "Coverage",
    "updates": "Updates of the extrinsic in use",
    "faults": "Faults of the stream",
    "blind": "Without the right images",
}

DIGITS: dict[str, int] = {
    **{"size": 1, "hours": 3, "response": 2, "largest_harm": 3},
    **{f"{name}_{unit}": 2 for name in ("nothing", "monitor", "mean", "single")
       for unit in ("dof", "cm", "deg")},
}  # fmt: skip
"""Of columns with other than whole percents, frames or counts."""


def write_tables(
    folder: Path, tables: dict[str, pd.DataFrame], notes: Iterable[str], command: str
) -> str:
    """Write ``monitor_<table>.csv`` and ``monitor.md``.

    Args:
        folder: must exist.
        tables: by name, as :meth:`uncal.monitor.experiment.summary.Experiment.tables`.
        notes: sentences that the page ends with: sizes, seed, commit.
        command: that made it.

    Returns:
        The page.
    """
    lines = ["# The monitor on drives in which the LiDAR moves", ""]
    lines += [f"    {command}", "", *(f"- {note}" for note in notes), ""]
    for name, table in tables.items():
        write_whole(folder / f"{NAME}_{name}.csv", table.to_csv(index=False))
        if len(table):
            lines += [f"## {TITLES[name]}", "", ABOUT[name], ""]
            lines += [*markdown_lines(_grid(table)), ""]
    page = "\n".join(lines)
    write_whole(folder / f"{NAME}.md", page)
    return page


def _grid(table: pd.DataFrame) -> Grid:
    kept = [name for name in table.columns if name != "dof" or "size" not in table.columns]
    grid = [[name.replace("_", " ") for name in kept]]
    for _, row in table.iterrows():
        cells = []
        for name in kept:
            value = row[name]
            if name == "size":
                shown = f"{row['dof']} {number(value, 1)} {unit_of(row['dof'])}".strip()
                cells.append(shown if row["dof"] else "–")
            elif isinstance(value, str):
                cells.append(WATCHERS.get(value, value))
            else:
                cells.append(number(float(value), DIGITS.get(name, 1 if name in DOF_NAMES else 0)))
        grid.append(cells)
    return grid
