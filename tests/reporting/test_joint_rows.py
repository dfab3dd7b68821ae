from __future__ import annotations

from fractions import Fraction

import pytest
import torch
from torch import Tensor

from uncal.reporting.joint_rows import joint_rows, joint_section
from uncal.reporting.predictions import Predictions
from uncal.uncertainty import (
    ConformalCalibrator,
    GaussianIntervals,
    Intervals,
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


def _tested(errors: list[float]) -> Predictions:
    """One sample per error in X, in units of σ; the other DoF are exact."""
    target = torch.zeros(len(errors), 6, dtype=torch.float64)
    target[:, 0] = MILLI * torch.tensor(errors, dtype=torch.float64)
    zeros = torch.zeros_like(target)
    return Predictions.of(zeros, zeros + MILLI, target)


def test_by_hand() -> None:
    # At 90% k = 54: Q is 54 per DoF and 57 jointly. At 1 - 0.1/6 k = 59, so that Bonferroni's is
    # 59. Hence one sample is held by all three, one by the boxes, one by Bonferroni's, one by none.
    row = joint_rows(_tested([10.5, 55.5, 58.5, 60.5]), _calibrator(), [0.9])[0]
    assert (row.level, row.n_test, row.n_calibration) == (90.0, 4, 59)
    assert (row.together, row.joint, row.bonferroni) == (25.0, 50.0, 75.0)
    assert row.bonferroni_size == pytest.approx(59 / 57)
    low, high = coverage_band(4, 59, Fraction(1, 10))
    assert (row.joint_low, row.joint_high) == (100 * low, 100 * high)
    assert row.joint_in_band is True


def test_a_box_out_of_its_band_is_marked_only_where_the_law_holds() -> None:
    rows = joint_rows(_tested([70.0] * 200), _calibrator(), [0.5, 0.9])
    assert [row.joint_in_band for row in rows] == [False, False]
    exact = joint_section(rows, "exact")
    assert exact.grid[2] == ["Joint box (%)", "0.0*", "0.0*"]
    assert exact.grid[3][0] == "Joint box, allowed (%)"
    assert "*: outside the allowed band." in exact.notes
    for promise in ("by group", "none"):
        section = joint_section(rows, promise)
        assert section.grid[2] == ["Joint box (%)", "0.0", "0.0"]
        assert not any("allowed" in text for line in section.grid for text in line)
        assert not any("allowed" in note for note in section.notes)


def test_infinite_bonferroni_boxes_say_what_is_missing(
    recwarn: pytest.WarningsRecorder,
) -> None:
    # 95%: 1 - 0.05/6 needs 119 samples; 99%: both boxes are infinite.
    rows = joint_rows(_tested([10.0, 20.0]), _calibrator(), [0.9, 0.95, 0.99])
    assert [row.bonferroni for row in rows[1:]] == [100.0, 100.0]
    assert rows[1].bonferroni_size == float("inf")
    assert rows[2].bonferroni_size != rows[2].bonferroni_size  # NaN
    section = joint_section(rows, "exact")
    assert section.grid[-1] == ["Bonferroni / joint, width", "1.04", "∞", "–"]
    missing = [note for note in section.notes if note.startswith("∞")]
    assert len(missing) == 2
    assert "at 95% the Bonferroni box needs 119 samples" in missing[0]
    # The 99% interval that was asked for is warned of, Bonferroni's levels are not.
    assert {str(each.message).split(" too few for a ")[1][:3] for each in recwarn} == {"99%"}


class _WithoutBoxes(ConformalCalibrator):
    def predict_joint(
        self, mean: Tensor, std: Tensor, *args: object, **kwargs: object
    ) -> Intervals:
        raise NotCalibratedError("a state from before joint scores")


def test_a_method_without_boxes() -> None:
    target = torch.randn(59, 6)
    calibrator = _WithoutBoxes().fit(torch.zeros(59, 6), torch.ones(59, 6), target)
    rows = joint_rows(_tested([1.0]), calibrator, [0.9])
    assert rows[0].together == 100.0
    assert rows[0].joint is rows[0].joint_low is rows[0].joint_in_band is None
    assert rows[0].bonferroni is rows[0].bonferroni_size is None
    assert [line[0] for line in joint_section(rows, "exact").grid[1:]] == [
        "All six intervals at once (%)"
    ]


def test_gaussian_boxes_and_no_calibration() -> None:
    zeros, ones = torch.zeros(5, 6), torch.ones(5, 6)
    rows = joint_rows(_tested([1.0, 2.5, 4.0]), GaussianIntervals().fit(zeros, ones, zeros), [0.9])
    # z is 1.64 per DoF, 2.38 for independent six, 2.39 with Bonferroni.
    assert rows[0].together == rows[0].joint == rows[0].bonferroni == pytest.approx(100 / 3)
    assert rows[0].bonferroni_size is not None
    assert 1 < rows[0].bonferroni_size < 1.01
    with pytest.raises(NotCalibratedError):
        joint_rows(_tested([1.0]), ConformalCalibrator(), [0.9])
