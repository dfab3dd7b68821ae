from __future__ import annotations

import math
from fractions import Fraction

import pandas as pd
import pytest
import torch

from uncal.reporting.evaluation import Evaluation
from uncal.reporting.measure import conditional_table
from uncal.reporting.sections import conditional_section
from uncal.uncertainty import ConformalCalibrator, coverage_band

LEVELS = (0.9, 0.5)


def _calibrator() -> ConformalCalibrator:
    """Scores 1…9: Q is 9 at 90% and 5 at 50%."""
    scores = torch.arange(1.0, 10.0, dtype=torch.float64)[:, None].expand(9, 6)
    zeros = torch.zeros_like(scores)
    return ConformalCalibrator().fit(zeros, zeros + 1e-3, 1e-3 * scores)


def _tested() -> Evaluation:
    """Six samples: σ of X 1…6 mm, errors of X in σ 3 7 | 7 12 | 12 12, decalibrations falling."""
    std = torch.full((6, 6), 1e-3, dtype=torch.float64)
    std[:, 0] = 1e-3 * torch.arange(1, 7)
    target = torch.zeros(6, 6, dtype=torch.float64)
    target[:, 0] = -0.01 * torch.arange(6, 0, -1)
    target[:, 5] = 0.1 * torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    mean = target.clone()
    mean[:, 0] += std[:, 0] * torch.tensor([3, 7, 7, 12, 12, 12])
    return Evaluation(mean, std, target, _calibrator())


def _of(rows: pd.DataFrame, by: str, dof: str, level: float) -> pd.DataFrame:
    found: pd.DataFrame = rows.loc[
        (rows["by"] == by) & (rows["dof"] == dof) & (rows["level"] == level)
    ]
    return found


def test_by_hand() -> None:
    rows = conditional_table(_tested(), LEVELS)
    assert len(rows) == 2 * 4 * 6 * 3
    sigma = _of(rows, "sigma", "X", 90.0)
    assert sigma["bin"].tolist() == [1, 2, 3]
    assert sigma["n"].tolist() == [2, 2, 2]
    assert sigma["picp"].tolist() == [100.0, 50.0, 0.0]
    assert _of(rows, "sigma", "X", 50.0)["picp"].tolist() == [50.0, 0.0, 0.0]
    assert sigma["unit"].tolist() == ["cm"] * 3
    ends = list(zip(sigma["value_from"], sigma["value_to"], strict=True))
    assert ends == [pytest.approx(pair) for pair in ((0.1, 0.3), (0.3, 0.5), (0.5, 0.6))]
    low, high = coverage_band(2, 9, Fraction(1, 10))
    assert tuple(sigma[["coverage_low", "coverage_high"]].iloc[0]) == (100 * low, 100 * high)
    # The decalibration falls where σ rises: the other way round.
    assert _of(rows, "decalibration", "X", 90.0)["picp"].tolist() == [0.0, 50.0, 100.0]


def test_size_of_the_whole_pose() -> None:
    rows = conditional_table(_tested(), [0.9])
    length, angle = _of(rows, "translation", "X", 90.0), _of(rows, "rotation", "X", 90.0)
    assert length["picp"].tolist() == [0.0, 50.0, 100.0]
    assert angle["picp"].tolist() == [100.0, 50.0, 0.0]
    assert (length["unit"].iloc[0], angle["unit"].iloc[0]) == ("cm", "°")
    assert (length["value_from"].iloc[0], length["value_to"].iloc[2]) == pytest.approx((1.0, 6.0))
    assert angle["value_to"].iloc[2] == pytest.approx(math.degrees(0.6))


def test_ties_leave_bins_empty() -> None:
    rows = _of(conditional_table(_tested(), [0.9]), "sigma", "Y", 90.0)
    assert rows["n"].tolist() == [0, 0, 6]
    assert rows["picp"].iloc[2] == 100.0
    assert math.isnan(rows["picp"].iloc[0])
    assert math.isnan(rows["coverage_low"].iloc[0])


def test_the_table_shows_the_first_level() -> None:
    rows = conditional_table(_tested(), LEVELS)
    section = conditional_section(rows)
    assert "90%" in section.title
    assert [line[0] for line in section.grid[1:]] == [
        "σ lowest, 0-2 frames (%)",
        "σ middle, 0-2 frames (%)",
        "σ highest, 2-6 frames (%)",
        "|decalibration| lowest, 0-2 frames (%)",
        "|decalibration| middle, 0-2 frames (%)",
        "|decalibration| highest, 2-6 frames (%)",
    ]
    assert section.grid[1][1:] == ["100.0", "–", "–", "–", "–", "–"]
    assert section.grid[3][1:3] == ["0.0", "100.0"]
    assert "No method here guarantees the level within a bin" in section.notes[0]
