"""What a calibration on one's own recordings says of itself."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import torch

from uncal.calibrate import summary
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import SplitPrediction
from uncal.uncertainty import ConformalCalibrator, coverage_band


def test_the_summary_says_what_is_guaranteed_and_what_is_not() -> None:
    m = 50
    mean, std, target = torch.zeros(m, 6), torch.ones(m, 6), torch.rand(m, 6)
    covariance = torch.eye(6).expand(m, 6, 6)
    scores = SplitPrediction(torch.arange(m), mean, std, target, covariance)
    calibrator = ConformalCalibrator().fit(mean, std, target)
    module = cast(CalibrationModule, SimpleNamespace(calibrator=calibrator))
    text = "\n".join(summary(module, scores, ["a"] * m, [0.9, 0.99]))
    low, high = coverage_band(10_000, m, 0.1, 0.9)
    assert f"coverage is {100 * low:.1f}-{100 * high:.1f}% (with 200 frames" in text
    assert "99%: not possible; it takes 99 frames." in text
    assert f"X {100 * float(calibrator.quantile(0.9)[0]):.2f} cm" in text
    assert "with one drive nothing is known" in text
    two = "\n".join(summary(module, scores, ["a", "b"] * 25, [0.9]))
    assert "interval=hierarchical" in two
