"""What the camera contributes per degree of freedom: the image-blind control with its bootstrap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.metrics.bootstrap import bootstrap_ratio, ratio

if TYPE_CHECKING:
    from uncal.models.split_prediction import ControlPrediction
    from uncal.recordings.frame import FrameId


def control_table(control: ControlPrediction, mae_mean: Sequence[float]) -> pd.DataFrame:
    """One row per degree of freedom."""
    scale = np.array(DOF_SCALE)
    target, single, blind = (
        values.double().numpy() for values in (control.target, control.single, control.blind)
    )
    before = np.abs(target)
    with_image, without = np.abs(target - single), np.abs(target - blind)
    kind, groups = resampling_groups(control.frames)
    low, high = bootstrap_ratio(without - with_image, before, groups)
    contribution = ratio((without - with_image).mean(0), before.mean(0))
    frame: pd.DataFrame = pd.DataFrame(
        {
            "dof": DOF_NAMES,
            "unit": DOF_UNITS,
            # Column by column, since numpy then sums in pairs, which loses no digits.
            "mae_before": scale * [column.mean() for column in before.T],
            "mae_mean": mae_mean,
            "mae_single": scale * [column.mean() for column in with_image.T],
            "mae_blind": scale * [column.mean() for column in without.T],
            "contribution": 100 * contribution,
            "contribution_low": 100 * low,
            "contribution_high": 100 * high,
            "n": len(target),
            "groups": kind,
            "n_groups": len(set(groups)),
        }
    )
    return frame


def resampling_groups(frames: Sequence[FrameId]) -> tuple[str, list[str]]:
    """The coarsest grouping with more than one group: "rigs", "drives" or "frames", and n labels.

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


def blind_dofs(control: pd.DataFrame) -> list[str]:
    """The degrees of freedom whose interval contains 0 or lies below it."""
    return [str(dof) for dof in control["dof"][control["contribution_low"] <= 0]]
