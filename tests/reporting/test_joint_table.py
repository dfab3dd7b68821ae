from __future__ import annotations

import math
from fractions import Fraction

import pytest
import torch

from uncal.reporting.evaluation import Evaluation
from uncal.reporting.measure import joint_table
from uncal.reporting.sections import joint_section
from uncal.uncertainty import (
    ConformalCalibrator,
    GaussianIntervals,
    IntervalCalibrator,
    NotCalibratedError,
    coverage_band,
)

MILLI = 1e-3


def _calibrator() -> ConformalCalibrator:
    """59 scores 1…59 per DoF; Y's in the reverse order, so that the largest are 30, 31, 31 … 59."""
    scores = torch.arange(1.0, 60.0, dtype=torch.float64)[:, None].expand(59, 6).clone()
    scores[:, 1] = 60 - scores[:, 1]
    zeros = torch.zeros(59, 6, dtype=torch.float64)
    return ConformalCalibrator().fit(zeros, zeros + MILLI, MILLI * scores)


def _tested(errors: list[float], calibrator: IntervalCalibrator | None = None) -> Evaluation:
    """One sample per error in X, in units of σ; the other DoF are exact."""
    target = torch.zeros(len(errors), 6, dtype=torch.float64)
    target[:, 0] = MILLI * torch.tensor(errors, dtype=torch.float64)
    zeros = torch.zeros_like(target)
    return Evaluation(zeros, zeros + MILLI, target, calibrator or _calibrator())


def test_by_hand() -> None:
    # At 90% k = 54: Q is 54 per DoF and 57 jointly. At 1 - 0.1/6 k = 59, so that Bonferroni's is
    # 59. Hence one sample is held by all three, one by the boxes, one by Bonferroni's, one by none.
    row = joint_table(_tested([10.5, 55.5, 58.5, 60.5]), [0.9]).iloc[0]
    assert (row.level, row.n_test, row.n_calibration) == (90.0, 4, 59)
    assert (row.together, row.joint, row.bonferroni) == (25.0, 50.0, 75.0)
    assert row.bonferroni_size == pytest.approx(59 / 57)
    low, high = coverage_band(4, 59, Fraction(1, 10))
    assert (row.joint_low, row.joint_high) == (100 * low, 100 * high)
    assert row.joint_in_band


def test_a_box_out_of_its_band_is_marked_only_where_the_law_holds() -> None:
    rows = joint_table(_tested([70.0] * 200), [0.5, 0.9])
    assert rows["joint_in_band"].tolist() == [False, False]
    exact = joint_section(rows, "exact")
    assert exact.grid[2] == ["Joint box (%)", "0.0*", "0.0*"]
    assert exact.grid[3][0] == "Joint box, reference band (%)"
    assert "*: outside the reference band." in exact.notes
    for guarantee in ("by group", "none"):
        section = joint_section(rows, guarantee)
        assert section.grid[2] == ["Joint box (%)", "0.0", "0.0"]
        assert not any("band" in text for line in section.grid for text in line)
        assert not any("band" in note for note in section.notes)


def test_infinite_bonferroni_boxes_say_what_is_missing(
    recwarn: pytest.WarningsRecorder,
) -> None:
    # 95%: 1 - 0.05/6 needs 119 samples; 99%: both boxes are infinite.
    rows = joint_table(_tested([10.0, 20.0]), [0.9, 0.95, 0.99])
    assert rows["bonferroni"].tolist()[1:] == [100.0, 100.0]
    assert rows["bonferroni_size"][1] == float("inf")
    assert math.isnan(rows["bonferroni_size"][2])
    section = joint_section(rows, "exact")
    assert section.grid[-1] == ["Bonferroni / joint, width", "1.04", "∞", "–"]
    missing = [note for note in section.notes if note.startswith("∞")]
    assert len(missing) == 2
    assert "at 95% the Bonferroni box needs 119 samples" in missing[0]
    # The 99% interval that was asked for is warned of, Bonferroni's levels are not.
    assert {str(each.message).split(" too few for a ")[1][:3] for each in recwarn} == {"99%"}


def test_gaussian_boxes_and_no_calibration() -> None:
    zeros, ones = torch.zeros(5, 6), torch.ones(5, 6)
    fitted = GaussianIntervals().fit(zeros, ones, zeros)
    row = joint_table(_tested([1.0, 2.5, 4.0], fitted), [0.9]).iloc[0]
    # z is 1.64 per DoF, 2.38 for independent six, 2.39 with Bonferroni.
    assert row.together == row.joint == row.bonferroni == pytest.approx(100 / 3)
    assert 1 < row.bonferroni_size < 1.01
    with pytest.raises(NotCalibratedError):
        joint_table(_tested([1.0], ConformalCalibrator()), [0.9])
