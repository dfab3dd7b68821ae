from __future__ import annotations

import math
import warnings
from fractions import Fraction
from typing import Literal

import pytest
import torch
from torch import Tensor

from uncal.errors import ConfigurationError
from uncal.uncertainty import ConformalCalibrator, HierarchicalCalibrator

Method = Literal["weighted", "subsampling"]
SIZES = {
    "even": [3] * 12,
    "uneven": [1, 7, 2, 2, 30, 5, 5, 11, 1, 3, 4, 13],
    "many": list(range(1, 61)),  # their least common multiple has 25 digits
}
LEVELS = [0.5, 0.8, 0.82, 0.9, Fraction(11, 13), Fraction(12, 13)]


def _groups(sizes: list[int]) -> list[str]:
    labels = [f"rig {k:02d}" for k, n in enumerate(sizes) for _ in range(n)]
    order = torch.randperm(len(labels), generator=torch.Generator().manual_seed(5))
    return [labels[i] for i in order]


def _fitted(
    sizes: list[int], method: Method = "weighted", repeats: int = 1, *, ties: bool = False
) -> tuple[HierarchicalCalibrator, Tensor, list[str]]:
    """A calibrator with the (m, 2) scores and labels that it was given."""
    groups = _groups(sizes)
    generator = torch.Generator().manual_seed(1)
    scores = torch.randn(len(groups), 2, generator=generator, dtype=torch.float64).abs()
    if ties:
        scores = (4 * scores).round()
    calibrator = HierarchicalCalibrator(method=method, repeats=repeats, seed=3)
    zeros = torch.zeros_like(scores)
    return calibrator.fit(zeros, zeros + 1, scores, groups=groups), scores, groups


def _weighted_p_value(score: float, scores: list[float], groups: list[str]) -> Fraction:
    """Weight of all scores at least as large: 1/(K+1) of each group's share, and the new one's."""
    labels = sorted(set(groups))
    total = Fraction(1)
    for label in labels:
        own = [s for s, g in zip(scores, groups, strict=True) if g == label]
        total += Fraction(sum(s >= score for s in own), len(own))
    return total / (len(labels) + 1)


def _average_p_value(score: float, draws: Tensor) -> Fraction:
    """Mean over the rows b of (1 + #{k: s_bk ≥ score})/(K+1), for (B, K) draws."""
    repeats, n_groups = draws.shape
    rows = [Fraction(1 + int((row >= score).sum()), n_groups + 1) for row in draws]
    return sum(rows, Fraction(0)) / repeats


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("ties", [False, True])
@pytest.mark.parametrize("sizes", ["even", "uneven"])
def test_weighted_is_all_scores_with_a_p_value_above_alpha(
    sizes: str, ties: bool, level: float | Fraction
) -> None:
    calibrator, scores, groups = _fitted(SIZES[sizes], ties=ties)
    alpha = 1 - Fraction(str(level))
    quantiles = calibrator.quantile(level).tolist()
    columns = [*scores.T.tolist(), scores.amax(1).tolist()]
    for quantile, column in zip(
        [*quantiles, calibrator.joint_quantile(level).item()], columns, strict=True
    ):
        accepted = [s for s in column if _weighted_p_value(s, column, groups) > alpha]
        assert quantile == max(accepted)
        assert _weighted_p_value(quantile + 1e-9, column, groups) <= alpha


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("repeats", [1, 2, 9])
def test_subsampling_is_all_scores_with_a_p_value_above_alpha(
    repeats: int, level: float | Fraction
) -> None:
    calibrator, scores, groups = _fitted(SIZES["many"][:30], "subsampling", repeats)
    alpha = 1 - Fraction(str(level))
    factor = 1 if repeats == 1 else 2
    index = {label: k for k, label in enumerate(sorted(set(groups)))}
    rows = calibrator._draws(torch.tensor([index[label] for label in groups]))
    # B draws of one group after the other.
    owners = [groups[i] for i in rows.tolist()]
    assert owners == [label for label in sorted(set(groups)) for _ in range(repeats)]
    drawn = scores[rows].reshape(len(index), repeats, 2)
    tables = [drawn[..., 0].T, drawn[..., 1].T, drawn.amax(2).T]
    quantiles = [*calibrator.quantile(level).tolist(), calibrator.joint_quantile(level).item()]
    for quantile, table in zip(quantiles, tables, strict=True):
        accepted = [
            s for s in table.ravel().tolist() if factor * _average_p_value(s, table) > alpha
        ]
        assert quantile == max(accepted)
        assert factor * _average_p_value(quantile + 1e-9, table) <= alpha


