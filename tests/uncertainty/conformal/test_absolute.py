from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from mapie.regression import SplitConformalRegressor  # type: ignore[import-untyped]
from sklearn.dummy import DummyRegressor  # type: ignore[import-untyped]

from uncal.errors import ConfigurationError
from uncal.uncertainty import AbsoluteCalibrator, UncertaintyError


def test_mapie_gives_the_same_intervals() -> None:
    target = np.random.default_rng(0).standard_t(3, size=200)
    model = DummyRegressor(strategy="constant", constant=0.3).fit(np.zeros((2, 1)), np.zeros(2))
    levels = [0.5, 0.8, 0.9, 0.95, 0.99]
    oracle = SplitConformalRegressor(
        model, confidence_level=levels, conformity_score="absolute", prefit=True
    )
    oracle.conformalize(np.zeros((200, 1)), target)
    _, bounds = oracle.predict_interval(np.zeros((1, 1)))
    mean = torch.full((200, 1), 0.3, dtype=torch.float64)
    calibrator = AbsoluteCalibrator().fit(mean, 0 * mean, torch.tensor(target)[:, None])
    for j, level in enumerate(levels):
        ours = calibrator.predict(mean[:1], mean[:1], level)
        assert ours.lower.item() == pytest.approx(bounds[0, 0, j], rel=1e-14)
        assert ours.upper.item() == pytest.approx(bounds[0, 1, j], rel=1e-14)


def test_sigma_does_not_matter() -> None:
    generator = torch.Generator().manual_seed(0)
    mean, target = torch.randn(2, 50, 3, generator=generator)
    with_spread = AbsoluteCalibrator().fit(mean, torch.rand(50, 3, generator=generator), target)
    without = AbsoluteCalibrator().fit(mean, torch.zeros(50, 3), target)
    assert torch.equal(with_spread.scores, without.scores)
    wide = with_spread.predict(mean, torch.full_like(mean, 9.0), 0.9)
    assert torch.equal(wide.upper - wide.mean, without.predict(mean, 0 * mean, 0.9).upper - mean)
    assert (wide.std == 9.0).all()


def test_joint_scores_compare_in_units_of_the_scales() -> None:
    # |r| of (0.1 m, 0.02 rad) and (0.05 m, 0.03 rad): in scales (0.1, 0.01) 2 and 3.
    target = torch.tensor([[0.1, 0.02], [-0.05, 0.03]])
    zeros = torch.zeros(2, 2)
    calibrator = AbsoluteCalibrator(scales=[0.1, 0.01]).fit(zeros, zeros, target)
    assert calibrator.joint_scores.tolist() == pytest.approx([2.0, 3.0])
    box = calibrator.predict_joint(zeros[:1], zeros[:1], 0.5)  # rank 2 of 2
    assert box.upper[0].tolist() == pytest.approx([0.3, 0.03])
    assert calibrator.predict(zeros[:1], zeros[:1], 0.5).upper[0].tolist() == pytest.approx(
        [0.1, 0.03]
    )


def test_a_loaded_state_brings_its_scales() -> None:
    zeros = torch.zeros(2, 2)
    saved = AbsoluteCalibrator(scales=[0.1, 0.01]).fit(zeros, zeros, zeros + 0.2)
    fresh = AbsoluteCalibrator()
    fresh.load_state_dict(saved.state_dict())
    box = fresh.predict_joint(zeros[:1], zeros[:1], 0.5)
    assert box.upper[0].tolist() == pytest.approx([2.0, 0.2])


@pytest.mark.parametrize("bad", [0.0, -1.0, math.inf, math.nan])
def test_scales_out_of_range(bad: float) -> None:
    with pytest.raises(ConfigurationError, match="each must be positive"):
        AbsoluteCalibrator(scales=[0.1, bad])


def test_a_scale_per_output() -> None:
    zeros = torch.zeros(5, 3)
    with pytest.raises(UncertaintyError, match="3 outputs for 2 scales"):
        AbsoluteCalibrator(scales=[0.1, 0.1]).fit(zeros, zeros, zeros)
