"""What the camera contributes per degree of freedom: the image-blind control as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.reporting.layout import Section, number

if TYPE_CHECKING:
    from uncal.models.control import ControlPrediction
    from uncal.recordings.frame import FrameId

RESAMPLES = 2000
"""Of the bootstrap."""

CONFIDENCE = 0.95
"""Of its interval."""

_FEW = 10
"""Fewer groups than this make a bootstrap's interval too narrow to be taken at its word."""


@dataclass(frozen=True)
class ControlRow:
    """One degree of freedom, in centimetres or degrees; the columns of control.csv.

    Attributes:
        dof: X, Y, Z, Roll, Pitch or Yaw.
        unit: "cm" or "°", of all lengths and angles in the row.
        mae_before: mean |decalibration|.
        mae_mean: mean |decalibration - estimate| of the mean of the stochastic passes, which is
            ``mae_after`` of results.csv.
        mae_single: the same of one pass without dropout.
        mae_blind: the same of that pass, fed with another frame's image.
        contribution: (``mae_blind`` - ``mae_single``) / ``mae_before``, percent.
        contribution_low: lower end of its 95% interval.
        contribution_high: upper end.
        n: frames.
        groups: what the bootstrap draws as one: "rigs", "drives" or "frames".
        n_groups: how many of them there are.
    """

    dof: str
    unit: str
    mae_before: float
    mae_mean: float
    mae_single: float
    mae_blind: float
    contribution: float
    contribution_low: float
    contribution_high: float
    n: int
    groups: str
    n_groups: int


def control_rows(control: ControlPrediction, mae_mean: Sequence[float]) -> list[ControlRow]:
    """One row per degree of freedom.

    Args:
        control: the control's estimates.
        mae_mean: 6 mean absolute errors of the mean of the stochastic passes, cm and degrees.
    """
    target, single, blind = (
        each.double().numpy() for each in (control.target, control.single, control.blind)
    )
    before = np.abs(target)
    with_image, without = np.abs(target - single), np.abs(target - blind)
    kind, groups = resampling_groups(control.frames)
    low, high = bootstrap_ratio(without - with_image, before, groups)
    contribution = _ratio((without - with_image).mean(0), before.mean(0))
    return [
        ControlRow(
            dof=name,
            unit=DOF_UNITS[j],
            mae_before=DOF_SCALE[j] * float(before[:, j].mean()),
            mae_mean=mae_mean[j],
            mae_single=DOF_SCALE[j] * float(with_image[:, j].mean()),
            mae_blind=DOF_SCALE[j] * float(without[:, j].mean()),
            contribution=100 * float(contribution[j]),
            contribution_low=100 * float(low[j]),
            contribution_high=100 * float(high[j]),
            n=len(target),
            groups=kind,
            n_groups=len(set(groups)),
        )
        for j, name in enumerate(DOF_NAMES)
    ]


def resampling_groups(frames: Sequence[FrameId]) -> tuple[str, list[str]]:
    """The coarsest grouping that has more than one group: frames of a rig or drive hang together.

    Args:
        frames: n frames.

    Returns:
        "rigs", "drives" or "frames", and n labels.

    >>> from uncal.recordings.frame import FrameId
    >>> resampling_groups([FrameId("car", "a", 0), FrameId("car", "a", 1), FrameId("car", "b", 0)])
    ('drives', ['car/a', 'car/a', 'car/b'])
    """
    rigs = [frame.rig for frame in frames]
    if len(set(rigs)) > 1:
        return "rigs", rigs
    drives = [f"{frame.rig}/{frame.drive}" for frame in frames]
    if len(set(drives)) > 1:
        return "drives", drives
    return "frames", [str(frame) for frame in frames]


