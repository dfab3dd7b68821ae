"""The smaller tables of a report, each a grid of cells made of one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import torch

from uncal.geometry import DOF_NAMES
from uncal.metrics.bootstrap import CONFIDENCE, RESAMPLES
from uncal.metrics.calibration_curve import calibration_error
from uncal.reporting.control import blind_dofs
from uncal.reporting.evaluation import Guarantee
from uncal.reporting.layout import Grid, length, number
from uncal.uncertainty.conformal.quantile import samples_needed

if TYPE_CHECKING:
    import pandas as pd

_FEW = 10
"""Fewer groups than this make a bootstrap's interval too narrow to be taken at its word."""


@dataclass(frozen=True)
class Section:
    """A small table below the main one.

    Attributes:
        title: what it shows.
        grid: rows of cells, the first the header; the first column names the rows.
        notes: sentences to print below.
    """

    title: str
    grid: Grid
    notes: Sequence[str] = ()


def joint_section(joint: pd.DataFrame, guarantee: Guarantee) -> Section:
    """Coverage of the whole pose, levels as columns."""
    exact = guarantee == "exact"
    marks = ["*" if exact and not inside else "" for inside in joint["joint_in_band"]]
    boxes = [number(v, 1) + mark for v, mark in zip(joint["joint"], marks, strict=True)]
    bands = [
        f"{number(low, 1)}-{number(high, 1)}"
        for low, high in zip(joint["joint_low"], joint["joint_high"], strict=True)
    ]
    grid = [
        ["", *(f"{level:g}%" for level in joint["level"])],
        ["All six intervals at once (%)", *(number(v, 1) for v in joint["together"])],
        ["Joint box (%)", *boxes],
        *([["Joint box, reference band (%)", *bands]] if exact else []),
        ["Bonferroni box (%)", *(number(v, 1) for v in joint["bonferroni"])],
        ["Bonferroni / joint, width", *(number(v, 2) for v in joint["bonferroni_size"])],
    ]
    if joint["ellipsoid"].notna().any():
        grid.append(["Joint ellipsoid (%)", *(number(v, 1) for v in joint["ellipsoid"])])
        sizes = (number(v, 2) for v in joint["ellipsoid_size"])
        grid.append(["Joint box / ellipsoid, width", *sizes])
    notes = [
        "All six intervals at once: the level applies to each DoF alone, not to all six together.",
        "Joint box: intervals for all six DoF at once, from the largest score.",
        *(["*: outside the reference band."] if any(marks) else []),
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
            grid.append([label, *(number(v, 1) for v in cells["picp"])])
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
    error = calibration_error(
        torch.tensor(picp.to_numpy() / 100), [level / 100 for level in levels]
    )
    grid = [
        ["", *DOF_NAMES],
        [
            "Mean |empirical - nominal| (points)",
            *(number(100 * e, 1) for e in error.absolute.tolist()),
        ],
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

    def lengths(column: str) -> list[str]:
        return [length(v, u) for v, u in zip(control[column], control["unit"], strict=True)]

    grid = [
        ["", *(f"{d} ({u})" for d, u in zip(control["dof"], control["unit"], strict=True))],
        ["MAE before", *lengths("mae_before")],
        ["MAE after, MC mean", *lengths("mae_mean")],
        ["MAE after, one pass without dropout", *lengths("mae_single")],
        ["the same, another frame's image", *lengths("mae_blind")],
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


def contribution_line(control: pd.DataFrame) -> dict[str, str]:
    """The line of the summary, which has the intervals."""
    values = zip(control["dof"], contribution_cells(control)[1:], _intervals(control), strict=True)
    cells = (f"{dof} {value} ({interval})" for dof, value, interval in values)
    return {f"Camera contributes (%, {CONFIDENCE:.0%} interval)": ", ".join(cells)}


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


def _percent(value: float) -> str:
    return number(round(value, 1) + 0.0, 1)  # + 0.0: no "-0.0"


def _intervals(control: pd.DataFrame) -> list[str]:
    ends = zip(control["contribution_low"], control["contribution_high"], strict=True)
    return [f"{_percent(low)} to {_percent(high)}" for low, high in ends]
