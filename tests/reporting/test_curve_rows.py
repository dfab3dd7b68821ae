from __future__ import annotations

import pytest
import torch

from uncal.reporting.curve_rows import CURVE_LEVELS, curve_rows, curve_section
from uncal.reporting.predictions import Predictions
from uncal.uncertainty import ConformalCalibrator, coverage_band


def _tested(errors: torch.Tensor) -> Predictions:
    target = errors.double()[:, None].expand(-1, 6).clone()
    return Predictions.of(torch.zeros_like(target), torch.ones_like(target), target)


def _calibrator() -> ConformalCalibrator:
    """Scores 1…19: Q is k at the level k/20."""
    scores = torch.arange(1.0, 20.0)[:, None].expand(19, 6)
    return ConformalCalibrator().fit(torch.zeros(19, 6), torch.ones(19, 6), scores)


def test_levels_are_the_decimals_they_print_as() -> None:
    assert CURVE_LEVELS[:3] == (0.05, 0.1, 0.15)
    assert (len(CURVE_LEVELS), CURVE_LEVELS[-1]) == (19, 0.95)


def test_a_perfect_curve() -> None:
    rows = curve_rows(_tested(torch.arange(0.5, 20.0)), _calibrator())
    assert len(rows) == 6 * 19
    assert all(row.picp == pytest.approx(row.level) for row in rows)
    assert all(row.in_band for row in rows)
    assert [(row.dof, row.level) for row in rows[:2]] == [("X", 5.0), ("X", 10.0)]
    low, high = coverage_band(20, 19, 0.95)
    assert (rows[0].coverage_low, rows[0].coverage_high) == (100 * low, 100 * high)
    section = curve_section(rows, "exact")
    assert section.title == "Calibration curve, 5% to 95%"
    assert section.grid[1][1:] == ["0.0"] * 6
    assert section.grid[3] == ["Levels outside the allowed band", *["0"] * 6]


def test_too_wide_and_too_narrow() -> None:
    wide = curve_rows(_tested(torch.zeros(20)), _calibrator())
    assert all(row.picp == 100.0 for row in wide)
    grid = curve_section(wide, "none").grid
    assert len(grid) == 3  # no band is claimed
    assert grid[1][1:] == ["50.0"] * 6
    assert grid[2][1:] == ["+50.0"] * 6
    narrow = curve_rows(_tested(torch.full((20,), 99.0)), _calibrator())
    assert curve_section(narrow, "none").grid[2][1:] == ["-50.0"] * 6
    assert int(curve_section(narrow, "exact").grid[3][1]) > 0
