"""The smaller tables of a report, each a grid of cells made of one frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import pandas as pd
import torch

from uncal.geometry import DOF_NAMES, DOF_UNITS
from uncal.metrics.bootstrap import CONFIDENCE, RESAMPLES
from uncal.metrics.functional import calibration_error
from uncal.reporting.control import blind_dofs
from uncal.reporting.evaluation import Guarantee
from uncal.reporting.layout import Grid, length, markdown_lines, number
from uncal.uncertainty.conformal.quantile import samples_needed

DOF_HEADINGS = [f"{dof} ({unit})" for dof, unit in zip(DOF_NAMES, DOF_UNITS, strict=True)]

OUTSIDE = "*: outside the reference band."

_FEW = 10
"""Fewer groups than this make a bootstrap's interval too narrow to be taken at its word."""


@dataclass(frozen=True)
class Section:
    """A table with what belongs to it.

    Attributes:
        title: what it shows.
        grid: rows of cells, the first the header; the first column names the rows. Empty: no table.
        notes: sentences to print below.
        published: how many of the first rows below the header are a paper's.
        texts: how many of the first columns are words and not numbers.
        groups: a heading above each column, "" where there is none; none at all if empty.
        origins: the commands that gave the rows of runs.
    """

    title: str
    grid: Grid
    notes: Sequence[str] = ()
    published: int = 0
    texts: int = 1
    groups: Sequence[str] = ()
    origins: Sequence[str] = ()

    def markdown(self, heading: str = "##") -> list[str]:
        """Title, table, notes and commands as paragraphs of Markdown."""
        header, *body = self.grid or [[]]
        if self.groups:  # a table in Markdown has one line of headings
            header = [f"{a} {b}".strip() for a, b in zip(self.groups, header, strict=True)]
        return [
            f"{heading} {self.title}",
            *paragraph(markdown_lines([header, *body]) if self.grid else []),
            *paragraph(f"- {note}" for note in self.notes),
            *paragraph(f"    {origin}" for origin in self.origins),
        ]


def paragraph(lines: Iterable[str]) -> list[str]:
    """Lines as one paragraph, none if there are none."""
    text = "\n".join(lines)
    return [text] if text else []


def joint_section(joint: pd.DataFrame, guarantee: Guarantee) -> Section:
    """Coverage of the whole pose, levels as columns."""
    exact = guarantee == "exact"
    boxes = [marked(row["joint"], row["joint_in_band"], exact) for _, row in joint.iterrows()]
    ends = zip(joint["joint_low"], joint["joint_high"], strict=True)
    bands = [f"{number(low, 1)}-{number(high, 1)}" for low, high in ends]
    grid = [
        ["", *(f"{level:g}%" for level in joint["level"])],
        ["All six intervals at once (%)", *numbers(joint["together"], 1)],
        ["Joint box (%)", *boxes],
        *([["Joint box, reference band (%)", *bands]] if exact else []),
        ["Bonferroni box (%)", *numbers(joint["bonferroni"], 1)],
        ["Bonferroni / joint, width", *numbers(joint["bonferroni_size"], 2)],
    ]
    if joint["ellipsoid"].notna().any():
        grid.append(["Joint ellipsoid (%)", *numbers(joint["ellipsoid"], 1)])
        grid.append(["Joint box / ellipsoid, width", *numbers(joint["ellipsoid_size"], 2)])
    notes = [
        "All six intervals at once: the level applies to each DoF alone, not to all six together.",
        "Joint box: intervals for all six DoF at once, from the largest score.",
        *([OUTSIDE] if any("*" in cell for cell in boxes) else []),
        "Bonferroni box: each DoF at level 1 - α/6.",
    ]
    for level, m in zip(joint["level"], joint["n_calibration"], strict=True):
        needed = samples_needed((1 - Fraction(str(level)) / 100) / len(DOF_NAMES))
        if exact and m < needed:
            notes.append(
                f"∞: at {level:g}% the Bonferroni box needs {needed} samples in the uncertainty "
                f"calibration set; there are {m:g}."
            )
    return Section("The whole pose", grid, notes)


