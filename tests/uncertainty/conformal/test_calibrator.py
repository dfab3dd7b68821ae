"""What every interval method keeps to, whatever it does inside."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable
from fractions import Fraction

import pytest
import torch
from torch import Tensor, nn

from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES
from uncal.metrics.functional import covered
from uncal.uncertainty import (
    AbsoluteCalibrator,
    ConformalCalibrator,
    GaussianIntervals,
    HierarchicalCalibrator,
    IntervalCalibrator,
    MondrianCalibrator,
    NotCalibratedError,
    PredictorIdentity,
    QuantileCalibrator,
    UncertaintyError,
)

SCALES = [0.1, 0.1, 0.1, 0.02, 0.02, 0.02]
METHODS: list[Callable[[], IntervalCalibrator]] = [
    lambda: ConformalCalibrator(DOF_NAMES, sigma_floor=1e-6),
    lambda: GaussianIntervals(DOF_NAMES),
    lambda: AbsoluteCalibrator(DOF_NAMES, SCALES),
    lambda: QuantileCalibrator(DOF_NAMES, SCALES),
    lambda: MondrianCalibrator(DOF_NAMES),
    lambda: HierarchicalCalibrator(DOF_NAMES),
    lambda: HierarchicalCalibrator(DOF_NAMES, method="subsampling", repeats=7),
]
NAMES = ["conformal", "gaussian", "absolute", "quantile", "mondrian", "weighted", "subsampling"]
every_method = pytest.mark.parametrize("build", METHODS, ids=NAMES)
IDENTITY = PredictorIdentity("ab" * 32, 25, (0.25, 0.05), masks="3f2a" * 8)


def _data(m: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    mean = torch.randn(m, 6, generator=generator)
    std = torch.rand(m, 6, generator=generator) + 0.1
    return mean, std, mean + std * torch.randn(m, 6, generator=generator)


def _bounds(mean: Tensor, std: Tensor) -> tuple[Tensor, Tensor]:
    return mean - std, mean + 2 * std


def _groups(m: int, n_groups: int = 40) -> list[str]:
    return [f"rig {i % n_groups}" for i in range(m)]


def _fit(calibrator: IntervalCalibrator, m: int = 400) -> IntervalCalibrator:
    mean, std, target = _data(m)
    return calibrator.fit(
        mean, std, target, groups=_groups(m), bounds=_bounds(mean, std), identity=IDENTITY
    )


@every_method
def test_one_call_serves_all_methods(build: Callable[[], IntervalCalibrator]) -> None:
    calibrator = _fit(build())
    mean, std, target = _data(50, seed=1)
    bounds, groups = _bounds(mean, std), _groups(50)
    single = calibrator.predict(mean, std, 0.8, groups=groups, bounds=bounds)
    joint = calibrator.predict_joint(mean, std, 0.8, groups=groups, bounds=bounds)
    assert single.lower.shape == single.upper.shape == joint.lower.shape == (50, 6)
    assert (single.joint, joint.joint, single.level, joint.level) == (False, True, 0.8, 0.8)
    assert single.lower.isfinite().all()
    assert (joint.upper - joint.lower >= single.upper - single.lower).double().mean() > 0.9
    n_inside = covered(joint.lower, joint.upper, target).all(1).sum()
    assert n_inside >= 30, "far below the level of 80%"


@every_method
def test_state_survives_a_file(build: Callable[[], IntervalCalibrator]) -> None:
    original, fresh = _fit(build()), build()
    file = io.BytesIO()
    torch.save(original.state_dict(), file)
    file.seek(0)
    fresh.load_state_dict(torch.load(file, weights_only=True))
    mean, std, _ = _data(5, seed=1)
    for level in (0.5, 0.8, Fraction(8, 9)):
        ours, theirs = (
            c.predict(mean, std, level, groups=_groups(5), bounds=_bounds(mean, std))
            for c in (fresh, original)
        )
        assert torch.equal(ours.lower, theirs.lower)
        assert torch.equal(ours.upper, theirs.upper)
        joint, their_joint = (c.joint_quantile(level, groups=["rig 3"]) for c in (fresh, original))
        assert torch.equal(joint, their_joint)
    assert fresh.is_fitted
    assert int(fresh.count) == 400
    assert fresh.identity == IDENTITY


@every_method
def test_buffers_are_neither_cast_nor_inference_tensors(
    build: Callable[[], IntervalCalibrator],
) -> None:
    calibrator = build()
    with torch.inference_mode():
        _fit(calibrator)
    before = {name: buffer.clone() for name, buffer in calibrator.named_buffers()}
    nn.ModuleList([calibrator]).to(torch.bfloat16)
    for name, buffer in calibrator.named_buffers():
        assert not buffer.is_inference()
        assert buffer.dtype == before[name].dtype
        assert torch.equal(buffer, before[name])


@every_method
def test_nothing_before_the_fit(build: Callable[[], IntervalCalibrator]) -> None:
    calibrator = build()
    mean, std, _ = _data(1)
    for call in (calibrator.quantile, calibrator.joint_quantile):
        with pytest.raises(NotCalibratedError, match="call fit"):
            call(0.9)
    for predict in (calibrator.predict, calibrator.predict_joint):
        with pytest.raises(NotCalibratedError, match="call fit"):
            predict(mean, std, 0.9)
    with pytest.raises(NotCalibratedError, match="call fit"):
        calibrator.check_matches(IDENTITY)


@every_method
def test_a_failed_fit_leaves_the_fit_before(build: Callable[[], IntervalCalibrator]) -> None:
    calibrator = _fit(build())
    before = {name: buffer.clone() for name, buffer in calibrator.named_buffers()}
    mean, std, target = _data(30)
    target[3, 2] = math.nan
    with pytest.raises(UncertaintyError, match=r"1 of 180 values of target .*Z: 1"):
        calibrator.fit(mean, std, target, groups=_groups(30), bounds=_bounds(mean, std))
    for name, buffer in calibrator.named_buffers():
        assert torch.equal(buffer, before[name])


@pytest.mark.parametrize("build", [METHODS[0], METHODS[2], METHODS[3]], ids=["σ", "|r|", "CQR"])
def test_one_warning_for_both_kinds_of_interval(build: Callable[[], IntervalCalibrator]) -> None:
    calibrator = _fit(build(), m=40)
    mean, std, _ = _data(3)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for predict in (calibrator.predict, calibrator.predict_joint, calibrator.predict):
            box = predict(mean, std, 0.99, bounds=_bounds(mean, std))
            assert torch.isneginf(box.lower).all()
            assert torch.isposinf(box.upper).all()
    assert ["needs 99, 59 more" in str(warning.message) for warning in caught] == [True]


def test_a_level_may_be_a_fraction() -> None:
    calibrator = _fit(ConformalCalibrator())
    # 0.333 and 1/3 of 401 are the 134th score both; 3.33e-1 + 1e-12 is beyond 401/3 = 133.67.
    assert torch.equal(calibrator.quantile(Fraction(1, 3)), calibrator.scores[133])
    assert calibrator.predict(*_data(1)[:2], Fraction(1, 3)).level == pytest.approx(1 / 3)
    with pytest.raises(UncertaintyError, match=r"outside \(0, 1\)"):
        calibrator.quantile(Fraction(3, 2))


@every_method
def test_bonferroni_is_each_output_at_a_sixth_of_alpha(
    build: Callable[[], IntervalCalibrator],
) -> None:
    calibrator = _fit(build())
    mean, std, _ = _data(5)
    bounds = _bounds(mean, std)
    known: dict[str, object] = {"bounds": bounds, "groups": _groups(5)}
    box = calibrator.predict_joint(mean, std, 0.4, method="bonferroni", **known)  # type: ignore[arg-type]
    single = calibrator.predict(mean, std, Fraction(9, 10), **known)  # type: ignore[arg-type]
    assert torch.equal(box.lower, single.lower)
    assert torch.equal(box.upper, single.upper)
    assert (box.level, box.joint) == (0.4, True)


def test_bonferroni_rank_is_exact() -> None:
    # α/D = 0.4/6 = 1/15 of 45 is exactly 3: rank 42 of 44. Floats may lose it.
    mean, std, _ = _data(44)
    target = mean + std * torch.arange(1.0, 45.0)[:, None]
    calibrator = ConformalCalibrator().fit(mean.double(), std.double(), target.double())
    box = calibrator.predict_joint(mean[:1], std[:1], 0.6, method="bonferroni")
    torch.testing.assert_close(box.upper, mean[:1] + 42 * std[:1])


def test_unknown_joint_method() -> None:
    with pytest.raises(ConfigurationError, match='"sidak"; choose "max" or "bonferroni"'):
        _fit(ConformalCalibrator()).predict_joint(*_data(2)[:2], 0.9, method="sidak")  # type: ignore[arg-type]


def test_the_flags_tell_what_a_method_needs() -> None:
    flags = {
        type(c).__name__: (c.guaranteed, c.needs_std, c.needs_bounds, c.needs_groups)
        for c in (build() for build in METHODS)
    }
    assert flags == {
        "ConformalCalibrator": (True, True, False, False),
        "GaussianIntervals": (False, True, False, False),
        "AbsoluteCalibrator": (True, False, False, False),
        "QuantileCalibrator": (True, False, True, False),
        "MondrianCalibrator": (True, True, False, True),
        "HierarchicalCalibrator": (True, True, False, True),
    }


def test_joint_quantile_by_hand() -> None:
    # Scores (1, 20), (2, 19), … (10, 11), … : the larger of the two is 20, 19, … 11, 11, … 20.
    first = torch.arange(1.0, 21.0)
    target = torch.stack([first, 21 - first], 1)
    calibrator = ConformalCalibrator().fit(torch.zeros(20, 2), torch.ones(20, 2), target)
    assert calibrator.joint_scores.tolist() == [x for x in range(11, 21) for _ in range(2)]
    assert calibrator.joint_quantile(0.8).item() == 19.0  # rank ⌈21 · 0.8⌉ = 17
    box = calibrator.predict_joint(torch.zeros(2), torch.tensor([1.0, 0.5]), 0.8)
    assert box.upper.tolist() == [19.0, 9.5]
    assert box.lower.tolist() == [-19.0, -9.5]
