"""Coverage over resplits of awkward data, against the bounds and against the exact law.

Each resplit is one output of a calibrator: a column of the (samples, resplits) tensors. All of
them permute one fixed pool of m + n samples. Whatever the pool, without ties every split of its
ranks is equally likely, so that the covered counts are independent draws of the exact law.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import stats  # type: ignore[import-untyped]
from torch import Tensor

from uncal.metrics.functional import covered
from uncal.uncertainty import ConformalCalibrator, conformal_rank, coverage_law, miscoverage

RESPLITS = 1000
SIGNIFICANCE = 1e-3
"""Chance of a false alarm per check, had the seed not been fixed."""

CASES = [(100, 500, 0.9, 0), (149, 2000, 0.82, 1), (80, 300, 0.95, 2), (120, 300, 0.99, 3)]
"""m, n, level, seed."""


def _resplits(m: int, n: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """(m + n, RESPLITS) mean, σ̂ and target: Student-t errors with 2 degrees of freedom, true
    scales over two orders of magnitude, of which σ̂ knows only part.
    """
    generator = torch.Generator().manual_seed(seed)
    rng = np.random.default_rng(seed)
    size = m + n
    scale = torch.randn(size, generator=generator, dtype=torch.float64).exp()
    error = scale * torch.from_numpy(rng.standard_t(2, size))
    std = scale * (0.7 * torch.randn(size, generator=generator, dtype=torch.float64)).exp()
    mean = torch.randn(size, generator=generator, dtype=torch.float64)
    order = torch.rand(size, RESPLITS, generator=generator).argsort(dim=0)
    return mean[order], std[order], (mean + error)[order]


def _counts(m: int, n: int, level: float, seed: int) -> NDArray[np.int64]:
    """(RESPLITS,) how many of n test samples the intervals of m others cover."""
    mean, std, target = _resplits(m, n, seed)
    calibrator = ConformalCalibrator().fit(mean[:m], std[:m], target[:m])
    intervals = calibrator.predict(mean[m:], std[m:], level)
    counts: NDArray[np.int64] = covered(intervals.lower, intervals.upper, target[m:]).sum(0).numpy()
    return counts


def _counts_with_rank_off_by(
    shift: int, m: int, n: int, level: float, seed: int
) -> NDArray[np.int64]:
    """The same with the wrong order statistic, on purpose."""
    mean, std, target = _resplits(m, n, seed)
    scores = (target - mean).abs() / std
    rank = conformal_rank(m, miscoverage(level)) + shift
    quantile = scores[:m].sort(dim=0).values[rank - 1]
    counts: NDArray[np.int64] = (scores[m:] <= quantile).sum(0).numpy()
    return counts


def _mean_is_within_bounds(counts: NDArray[np.int64], m: int, n: int, level: float) -> bool:
    """Mean coverage in [1-α, 1-α+1/(m+1)] up to Monte Carlo error at ``SIGNIFICANCE``."""
    alpha = float(miscoverage(level))
    error = coverage_law(n, m, alpha).std() / n / RESPLITS**0.5
    slack = stats.norm.isf(SIGNIFICANCE / 2) * error
    return bool(1 - alpha - slack <= counts.mean() / n <= 1 - alpha + 1 / (m + 1) + slack)


def _p_value_of_the_law(counts: NDArray[np.int64], m: int, n: int, level: float) -> float:
    """Chi-square test of the counts against the Beta-Binomial law in about 10 equal bins."""
    law = coverage_law(n, m, miscoverage(level))
    edges = np.unique(law.ppf(np.linspace(0.1, 0.9, 9)))
    expected = np.diff(np.concatenate([[0.0], law.cdf(edges), [1.0]]))
    observed = np.bincount(np.searchsorted(edges, counts), minlength=len(expected))
    used = expected > 1e-12  # the last bin is empty where the law puts its mass on n
    return float(stats.chisquare(observed[used], RESPLITS * expected[used]).pvalue)


@pytest.mark.parametrize(("m", "n", "level", "seed"), CASES)
def test_mean_coverage_is_within_its_bounds(m: int, n: int, level: float, seed: int) -> None:
    assert _mean_is_within_bounds(_counts(m, n, level, seed), m, n, level)


@pytest.mark.parametrize(("m", "n", "level", "seed"), CASES)
def test_counts_follow_the_exact_law(m: int, n: int, level: float, seed: int) -> None:
    assert _p_value_of_the_law(_counts(m, n, level, seed), m, n, level) > SIGNIFICANCE


@pytest.mark.parametrize(("m", "n", "level", "seed"), CASES)
def test_the_checks_notice_a_rank_too_low(m: int, n: int, level: float, seed: int) -> None:
    counts = _counts_with_rank_off_by(-1, m, n, level, seed)
    assert not _mean_is_within_bounds(counts, m, n, level)
    assert _p_value_of_the_law(counts, m, n, level) < SIGNIFICANCE


@pytest.mark.parametrize(("m", "n", "level", "seed"), CASES[:3])  # the last one's k + 1 is m + 1
def test_the_law_notices_a_rank_too_high(m: int, n: int, level: float, seed: int) -> None:
    counts = _counts_with_rank_off_by(+1, m, n, level, seed)
    assert _p_value_of_the_law(counts, m, n, level) < SIGNIFICANCE


def test_the_right_rank_passes_the_same_way() -> None:
    m, n, level, seed = CASES[0]
    counts = _counts_with_rank_off_by(0, m, n, level, seed)
    np.testing.assert_array_equal(counts, _counts(m, n, level, seed))
