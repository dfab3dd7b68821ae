from __future__ import annotations

import io
import math
import warnings

import numpy as np
import pytest
import torch
from crepes import ConformalRegressor  # type: ignore[import-untyped]
from mapie.regression import SplitConformalRegressor  # type: ignore[import-untyped]
from sklearn.dummy import DummyRegressor  # type: ignore[import-untyped]
from torch import Tensor, nn

from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES
from uncal.uncertainty import (
    ConformalCalibrator,
    NotCalibratedError,
    PredictorIdentity,
    PredictorMismatchError,
    UncertaintyError,
)

IDENTITY = PredictorIdentity(weights="ab" * 32, passes=25, rates=(0.25, 0.05))


def _data(m: int = 100, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, σ and target of m samples."""
    generator = torch.Generator().manual_seed(seed)
    mean = torch.randn(m, 6, generator=generator)
    std = torch.rand(m, 6, generator=generator) + 0.1
    return mean, std, mean + std * torch.randn(m, 6, generator=generator)


def _fitted(m: int = 100) -> ConformalCalibrator:
    return ConformalCalibrator(DOF_NAMES, sigma_floor=1e-6).fit(*_data(m), identity=IDENTITY)


def test_intervals_by_hand() -> None:
    # Scores |y - ŷ|/σ are 1…100 in shuffled order; the 91st is the 90% quantile.
    score = torch.arange(1.0, 101.0)[torch.randperm(100)][:, None]
    std = torch.full((100, 1), 0.5)
    mean = torch.full((100, 1), 3.0)
    calibrator = ConformalCalibrator().fit(mean, std, mean - 0.5 * score)
    assert calibrator.quantile(0.9).item() == 91.0
    intervals = calibrator.predict(torch.tensor([[10.0]]), torch.tensor([[2.0]]), level=0.9)
    assert intervals.lower.item() == 10.0 - 182.0
    assert intervals.upper.item() == 10.0 + 182.0
    assert (intervals.mean.item(), intervals.std.item(), intervals.level) == (10.0, 2.0, 0.9)


def test_outputs_are_calibrated_apart() -> None:
    mean, std = torch.zeros(9, 2), torch.ones(9, 2)
    target = torch.stack([torch.arange(1.0, 10.0), 10 * torch.arange(1.0, 10.0)], dim=1)
    assert ConformalCalibrator().fit(mean, std, target).quantile(0.9).tolist() == [9.0, 90.0]


def test_mapie_gives_the_same_intervals() -> None:
    rng = np.random.default_rng(0)
    target = rng.standard_t(3, size=200)
    model = DummyRegressor(strategy="constant", constant=0.0).fit(np.zeros((2, 1)), np.zeros(2))
    levels = [0.8, 0.9, 0.95, 0.99]
    oracle = SplitConformalRegressor(model, confidence_level=levels, prefit=True)
    oracle.conformalize(np.zeros((200, 1)), target)
    _, bounds = oracle.predict_interval(np.zeros((1, 1)))
    zeros = torch.zeros(200, 1, dtype=torch.float64)
    calibrator = ConformalCalibrator().fit(zeros, zeros + 1, torch.tensor(target)[:, None])
    for j, level in enumerate(levels):
        ours = calibrator.predict(zeros[:1], zeros[:1] + 1, level)
        assert ours.lower.item() == bounds[0, 0, j]
        assert ours.upper.item() == bounds[0, 1, j]


@pytest.mark.parametrize("confidence", [0.95, 0.99])  # crepes loses a rank at 0.9 and 0.8
def test_crepes_gives_the_same_normalised_intervals(confidence: float) -> None:
    mean, std, target = (t[:, :1].double() for t in _data(250))
    oracle = ConformalRegressor()
    oracle.fit(residuals=(target - mean)[:, 0].numpy(), sigmas=std[:, 0].numpy())
    bounds = oracle.predict_int(
        mean[:20, 0].numpy(), sigmas=std[:20, 0].numpy(), confidence=confidence
    )
    calibrator = ConformalCalibrator().fit(mean, std, target)
    ours = calibrator.predict(mean[:20], std[:20], level=confidence)
    np.testing.assert_allclose(torch.cat([ours.lower, ours.upper], 1).numpy(), bounds, rtol=1e-12)


def test_too_few_samples_give_infinite_intervals_and_one_warning() -> None:
    calibrator = _fitted(m=40)
    mean, std, _ = _data(3)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        intervals = calibrator.predict(mean, std, level=0.99)
        calibrator.predict(mean, std, level=0.99)
    assert torch.isneginf(intervals.lower).all()
    assert torch.isposinf(intervals.upper).all()
    assert ["needs 99, 59 more" in str(warning.message) for warning in caught] == [True]


def test_one_output_vector_without_a_batch() -> None:
    mean, std, _ = _data(1)
    assert _fitted().predict(mean[0], std[0], level=0.9).lower.shape == (6,)


def test_half_precision_is_computed_in_float32() -> None:
    mean, std, _ = (t.bfloat16() for t in _data(4))
    assert _fitted().predict(mean, std, level=0.9).lower.dtype == torch.float32


def test_sigma_floor() -> None:
    mean, std, target = torch.zeros(9, 1), torch.ones(9, 1), torch.arange(1.0, 10.0)[:, None]
    std[8] = 0.0
    calibrator = ConformalCalibrator(sigma_floor=0.5).fit(mean, std, target)
    assert calibrator.quantile(0.9).item() == 18.0  # 9 / 0.5
    intervals = calibrator.predict(mean[:1], torch.zeros(1, 1), level=0.9)
    assert (intervals.std.item(), intervals.upper.item()) == (0.5, 9.0)


def test_state_loads_into_a_fresh_calibrator() -> None:
    original, fresh = _fitted(), ConformalCalibrator(DOF_NAMES, sigma_floor=0.5)
    file = io.BytesIO()
    torch.save(original.state_dict(), file)
    file.seek(0)
    fresh.load_state_dict(torch.load(file, weights_only=True))
    mean, std, _ = _data(5, seed=1)
    for level in (0.5, 0.9, 0.987):
        ours, theirs = fresh.predict(mean, std, level), original.predict(mean, std, level)
        assert torch.equal(ours.lower, theirs.lower)
        assert torch.equal(ours.upper, theirs.upper)
    assert int(fresh.count) == 100
    assert fresh.sigma_floor.item() == pytest.approx(1e-6)
    assert fresh.identity == IDENTITY


def test_state_loads_inside_a_parent_and_over_another_fit() -> None:
    def build() -> nn.ModuleDict:
        return nn.ModuleDict({"net": nn.Linear(2, 6), "calibrator": ConformalCalibrator()})

    saved, other = build(), build()
    assert isinstance(saved["calibrator"], ConformalCalibrator)
    assert isinstance(other["calibrator"], ConformalCalibrator)
    saved["calibrator"].fit(*_data(50))
    other["calibrator"].fit(*_data(77), identity=IDENTITY)
    other.load_state_dict(saved.state_dict())
    assert torch.equal(other["calibrator"].scores, saved["calibrator"].scores)
    assert other["calibrator"].identity is None
    other.load_state_dict(build().state_dict())
    assert not other["calibrator"].is_fitted


def test_fit_in_inference_mode_can_be_loaded_into_and_read_outside() -> None:
    calibrator = ConformalCalibrator()
    with torch.inference_mode():
        calibrator.fit(*_data(50))
    assert not any(buffer.is_inference() for buffer in calibrator.buffers())
    calibrator.load_state_dict(_fitted(50).state_dict())
    assert calibrator.identity == IDENTITY


def test_casts_leave_the_scores_alone() -> None:
    calibrator = _fitted()
    before = calibrator.scores.clone()
    nn.ModuleList([calibrator]).to(torch.bfloat16)
    assert torch.equal(calibrator.scores, before)
    assert calibrator.dropout_rates.dtype == torch.float64


def test_predict_before_fit() -> None:
    mean, std, _ = _data(1)
    assert not ConformalCalibrator().is_fitted
    with pytest.raises(NotCalibratedError, match="call fit"):
        ConformalCalibrator().predict(mean, std, level=0.9)


@pytest.mark.parametrize("level", [0.0, 1.0, 90.0, -0.1, math.nan])
def test_levels_outside_their_range(level: float) -> None:
    mean, std, _ = _data(1)
    with pytest.raises(UncertaintyError, match=r"level = .* outside \(0, 1\)"):
        _fitted().predict(mean, std, level=level)


@pytest.mark.parametrize("broken", ["mean", "std", "target"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_fit_names_the_dof_that_is_not_finite(broken: str, value: float) -> None:
    mean, std, target = _data(10)
    {"mean": mean, "std": std, "target": target}[broken][2:5, 3] = value
    with pytest.raises(UncertaintyError, match=rf"3 of 60 values of {broken} .*Roll: 3"):
        ConformalCalibrator(DOF_NAMES).fit(mean, std, target)


def test_predict_names_the_dof_that_is_not_finite() -> None:
    mean, std, _ = _data(2)
    mean[1, 5] = math.nan
    with pytest.raises(UncertaintyError, match=r"values of mean .*Yaw: 1"):
        _fitted().predict(mean, std, level=0.9)


def test_sigma_zero_is_refused_without_a_floor() -> None:
    mean, std, target = _data(10)
    std[4, 0] = 0.0
    with pytest.raises(UncertaintyError, match=r"1 of 60 σ are not positive .*X: 1.*sigma_floor"):
        ConformalCalibrator(DOF_NAMES).fit(mean, std, target)
    calibrator = ConformalCalibrator(DOF_NAMES).fit(*_data(10))
    with pytest.raises(UncertaintyError, match="X: 1"):
        calibrator.predict(mean, std, level=0.5)


def test_sigma_zero_throughout_is_refused_even_with_a_floor() -> None:
    mean, std, target = _data(10)
    std[:, 2] = 0.0
    with pytest.raises(UncertaintyError, match="σ = 0 in all 10 samples of Z: dropout"):
        ConformalCalibrator(DOF_NAMES, sigma_floor=1e-6).fit(mean, std, target)


def test_negative_sigma_is_refused_even_with_a_floor() -> None:
    mean, std, target = _data(10)
    std[0, 1] = -1.0
    with pytest.raises(UncertaintyError, match=r"Y: 1.*smallest -1"):
        ConformalCalibrator(DOF_NAMES, sigma_floor=1e-6).fit(mean, std, target)


def test_shapes() -> None:
    mean, std, target = _data(10)
    with pytest.raises(UncertaintyError, match=r"target \(9, 6\).*must be \(m, D\)"):
        ConformalCalibrator().fit(mean, std, target[:9])
    with pytest.raises(UncertaintyError, match=r"must be \(m, D\)"):
        ConformalCalibrator().fit(mean[:0], std[:0], target[:0])
    with pytest.raises(UncertaintyError, match="5 outputs for 6 names"):
        ConformalCalibrator(DOF_NAMES).fit(mean[:, :5], std[:, :5], target[:, :5])
    with pytest.raises(UncertaintyError, match=r"\(\.\.\., 6\)"):
        _fitted().predict(mean[:, :5], std[:, :5], level=0.9)


@pytest.mark.parametrize("floor", [-1e-6, math.inf, math.nan])
def test_sigma_floor_out_of_range(floor: float) -> None:
    with pytest.raises(ConfigurationError, match="sigma_floor"):
        ConformalCalibrator(sigma_floor=floor)


def test_check_matches() -> None:
    calibrator = _fitted()
    calibrator.check_matches(IDENTITY)
    other = PredictorIdentity("cd" * 32, 5, (0.25, 0.1))
    with pytest.raises(PredictorMismatchError) as caught:
        calibrator.check_matches(other)
    message = str(caught.value)
    assert "abababababab… then, cdcdcdcdcdcd… now" in message
    assert "passes: 25 then, 5 now" in message
    assert "1 of 2 changed, the first from 0.05 to 0.1" in message


def test_check_matches_without_anything_to_compare() -> None:
    with pytest.raises(NotCalibratedError):
        ConformalCalibrator().check_matches(IDENTITY)
    with pytest.raises(PredictorMismatchError, match="without the predictor's identity"):
        ConformalCalibrator().fit(*_data(10)).check_matches(IDENTITY)


def test_quantile_is_a_copy() -> None:
    calibrator = _fitted()
    calibrator.quantile(0.9).zero_()
    assert (calibrator.quantile(0.9) > 0).all()
