from __future__ import annotations

import pytest
import torch
from scipy import stats  # type: ignore[import-untyped]

from uncal.uncertainty import GaussianIntervals, PredictorIdentity, UncertaintyError

LEVELS = [0.5, 0.8, 0.9, 0.95, 0.99, 0.999999]


def _fitted(size: int = 6) -> GaussianIntervals:
    ones = torch.ones(4, size, dtype=torch.float64)
    return GaussianIntervals().fit(ones, ones, 2 * ones)


@pytest.mark.parametrize("level", LEVELS)
def test_z_is_that_of_scipy(level: float) -> None:
    assert _fitted().quantile(level).tolist() == pytest.approx([stats.norm.interval(level)[1]] * 6)


@pytest.mark.parametrize("level", LEVELS)
def test_joint_z_is_that_of_independent_errors(level: float) -> None:
    z = _fitted().joint_quantile(level).item()
    assert (2 * stats.norm.cdf(z) - 1) ** 6 == pytest.approx(level, abs=1e-12)
    bonferroni = stats.norm.isf((1 - level) / 12)
    assert z < bonferroni


def test_intervals_by_hand_and_whatever_the_targets_were() -> None:
    intervals = _fitted(1).predict(torch.tensor([3.0]), torch.tensor([2.0]), 0.9)
    assert intervals.upper.item() == pytest.approx(3 + 2 * 1.6448536, rel=1e-6)
    assert intervals.lower.item() == pytest.approx(3 - 2 * 1.6448536, rel=1e-6)
    assert intervals.std.item() == 2.0


def test_the_fit_keeps_what_it_needs_only() -> None:
    identity = PredictorIdentity("ab" * 32, 25, (0.25,))
    ones = torch.ones(4, 6)
    calibrator = GaussianIntervals().fit(ones, ones, ones, identity=identity)
    assert calibrator.is_fitted
    assert calibrator.scores.shape == (0, 6)
    assert int(calibrator.count) == 4
    calibrator.check_matches(identity)


def test_sigma_guards_hold() -> None:
    zeros = torch.zeros(4, 6)
    with pytest.raises(UncertaintyError, match="σ = 0 in all 4 samples"):
        GaussianIntervals().fit(zeros, zeros, zeros)
    with pytest.raises(UncertaintyError, match="are not positive"):
        _fitted().predict(zeros, zeros, 0.9)
