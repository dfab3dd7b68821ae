from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from mapie.regression import ConformalizedQuantileRegressor  # type: ignore[import-untyped]
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, RegressorMixin  # type: ignore[import-untyped]
from torch import Tensor

from uncal.uncertainty import QuantileCalibrator, UncertaintyError


class _Column(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """A "trained" regressor that reads its prediction off a column of the input."""

    def __init__(self, column: int) -> None:
        self.column = column

    def fit(self, inputs: NDArray[np.float64], target: NDArray[np.float64]) -> _Column:
        self.n_features_in_ = inputs.shape[1]
        return self

    def predict(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(inputs)[:, self.column]


def _outputs(m: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Lower, upper, median and target, (m, 1) each."""
    generator = torch.Generator().manual_seed(3)
    lower = torch.randn(m, 1, generator=generator, dtype=torch.float64)
    upper = lower + 1 + torch.rand(m, 1, generator=generator, dtype=torch.float64)
    target = lower + 0.7 + 2 * torch.randn(m, 1, generator=generator, dtype=torch.float64)
    return lower, upper, lower + 0.7, target


@pytest.mark.parametrize("level", [0.5, 0.8, 0.9, 0.95])
def test_mapie_gives_the_same_intervals(level: float) -> None:
    lower, upper, median, target = _outputs(200)
    inputs = torch.cat([lower, upper, median], 1).numpy()
    models = [_Column(j).fit(inputs, target[:, 0].numpy()) for j in range(3)]
    oracle = ConformalizedQuantileRegressor(models, confidence_level=level, prefit=True)
    oracle.conformalize(inputs, target[:, 0].numpy())
    _, bounds = oracle.predict_interval(inputs[:20], symmetric_correction=True)
    calibrator = QuantileCalibrator().fit(median, 0 * median, target, bounds=(lower, upper))
    ours = calibrator.predict(median[:20], 0 * median[:20], level, bounds=(lower[:20], upper[:20]))
    np.testing.assert_allclose(torch.cat([ours.lower, ours.upper], 1), bounds[:, :, 0], rtol=1e-12)


def test_too_wide_bounds_shrink_and_crossing_ones_become_a_point() -> None:
    zeros = torch.zeros(9, 1)
    # Every target is in the middle of (-4, 4): scores are -4, and so is any quantile.
    calibrator = QuantileCalibrator().fit(zeros, zeros, zeros, bounds=(zeros - 4, zeros + 4))
    assert calibrator.quantile(0.9).item() == -4.0
    wide = calibrator.predict(zeros[:1], zeros[:1], 0.9, bounds=(zeros[:1] - 7, zeros[:1] + 5))
    assert (wide.lower.item(), wide.upper.item()) == (-3.0, 1.0)
    narrow = calibrator.predict(zeros[:1], zeros[:1], 0.9, bounds=(zeros[:1] + 1, zeros[:1] + 2))
    assert (narrow.lower.item(), narrow.upper.item()) == (1.5, 1.5)


def test_bounds_that_cross_already_are_widened_to_hold_the_target() -> None:
    zeros = torch.zeros(9, 1)
    calibrator = QuantileCalibrator().fit(zeros, zeros, zeros, bounds=(zeros + 1, zeros - 1))
    intervals = calibrator.predict(zeros[:1], zeros[:1], 0.9, bounds=(zeros[:1] + 1, zeros[:1] - 1))
    assert (intervals.lower.item(), intervals.upper.item()) == (0.0, 0.0)


def test_joint_score_in_units_of_the_scales() -> None:
    zeros = torch.zeros(1, 2)
    target = torch.tensor([[3.0, 0.5]])
    calibrator = QuantileCalibrator(scales=[2.0, 0.1])
    calibrator.fit(zeros, zeros, target, bounds=(zeros - 1, zeros + 0.2))
    # (3 - 0.2)/2 = 1.4 and (0.5 - 0.2)/0.1 = 3.
    assert calibrator.joint_quantile(0.5).item() == pytest.approx(3.0)
    box = calibrator.predict_joint(zeros, zeros, 0.5, bounds=(zeros, zeros))
    assert box.upper[0].tolist() == pytest.approx([6.0, 0.3])


def test_bounds_are_asked_for_and_checked() -> None:
    zeros = torch.zeros(9, 2)
    with pytest.raises(UncertaintyError, match=r"QuantileCalibrator needs bounds=.*got none"):
        QuantileCalibrator().fit(zeros, zeros, zeros)
    with pytest.raises(UncertaintyError, match=r"both \(9, 2\); got \(9, 2\) and \(9, 1\)"):
        QuantileCalibrator().fit(zeros, zeros, zeros, bounds=(zeros, zeros[:, :1]))
    calibrator = QuantileCalibrator(["X", "Y"]).fit(zeros, zeros, zeros, bounds=(zeros, zeros))
    broken = zeros.clone()
    broken[2, 1] = math.nan
    with pytest.raises(UncertaintyError, match=r"values of the upper bounds .*Y: 1"):
        calibrator.predict(zeros, zeros, 0.5, bounds=(zeros, broken))
    with pytest.raises(UncertaintyError, match="needs bounds"):
        calibrator.predict(zeros, zeros, 0.5)
