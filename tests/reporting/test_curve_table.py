from __future__ import annotations

import pytest
import torch

from uncal.reporting.evaluation import Evaluation
from uncal.reporting.measure import CURVE_LEVELS, curve_table
from uncal.reporting.sections import curve_section
from uncal.uncertainty import ConformalCalibrator, coverage_band


def _tested(errors: torch.Tensor) -> Evaluation:
    target = errors.double()[:, None].expand(-1, 6).clone()
    zeros = torch.zeros_like(target)
    return Evaluation(zeros, zeros + 1, target, _calibrator())


def _calibrator() -> ConformalCalibrator:
    """Scores 1…19: Q is k at the level k/20."""
    scores = torch.arange(1.0, 20.0)[:, None].expand(19, 6)
    return ConformalCalibrator().fit(torch.zeros(19, 6), torch.ones(19, 6), scores)


def test_levels_are_the_decimals_they_print_as() -> None:
    assert CURVE_LEVELS[:3] == (0.05, 0.1, 0.15)
    assert (len(CURVE_LEVELS), CURVE_LEVELS[-1]) == (19, 0.95)


def test_a_perfect_curve() -> None:
    rows = curve_table(_tested(torch.arange(0.5, 20.0)))
    assert len(rows) == 6 * 19
    assert rows["picp"].tolist() == pytest.approx(rows["level"].tolist())
    assert rows["in_band"].all()
    assert (rows["dof"].tolist()[:2], rows["level"].tolist()[:2]) == (["X", "X"], [5.0, 10.0])
    low, high = coverage_band(20, 19, 0.95)
    assert tuple(rows[["coverage_low", "coverage_high"]].iloc[0]) == (100 * low, 100 * high)
    section = curve_section(rows, "exact")
    assert section.title == "Calibration curve, 5% to 95%"
    assert section.grid[1][1:] == ["0.0"] * 6
    assert section.grid[3] == ["Levels outside the reference band", *["0"] * 6]


def test_too_wide_and_too_narrow() -> None:
    wide = curve_table(_tested(torch.zeros(20)))
    assert (wide["picp"] == 100.0).all()
    grid = curve_section(wide, "none").grid
    assert len(grid) == 3  # no band is claimed
    assert grid[1][1:] == ["50.0"] * 6
    assert grid[2][1:] == ["+50.0"] * 6
    narrow = curve_table(_tested(torch.full((20,), 99.0)))
    assert curve_section(narrow, "none").grid[2][1:] == ["-50.0"] * 6
    assert int(curve_section(narrow, "exact").grid[3][1]) > 0