@pytest.mark.parametrize("level", LEVELS)
def test_one_frame_per_group_is_split_conformal(level: float | Fraction) -> None:
    groups = [f"{k}" for k in range(40)]
    scores = torch.rand(40, 3, generator=torch.Generator().manual_seed(0))
    zeros = torch.zeros_like(scores)
    plain = ConformalCalibrator().fit(zeros, zeros + 1, scores)
    for method in ("weighted", "subsampling"):
        calibrator = HierarchicalCalibrator(method=method)
        calibrator.fit(zeros, zeros + 1, scores, groups=groups)
        assert torch.equal(calibrator.quantile(level), plain.quantile(level))
        assert torch.equal(calibrator.joint_quantile(level), plain.joint_quantile(level))


def test_many_uneven_groups_need_integers_beyond_64_bits() -> None:
    sizes = SIZES["many"]
    assert math.lcm(*sizes) > 2**63
    calibrator, scores, groups = _fitted(sizes)
    column = scores[:, 0].tolist()
    alpha = Fraction(1, 10)
    quantile = calibrator.quantile(0.9)[0].item()
    assert _weighted_p_value(quantile, column, groups) > alpha
    assert _weighted_p_value(quantile + 1e-9, column, groups) <= alpha


def test_weighted_by_hand() -> None:
    # Groups (1, 2), (3), (4), (5): weights 1/2, 1/2, 1, 1, 1. 5 · 0.2 = 1 is reached at the score
    # 2, 5 · 0.6 = 3 at 4, and 5 · 0.7 = 3.5 at 5.
    target = torch.tensor([[1.0], [3.0], [5.0], [2.0], [4.0]])
    groups = ["a", "b", "d", "a", "c"]
    zeros = torch.zeros(5, 1)
    calibrator = HierarchicalCalibrator().fit(zeros, zeros + 1, target, groups=groups)
    assert [calibrator.quantile(level).item() for level in (0.2, 0.6, 0.7)] == [2.0, 4.0, 5.0]
    assert calibrator.group_counts == {"a": 2, "b": 1, "c": 1, "d": 1}
    assert calibrator.quantile(0.6, groups=["never seen"]).shape == (1,)


@pytest.mark.parametrize(
    ("method", "repeats", "needed"),
    [("weighted", 1, 19), ("subsampling", 1, 19), ("subsampling", 5, 39)],
)
def test_too_few_groups_give_infinity_and_one_warning(
    method: Method, repeats: int, needed: int
) -> None:
    calibrator, _, _ = _fitted(SIZES["even"], method, repeats)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert calibrator.quantile(0.95).tolist() == [math.inf] * 2
        assert calibrator.joint_quantile(0.95).item() == math.inf
    (message,) = (str(warning.message) for warning in caught)
    assert message.startswith("12 groups in the uncertainty calibration set are too few for a 95%")
    assert f"it needs {needed}, {needed - 12} more" in message
    enough, _, _ = _fitted([2] * needed, method, repeats)
    assert enough.quantile(0.95).isfinite().all()
    one_less, _, _ = _fitted([2] * (needed - 1), method, repeats)
    with pytest.warns(UserWarning, match="1 more"):
        one_less.quantile(0.95)


def test_the_seed_decides_the_draws_and_the_order_of_groups_does_not() -> None:
    first, scores, groups = _fitted(SIZES["uneven"], "subsampling", 3)
    again, _, _ = _fitted(SIZES["uneven"], "subsampling", 3)
    assert torch.equal(first.scores, again.scores)
    other = HierarchicalCalibrator(method="subsampling", repeats=3, seed=4)
    other.fit(0 * scores, 0 * scores + 1, scores, groups=groups)
    assert not torch.equal(first.scores, other.scores)
    assert first.scores.shape == (36, 2)
    assert int(first.count) == sum(SIZES["uneven"])


def test_a_loaded_state_brings_its_method() -> None:
    saved, _, _ = _fitted(SIZES["uneven"], "subsampling", 9)
    fresh = HierarchicalCalibrator()
    fresh.load_state_dict(saved.state_dict())
    assert int(fresh.repeats) == 9
    assert torch.equal(fresh.quantile(0.8), saved.quantile(0.8))
    weighted, _, _ = _fitted(SIZES["uneven"])
    fresh.load_state_dict(weighted.state_dict())
    assert torch.equal(fresh.quantile(0.8), weighted.quantile(0.8))


def test_settings_out_of_range() -> None:
    with pytest.raises(ConfigurationError, match='"pooling"; choose "weighted" or "subsampling"'):
        HierarchicalCalibrator(method="pooling")  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="repeats = 0"):
        HierarchicalCalibrator(method="subsampling", repeats=0)
