from __future__ import annotations

import math
import warnings
from fractions import Fraction

import pytest
import torch

from uncal.uncertainty import conformal_quantile, conformal_rank, miscoverage, samples_needed


@pytest.mark.parametrize(
    ("m", "alpha", "rank"),
    [
        (100, 0.1, 91),
        (149, 0.18, 123),  # floating point: 124
        (9, 0.1, 9),
        (8, 0.1, 9),
        (99, 0.01, 99),
        (98, 0.01, 99),
        (1, 0.5, 1),
        (999, 0.05, 950),
    ],
)
def test_rank_by_hand(m: int, alpha: float, rank: int) -> None:
    assert conformal_rank(m, alpha) == rank


def test_rank_against_integer_arithmetic() -> None:
    # With alpha = a/100, k = ceil((m+1)(100-a)/100) needs no fraction at all.
    wrong_in_floating_point = 0
    for a in range(1, 100):
        for m in range(20, 400, 7):
            exact = -(-(m + 1) * (100 - a) // 100)
            assert conformal_rank(m, a / 100) == exact
            wrong_in_floating_point += math.ceil((m + 1) * (1 - a / 100)) != exact
    assert wrong_in_floating_point > 0, "the grid should contain the cases that floats get wrong"


def test_rank_of_a_level() -> None:
    # 1 - 0.9 is 0.09999999999999998 in floating point, and one rank too many at m = 99.
    assert conformal_rank(99, miscoverage(0.9)) == 90
    assert miscoverage(0.99) == Fraction(1, 100)


@pytest.mark.parametrize("alpha", [0.0, 1.0, -0.1, 1.5, math.nan, math.inf])
def test_rank_refuses_alpha(alpha: float) -> None:
    with pytest.raises(ValueError, match=r"outside \(0, 1\)"):
        conformal_rank(10, alpha)


def test_rank_refuses_no_samples() -> None:
    with pytest.raises(ValueError, match="m = 0"):
        conformal_rank(0, 0.1)


@pytest.mark.parametrize("alpha", [0.01, 0.05, 0.1, 0.18, 0.3, 0.5])
def test_samples_needed_is_the_smallest_finite_m(alpha: float) -> None:
    m = samples_needed(alpha)
    assert conformal_rank(m, alpha) <= m
    assert m == 1 or conformal_rank(m - 1, alpha) > m - 1


def test_quantile_is_the_91st_of_100() -> None:
    scores = torch.arange(1.0, 101.0)[torch.randperm(100)]
    assert conformal_quantile(scores, 0.1).item() == 91.0
    assert conformal_quantile(torch.arange(1, 101), 0.1).item() == 91.0


def test_quantile_per_column() -> None:
    scores = torch.stack([torch.arange(1.0, 101.0), -torch.arange(1.0, 101.0)], dim=1)
    assert conformal_quantile(scores, 0.1).tolist() == [91.0, -10.0]
    assert conformal_quantile(scores.reshape(100, 2, 1), 0.1).shape == (2, 1)


def test_quantile_too_few_samples_warns_once() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        quantile = conformal_quantile(torch.rand(40, 6), 0.01)
    assert torch.isposinf(quantile).all()
    assert quantile.shape == (6,)
    (warning,) = caught
    message = str(warning.message)
    assert "40 samples" in message
    assert "99% interval" in message
    assert "needs 99, 59 more" in message


def test_quantile_keeps_infinite_scores() -> None:
    scores = torch.tensor([1.0, torch.inf, 2.0])
    assert conformal_quantile(scores, 0.5).item() == 2.0
    assert conformal_quantile(scores, 0.25).item() == torch.inf


def test_quantile_refuses_nan() -> None:
    with pytest.raises(ValueError, match="1 of 3 scores are NaN"):
        conformal_quantile(torch.tensor([1.0, torch.nan, 2.0]), 0.5)


@pytest.mark.parametrize("scores", [torch.empty(0), torch.empty(0, 6), torch.tensor(1.0)])
def test_quantile_refuses_no_samples(scores: torch.Tensor) -> None:
    with pytest.raises(ValueError, match="at least one sample"):
        conformal_quantile(scores, 0.5)
