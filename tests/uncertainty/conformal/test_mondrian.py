from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import torch
from crepes import ConformalRegressor  # type: ignore[import-untyped]
from torch import Tensor

from uncal.uncertainty import ConformalCalibrator, MondrianCalibrator, UncertaintyError


def _data(m: int, size: int = 1, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    mean = torch.randn(m, size, generator=generator, dtype=torch.float64)
    std = torch.rand(m, size, generator=generator, dtype=torch.float64) + 0.1
    return mean, std, mean + std * torch.randn(m, size, generator=generator, dtype=torch.float64)


def _labels(m: int, seed: int = 0) -> list[str]:
    """Three drives of about m/2, m/3 and m/6 frames, shuffled."""
    rng = np.random.default_rng(seed)
    return list(rng.choice(["0001", "0002", "Straße 3"], size=m, p=[1 / 2, 1 / 3, 1 / 6]))


def _crepes(m: int, confidence: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Intervals of 30 new frames from crepes, and ours, (30, 2) each."""
    mean, std, target = _data(m + 30)
    labels = np.array(_labels(m + 30))
    fitted, new = slice(0, m), slice(m, m + 30)
    oracle = ConformalRegressor()
    oracle.fit(
        residuals=(target - mean)[fitted, 0].numpy(),
        sigmas=std[fitted, 0].numpy(),
        bins=labels[fitted],
    )
    bounds = oracle.predict_int(
        mean[new, 0].numpy(), sigmas=std[new, 0].numpy(), bins=labels[new], confidence=confidence
    )
    calibrator = MondrianCalibrator()
    calibrator.fit(mean[fitted], std[fitted], target[fitted], groups=list(labels[fitted]))
    ours = calibrator.predict(mean[new], std[new], confidence, groups=list(labels[new]))
    return torch.from_numpy(bounds), torch.cat([ours.lower, ours.upper], 1)


@pytest.mark.parametrize("confidence", [0.75, 0.5, 0.875])  # 1 - confidence is exact in binary
def test_crepes_gives_the_same_intervals(confidence: float) -> None:
    theirs, ours = _crepes(300, confidence)
    torch.testing.assert_close(ours, theirs, rtol=1e-12, atol=0)


def test_crepes_loses_a_rank_where_the_level_is_no_binary_fraction() -> None:
    # m = 9 at 90%: rank ⌈10 · 0.9⌉ = 9, the largest score. crepes takes int((1 - 0.9) · 10) - 1 in
    # floating point, which is int(0.9999999999999998) - 1 = -1: no finite interval.
    scores = np.arange(1.0, 10.0)
    oracle = ConformalRegressor().fit(residuals=scores, bins=np.array(["a"] * 9))
    with pytest.warns(UserWarning, match="too small"):
        bounds = oracle.predict_int(np.zeros(1), bins=np.array(["a"]), confidence=0.9)
    assert np.isinf(bounds).all()
    zeros, target = torch.zeros(9, 1), torch.from_numpy(scores)[:, None].float()
    calibrator = MondrianCalibrator().fit(zeros, zeros + 1, target, groups=["a"] * 9)
    assert calibrator.quantile(0.9, groups=["a"]).item() == 9.0


def test_every_group_is_a_calibrator_of_its_own() -> None:
    mean, std, target = _data(200, size=4)
    labels = _labels(200)
    calibrator = MondrianCalibrator().fit(mean, std, target, groups=labels)
    assert calibrator.group_counts == {a: labels.count(a) for a in sorted(set(labels))}
    for label in set(labels):
        of_group = torch.tensor([a == label for a in labels])
        alone = ConformalCalibrator().fit(mean[of_group], std[of_group], target[of_group])
        for level in (0.5, 0.8, 0.9):
            ours = calibrator.quantile(level, groups=[label])
            assert torch.equal(ours[0], alone.quantile(level))
            joint = calibrator.joint_quantile(level, groups=[label])
            assert torch.equal(joint[0], alone.joint_quantile(level))
    rows = ["0002", "0001", "0002"]
    box = calibrator.predict_joint(mean[:3], std[:3], 0.8, groups=rows)
    half = calibrator.joint_quantile(0.8, groups=rows)[:, None] * std[:3]
    assert torch.equal(box.upper, mean[:3] + half)


def _uneven() -> MondrianCalibrator:
    """Groups of 30, 4, 5, 3 and 1 samples with scores in the thousands, hundreds, tens, …"""
    sizes = {"a": 30, "b": 4, "c": 5, "d": 3, "e": 1}
    target = torch.cat([torch.arange(1.0, n + 1) + 100 * i for i, n in enumerate(sizes.values())])
    labels = [label for label, n in sizes.items() for _ in range(n)]
    zeros = torch.zeros(43, 1)
    return MondrianCalibrator().fit(zeros, zeros + 1, target[:, None], groups=labels)


def test_small_and_unseen_groups_share_one_quantile() -> None:
    calibrator = _uneven()
    # At 80% a group needs 4. b and c have their own quantiles (the 4th of 4, the 5th of 5); the
    # others share the category of the groups of at most 4: b, d and e. Rank ⌈9 · 0.8⌉ = 8 of 8.
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        quantiles = calibrator.quantile(0.8, groups=["a", "b", "c", "d", "e", "new", "d"])
        calibrator.joint_quantile(0.8, groups=["d", "new"])
    assert quantiles[:, 0].tolist() == [25.0, 104.0, 205.0, 401.0, 401.0, 401.0, 401.0]
    messages = [str(warning.message) for warning in caught]
    assert len(messages) == 3, "once per group"
    assert 'group "d" has 3 samples' in messages[0]
    assert "80% interval needs 4: it shares the quantile of all 3 groups" in messages[0]
    assert messages[0].endswith("groups of at most 4, 8 samples.")
    assert 'group "new" has 0 samples' in messages[2]


def test_a_shared_category_that_is_too_small_is_infinite() -> None:
    calibrator = _uneven()
    with pytest.warns(UserWarning, match=r"needs 19: .*4 groups of at most 19, 13 samples, which"):
        assert calibrator.quantile(0.95, groups=["e"]).item() == math.inf
    assert calibrator.quantile(0.95, groups=["a"]).item() == 30.0
    large = MondrianCalibrator().fit(*_data(99), groups=["a"] * 99)
    with pytest.warns(UserWarning, match=r"of all 0 groups of at most 9, 0 samples, which are too"):
        assert large.quantile(0.9, groups=["new"]).item() == math.inf


def test_groups_of_a_batch_of_any_shape() -> None:
    calibrator = _uneven()
    zeros = torch.zeros(2, 2, 1)
    intervals = calibrator.predict(zeros, zeros + 1, 0.8, groups=["a", "b", "c", "a"])
    assert intervals.upper[..., 0].tolist() == [[25.0, 104.0], [205.0, 25.0]]
    single = calibrator.predict(zeros[0, 0], zeros[0, 0] + 1, 0.8, groups=["c"])
    assert single.upper.tolist() == [205.0]
    none = calibrator.predict(zeros[:0, 0], zeros[:0, 0], 0.8, groups=[])
    assert none.upper.shape == (0, 1)


def test_groups_are_asked_for_and_counted() -> None:
    mean, std, target = _data(9)
    with pytest.raises(UncertaintyError, match=r"MondrianCalibrator needs groups=, .*got None"):
        MondrianCalibrator().fit(mean, std, target)
    with pytest.raises(UncertaintyError, match="got 'abcdefghi'"):
        MondrianCalibrator().fit(mean, std, target, groups="abcdefghi")
    with pytest.raises(UncertaintyError, match="8 groups for 9 rows"):
        MondrianCalibrator().fit(mean, std, target, groups=["a"] * 8)
    calibrator = MondrianCalibrator().fit(mean, std, target, groups=["a"] * 9)
    with pytest.raises(UncertaintyError, match="needs groups="):
        calibrator.predict(mean, std, 0.9)
    with pytest.raises(UncertaintyError, match="8 groups for 9 rows"):
        calibrator.predict(mean, std, 0.9, groups=["a"] * 8)


def test_odd_labels_survive_the_state() -> None:
    labels = ["", "a b\n", "Straße", "日本", '"']
    mean, std, target = _data(50)
    calibrator = MondrianCalibrator().fit(mean, std, target, groups=labels * 10)
    fresh = MondrianCalibrator()
    fresh.load_state_dict(calibrator.state_dict())
    assert fresh.group_counts == dict.fromkeys(sorted(labels), 10)
    with pytest.raises(UncertaintyError, match="zero character"):
        MondrianCalibrator().fit(mean, std, target, groups=["a\0b"] * 50)
