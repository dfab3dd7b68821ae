"""Predictions of one degree of freedom as columns, which is how figures want them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uncal.geometry import DOF_NAMES
from uncal.reporting.prediction_rows import PredictionRow

Column = NDArray[np.float64]


@dataclass(frozen=True)
class DofColumns:
    """All n test frames of one DoF, in centimetres or degrees.

    Attributes:
        dof: its name.
        unit: "cm" or "°".
        truth: (n,) true decalibration.
        estimate: (n,) estimated decalibration.
        bounds: level in percent, ascending → lower and upper ends, (n,) each; they can be infinite.
    """

    dof: str
    unit: str
    truth: Column
    estimate: Column
    bounds: dict[float, tuple[Column, Column]]

    def covered(self, level: float) -> NDArray[np.bool_]:
        """(n,) whether each interval holds the truth.

        Args:
            level: percent, one of ``bounds``.
        """
        lower, upper = self.bounds[level]
        return (lower <= self.truth) & (self.truth <= upper)


def dof_columns(rows: Sequence[PredictionRow]) -> list[DofColumns]:
    """Rows by frame and DoF as columns by DoF.

    Args:
        rows: at least one frame, all six DoF of each.
    """
    levels = sorted(rows[0].bounds)
    columns = []
    for dof in DOF_NAMES:
        own = [row for row in rows if row.dof == dof]
        ends = np.array([[row.bounds[level] for level in levels] for row in own])
        columns.append(
            DofColumns(
                dof,
                own[0].unit,
                np.array([row.truth for row in own]),
                np.array([row.estimate for row in own]),
                {level: (ends[:, k, 0], ends[:, k, 1]) for k, level in enumerate(levels)},
            )
        )
    return columns