def conditional_section(conditional: pd.DataFrame) -> Section:
    """The first level's coverage by σ and by |decalibration|, DoF as columns."""
    level = conditional["level"].iloc[0]
    rows = conditional[conditional["level"] == level]
    bins = int(rows["bin"].max())
    middle = ["middle"] if bins == 3 else [f"{g}." for g in range(2, bins)]
    grid = [["", *DOF_NAMES]]
    for by, title in (("sigma", "σ"), ("decalibration", "|decalibration|")):
        for g, name in enumerate(["lowest", *middle, "highest"], start=1):
            cells = rows[(rows["by"] == by) & (rows["bin"] == g)]
            fewest, most = cells["n"].min(), cells["n"].max()
            size = f"{fewest}" if fewest == most else f"{fewest}-{most}"
            label = f"{title} {name}, {size} frames (%)"
            grid.append([label, *numbers(cells["picp"], 1)])
    usable = rows[rows["n"] > 0].sort_values("n", kind="stable")
    typical = usable.iloc[len(usable) // 2]
    return Section(
        f"Coverage of the {level:g}% intervals by σ and by size of the decalibration",
        grid,
        [
            "Each DoF's test frames in bins of its own σ, and of its own |decalibration|. No "
            "method here guarantees the level within a bin. For a bin independent of the error, "
            f"the reference band of split conformal intervals with {typical['n']} frames is "
            f"{typical['coverage_low']:.1f}-{typical['coverage_high']:.1f}%."
        ],
    )


def curve_section(curve: pd.DataFrame, guarantee: Guarantee) -> Section:
    """How far each DoF's curve is from the diagonal."""
    picp = curve.pivot(index="level", columns="dof", values="picp")[list(DOF_NAMES)]
    levels = [float(level) for level in picp.index]
    shares = torch.tensor(picp.to_numpy() / 100)
    error = calibration_error(shares, [level / 100 for level in levels])
    grid = [
        ["", *DOF_NAMES],
        ["Mean |empirical - nominal| (points)", *numbers((100 * error.absolute).tolist(), 1)],
        ["Mean empirical - nominal (points)", *(f"{100 * e:+.1f}" for e in error.signed.tolist())],
    ]
    notes = [
        "Percentage points; empirical above nominal coverage means intervals wider than needed."
    ]
    if guarantee == "exact":
        outside = (~curve["in_band"].astype(bool)).groupby(curve["dof"]).sum()
        grid.append(["Levels outside the reference band", *(f"{outside[d]}" for d in DOF_NAMES)])
        notes.append("The points of one curve share their test frames, hence are dependent.")
    return Section(f"Calibration curve, {levels[0]:g}% to {levels[-1]:g}%", grid, notes)


def control_section(control: pd.DataFrame) -> Section:
    """The image-blind control, DoF as columns."""
    grid = [
        ["", *DOF_HEADINGS],
        ["MAE before", *lengths(control, "mae_before")],
        ["MAE after, MC mean", *lengths(control, "mae_mean")],
        ["MAE after, one pass without dropout", *lengths(control, "mae_single")],
        ["the same, another frame's image", *lengths(control, "mae_blind")],
        contribution_cells(control),
        [f"{CONFIDENCE:.0%} interval (%)", *_intervals(control)],
    ]
    notes = [
        "Every frame is estimated twice by one pass without dropout: with its own image (or "
        "events), and with that of another frame, drawn at random. Points and decalibration stay "
        "the same. The camera contributes the growth of the error, in percent of MAE before.",
        "A decalibration moves the known pattern of the LiDAR's rings in the image plane, which a "
        "network can read without looking at the image. A DoF whose interval contains 0 is "
        "estimated without the camera, as far as these frames can tell: its gain over MAE before "
        "comes from that pattern, and would be lost on a vehicle, where the pattern moves with "
        "the LiDAR.",
        "The camera can contribute more than the network gains over MAE before: a wrong image does "
        "not only inform less, it misleads.",
        f"{_bootstrap_note(control)} {RESAMPLES} resamples of {control['n'].iloc[0]} frames.",
    ]
    if blind := blind_dofs(control):
        notes.append(f"Not shown to need the camera here: {', '.join(blind)}.")
    return Section("What the camera contributes: the image-blind control", grid, notes)


def contribution_cells(control: pd.DataFrame) -> list[str]:
    """The line of the main table: its name and one cell per DoF."""
    return ["camera contributes (%)", *map(_percent, control["contribution"])]


def contribution_line(control: pd.DataFrame) -> str:
    """The line of the summary, which has the intervals."""
    values = zip(control["dof"], contribution_cells(control)[1:], _intervals(control), strict=True)
    cells = ", ".join(f"{dof} {value} ({interval})" for dof, value, interval in values)
    return f"Camera contributes (%, {CONFIDENCE:.0%} interval): {cells}"


def contribution_note(control: pd.DataFrame) -> str:
    """What the line of the main table means."""
    note = (
        "Camera contributes: the mean absolute error that another frame's image adds, in percent "
        f"of the decalibration. {_bootstrap_note(control)}"
    )
    blind = blind_dofs(control)
    return f"{note} Not shown to need the camera: {', '.join(blind)}." if blind else note


def _bootstrap_note(control: pd.DataFrame) -> str:
    """Where the interval comes from, and whether it is too narrow."""
    groups, n_groups = control["groups"].iloc[0], int(control["n_groups"].iloc[0])
    note = f"Intervals: {CONFIDENCE:.0%} bootstrap over {n_groups} {groups}"
    if n_groups < _FEW:
        return f"{note}; too few of them for more than an indication, the intervals are too narrow."
    if groups == "frames":
        return f"{note} of one drive, which are dependent: rather too narrow."
    return f"{note}."


def main_grid(per_dof: pd.DataFrame, control: pd.DataFrame | None, exact: bool) -> Grid:
    """The paper's table, DoF as columns: a heading, the errors, three lines per level."""
    by_level = list(per_dof.groupby("level", sort=False))
    errors = by_level[0][1]
    grid = [
        ["", *DOF_HEADINGS],
        ["MAE before", *lengths(errors, "mae_before")],
        ["MAE after", *lengths(errors, "mae_after")],
        ["after / before", *numbers(errors["ratio"], 2)],
        *([] if control is None else [contribution_cells(control)]),
    ]
    for level, rows in by_level:
        first = rows.iloc[0]
        band = f", reference band {first['coverage_low']:.1f}-{first['coverage_high']:.1f}"
        picp = [marked(row["picp"], row["in_band"], exact) for _, row in rows.iterrows()]
        grid += [
            [f"{level:g}% PICP{band if exact else ''} (%)", *picp],
            [f"{level:g}% MPIW", *lengths(rows, "mpiw")],
            [f"{level:g}% IS", *lengths(rows, "is")],
        ]
    return grid


def lengths(frame: pd.DataFrame, column: str) -> list[str]:
    """A column of lengths and angles as cells."""
    return [length(v, unit) for v, unit in zip(frame[column], frame["unit"], strict=True)]


def numbers(values: Iterable[float], digits: int) -> list[str]:
    """Numbers as cells."""
    return [number(value, digits) for value in values]


def marked(coverage: float, in_band: object, exact: bool) -> str:
    """Coverage in percent as a cell, with a star if it is outside the band that must hold it."""
    return number(coverage, 1) + ("*" if exact and not in_band else "")


def _percent(value: float) -> str:
    return number(round(value, 1) + 0.0, 1)  # + 0.0: no "-0.0"


def _intervals(control: pd.DataFrame) -> list[str]:
    ends = zip(control["contribution_low"], control["contribution_high"], strict=True)
    return [f"{_percent(low)} to {_percent(high)}" for low, high in ends]
