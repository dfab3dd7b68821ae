"""What the camera contributes per degree of freedom: the image-blind control with its bootstrap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.reporting.frames import table

if TYPE_CHECKING:
    import pandas as pd

    from uncal.models.control import ControlPrediction
    from uncal.recordings.frame import FrameId

RESAMPLES = 2000
"""Of the bootstrap."""

CONFIDENCE = 0.95
"""Of its interval."""


def control_table(control: ControlPrediction, mae_mean: Sequence[float]) -> pd.DataFrame:
    """One row per degree of freedom.

    Args:
        control: the control's estimates.
        mae_mean: 6 mean absolute errors of the mean of the stochastic passes, cm and degrees.
    """
    target, single, blind = (
        values.double().numpy() for values in (control.target, control.single, control.blind)
    )
    before = np.abs(target)
    with_image, without = np.abs(target - single), np.abs(target - blind)
    kind, groups = resampling_groups(control.frames)
    low, high = bootstrap_ratio(without - with_image, before, groups)
    contribution = _ratio((without - with_image).mean(0), before.mean(0))
    return table(
        [
            {
                "dof": name,
                "unit": DOF_UNITS[j],
                "mae_before": DOF_SCALE[j] * float(before[:, j].mean()),
                "mae_mean": mae_mean[j],
                "mae_single": DOF_SCALE[j] * float(with_image[:, j].mean()),
                "mae_blind": DOF_SCALE[j] * float(without[:, j].mean()),
                "contribution": 100 * float(contribution[j]),
                "contribution_low": 100 * float(low[j]),
                "contribution_high": 100 * float(high[j]),
                "n": len(target),
                "groups": kind,
                "n_groups": len(set(groups)),
            }
            for j, name in enumerate(DOF_NAMES)
        ]
    )


def resampling_groups(frames: Sequence[FrameId]) -> tuple[str, list[str]]:
    """The coarsest grouping with more than one group: frames of a rig or drive are dependent.

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
    names, index = np.unique(np.asarray(groups), return_inverse=True)
    n, width = len(names), above.shape[1]
    sums = np.zeros((n, 2 * width))
    np.add.at(sums, index, np.concatenate([above, below], 1))
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


def blind_dofs(control: pd.DataFrame) -> list[str]:
    """The degrees of freedom whose interval contains 0 or lies below it."""
    return [str(dof) for dof in control["dof"][control["contribution_low"] <= 0]]


def _ratio(above: NDArray[np.float64], below: NDArray[np.float64]) -> NDArray[np.float64]:
    """NaN over 0: a DoF that was never decalibrated."""
    return above / np.where(below > 0, below, np.nan)