def bootstrap_ratio(
    above: NDArray[np.float64],
    below: NDArray[np.float64],
    groups: Sequence[str],
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Percentile interval of mean(above) / mean(below), from whole groups drawn with replacement.

    Args:
        above: (n, D).
        below: (n, D).
        groups: n labels.
        resamples: how many times to draw as many groups as there are.
        seed: of the draws.

    Returns:
        Lower and upper end, each (D,), at :data:`CONFIDENCE`.

    >>> low, high = bootstrap_ratio(np.array([[1.0], [3.0]]), np.ones((2, 1)), ["a", "b"])
    >>> low.item(), high.item()
    (1.0, 3.0)
    """
    names, which = np.unique(np.asarray(groups), return_inverse=True)
    n, width = len(names), above.shape[1]
    sums = np.zeros((n, 2 * width))
    np.add.at(sums, which, np.concatenate([above, below], 1))
    random = np.random.default_rng(seed)
    at_once = max(1, 2**20 // n)  # a few megabytes, however many groups there are
    parts = []
    for start in range(0, resamples, at_once):
        rows = min(at_once, resamples - start)
        drawn = random.integers(0, n, (rows, n)) + n * np.arange(rows)[:, None]
        times = np.bincount(drawn.ravel(), minlength=rows * n).reshape(rows, n)
        totals = times.astype(np.float64) @ sums
        parts.append(_ratio(totals[:, :width], totals[:, width:]))
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(np.concatenate(parts), [tail, 1 - tail], axis=0)
    return low, high


def blind_dofs(rows: Sequence[ControlRow]) -> list[str]:
    """The degrees of freedom whose interval holds 0 or lies below it.

    Args:
        rows: :func:`control_rows`.
    """
    return [row.dof for row in rows if row.contribution_low <= 0]


def contribution_cells(rows: Sequence[ControlRow]) -> list[str]:
    """The line of the main table: its name and one cell per degree of freedom.

    Args:
        rows: :func:`control_rows`.
    """
    return ["camera contributes (%)", *(_percent(row.contribution) for row in rows)]


def contribution_line(rows: Sequence[ControlRow]) -> dict[str, str]:
    """The line of the summary, which has the intervals.

    Args:
        rows: :func:`control_rows`.
    """
    cells = (f"{row.dof} {_percent(row.contribution)} ({_interval(row)})" for row in rows)
    return {f"Camera contributes (%, {CONFIDENCE:.0%} interval)": ", ".join(cells)}


def contribution_note(rows: Sequence[ControlRow]) -> str:
    """One sentence on what the line of the main table means.

    Args:
        rows: :func:`control_rows`.
    """
    note = (
        "Camera contributes: the mean absolute error that another frame's image adds, in percent "
        f"of the decalibration. {_resampled(rows[0])}"
    )
    blind = blind_dofs(rows)
    return f"{note} Not shown to need the camera: {', '.join(blind)}." if blind else note


def control_section(rows: Sequence[ControlRow]) -> Section:
    """The rows as a small table, degrees of freedom as columns.

    Args:
        rows: :func:`control_rows`.
    """
    first = rows[0]
    grid = [
        ["", *(f"{row.dof} ({row.unit})" for row in rows)],
        ["MAE before", *(_length(row.mae_before, row) for row in rows)],
        ["MAE after, MC mean", *(_length(row.mae_mean, row) for row in rows)],
        ["MAE after, one pass without dropout", *(_length(row.mae_single, row) for row in rows)],
        ["the same, another frame's image", *(_length(row.mae_blind, row) for row in rows)],
        contribution_cells(rows),
        [f"{CONFIDENCE:.0%} interval (%)", *(_interval(row) for row in rows)],
    ]
    notes = [
        "Every frame is estimated twice by one pass without dropout: with its own image (or "
        "events), and with that of another frame, drawn at random. Points and decalibration stay "
        "the same. The camera contributes what the error grows by, in percent of MAE before.",
        "A decalibration moves the known pattern of the LiDAR's rings in the image plane, which a "
        "network can read without a look at the image. A DoF whose interval holds 0 is estimated "
        "without the camera, as far as these frames can tell: whatever it gains over MAE before "
        "comes from that pattern, and would not come on a vehicle, where the LiDAR that moves "
        "takes its pattern along.",
        "The camera can contribute more than the network gains over MAE before: a wrong image does "
        "not only inform less, it misleads.",
        f"{_resampled(first)} {RESAMPLES} resamples of {first.n} frames.",
    ]
    blind = blind_dofs(rows)
    if blind:
        notes.append(f"Not shown to need the camera here: {', '.join(blind)}.")
    return Section("What the camera contributes: the image-blind control", grid, notes)


def _resampled(row: ControlRow) -> str:
    """Where the interval comes from, and whether it is too narrow."""
    said = f"Intervals: {CONFIDENCE:.0%} bootstrap over {row.n_groups} {row.groups}"
    if row.n_groups < _FEW:
        return f"{said}; so few make it too narrow: a hint only."
    if row.groups == "frames":
        return f"{said} of one drive, which hang together: rather too narrow."
    return f"{said}."


def _ratio(above: NDArray[np.float64], below: NDArray[np.float64]) -> NDArray[np.float64]:
    """NaN over 0: a DoF that was never decalibrated."""
    return above / np.where(below > 0, below, np.nan)


def _percent(value: float) -> str:
    return number(round(value, 1) + 0.0, 1)  # + 0.0: no "-0.0"


def _interval(row: ControlRow) -> str:
    return f"{_percent(row.contribution_low)} to {_percent(row.contribution_high)}"


def _length(value: float, row: ControlRow) -> str:
    return number(value, 2 if row.unit == "cm" else 3)
