"""Coverage over resplits of awkward data, against the bounds and against the exact law.

Per output and per group each resplit is one output of a calibrator: a column of the (samples,
resplits) tensors. A joint box takes a calibrator per resplit. All resplits permute one fixed pool
of m + n samples. Whatever the pool, without ties every split of its ranks is equally likely, so
that the covered counts are independent draws of the exact law.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import stats  # type: ignore[import-untyped]
from torch import Tensor

from uncal.metrics.functional import covered
from uncal.uncertainty import (
    ConformalCalibrator,
    MondrianCalibrator,
    conformal_rank,
    coverage_law,
    miscoverage,
)

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


JOINT_CASES = [(100, 300, 0.9, 4), (60, 200, 0.8, 5)]
"""m, n, level, seed of six correlated outputs."""


@cache
def _joint_pool(size: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """(size, 6) mean, σ̂ and target: Student-t errors whose outputs share a factor and a scale."""
    rng = np.random.default_rng(seed)
    scale = np.exp(rng.standard_normal((size, 1)) + 0.5 * rng.standard_normal((size, 6)))
    noise = rng.standard_t(2, (size, 6)) + 2 * rng.standard_t(2, (size, 1))
    std = scale * np.exp(0.5 * rng.standard_normal((size, 6)))
    mean = rng.standard_normal((size, 6))
    return torch.from_numpy(mean), torch.from_numpy(std), torch.from_numpy(mean + scale * noise)


@cache
def _joint_resplits(
    m: int, n: int, level: float, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], float]:
    """(RESPLITS,) samples whose six outputs are all covered: by the box of the largest score, by
    that with a rank too low, by Bonferroni's; and the mean of log(Bonferroni's width / width).
    """
    mean, std, target = _joint_pool(m + n, seed)
    scores = ((target - mean).abs() / std).amax(1)
    rank = conformal_rank(m, miscoverage(level))
    generator = torch.Generator().manual_seed(seed)
    counts, log_ratio = np.zeros((3, RESPLITS), dtype=np.int64), 0.0
    for split in range(RESPLITS):
        order = torch.randperm(m + n, generator=generator)
        fitted, new = order[:m], order[m:]
        calibrator = ConformalCalibrator().fit(mean[fitted], std[fitted], target[fitted])
        box = calibrator.predict_joint(mean[new], std[new], level)
        wider = calibrator.predict_joint(mean[new], std[new], level, method="bonferroni")
        too_low = scores[fitted].sort().values[rank - 2]
        counts[0, split] = covered(box.lower, box.upper, target[new]).all(1).sum()
        counts[1, split] = (scores[new] <= too_low).sum()
        counts[2, split] = covered(wider.lower, wider.upper, target[new]).all(1).sum()
        ratio = (wider.upper - wider.lower) / (box.upper - box.lower)
        log_ratio += float(ratio.log().mean()) / RESPLITS
    return counts[0], counts[1], counts[2], log_ratio


@pytest.mark.slow
@pytest.mark.parametrize(("m", "n", "level", "seed"), JOINT_CASES)
def test_joint_boxes_follow_the_exact_law(m: int, n: int, level: float, seed: int) -> None:
    counts, too_low, _, _ = _joint_resplits(m, n, level, seed)
    assert _mean_is_within_bounds(counts, m, n, level)
    assert _p_value_of_the_law(counts, m, n, level) > SIGNIFICANCE
    assert not _mean_is_within_bounds(too_low, m, n, level)
    assert _p_value_of_the_law(too_low, m, n, level) < SIGNIFICANCE


@pytest.mark.slow
def test_bonferroni_holds_too_and_is_wider() -> None:
    m, n, level, seed = JOINT_CASES[0]
    _, _, counts, log_ratio = _joint_resplits(m, n, level, seed)
    error = counts.std() / n / RESPLITS**0.5
    assert counts.mean() / n >= level - stats.norm.isf(SIGNIFICANCE) * error
    assert log_ratio > 0.05, "at least 5% wider, in the geometric mean over outputs and frames"


def test_six_intervals_together_cover_less_than_each() -> None:
    m, n, level, seed = 500, 2000, 0.9, 6
    mean, std, target = _joint_pool(m + n, seed)
    calibrator = ConformalCalibrator().fit(mean[:m], std[:m], target[:m])
    single = calibrator.predict(mean[m:], std[m:], level)
    inside = covered(single.lower, single.upper, target[m:])
    lowest = coverage_law(n, m, miscoverage(level)).ppf(SIGNIFICANCE)
    assert (inside.sum(0).numpy() >= lowest).all()
    assert int(inside.all(1).sum()) < lowest


GROUPS = {"easy": (150, 250), "hard": (60, 200), "wild": (35, 200)}
"""m_g, n_g: samples in the uncertainty calibration set and in the test set."""


@cache
def _group_counts(level: float) -> tuple[dict[str, NDArray[np.int64]], dict[str, float]]:
    """(RESPLITS,) covered samples per group by the group's quantiles, and the pooled coverage.

    Each group is resplit on its own: the groups differ, their frames are exchangeable.
    """
    parts = {g: (_resplits(*sizes, seed=7 + i)) for i, (g, sizes) in enumerate(GROUPS.items())}
    factor = {"easy": 0.1, "hard": 1.0, "wild": 10.0}
    fitted, new = [], []
    for label, (mean, std, target) in parts.items():
        m = GROUPS[label][0]
        target = mean + factor[label] * (target - mean)
        fitted.append((mean[:m], std[:m], target[:m]))
        new.append((mean[m:], std[m:], target[m:]))
    fit_mean, fit_std, fit_target = (torch.cat(t) for t in zip(*fitted, strict=True))
    labels = [label for label, (m, _) in GROUPS.items() for _ in range(m)]
    own = MondrianCalibrator().fit(fit_mean, fit_std, fit_target, groups=labels)
    pooled = ConformalCalibrator().fit(fit_mean, fit_std, fit_target)
    counts, pooled_coverage = {}, {}
    for (label, (_, n)), (mean, std, target) in zip(GROUPS.items(), new, strict=True):
        box = own.predict(mean, std, level, groups=[label] * n)
        counts[label] = covered(box.lower, box.upper, target).sum(0).numpy()
        box = pooled.predict(mean, std, level)
        pooled_coverage[label] = float(covered(box.lower, box.upper, target).double().mean())
    return counts, pooled_coverage


@pytest.mark.parametrize("level", [0.9, 0.82])
@pytest.mark.parametrize("label", list(GROUPS))
def test_every_group_follows_the_law_of_its_own_size(label: str, level: float) -> None:
    m, n = GROUPS[label]
    counts = _group_counts(level)[0][label]
    assert _mean_is_within_bounds(counts, m, n, level)
    assert _p_value_of_the_law(counts, m, n, level) > SIGNIFICANCE


@pytest.mark.parametrize("label", list(GROUPS))
def test_the_checks_notice_a_rank_too_low_in_a_group(label: str) -> None:
    m, n = GROUPS[label]
    counts = _counts_with_rank_off_by(-1, m, n, 0.9, seed=7 + list(GROUPS).index(label))
    assert not _mean_is_within_bounds(counts, m, n, 0.9)
    assert _p_value_of_the_law(counts, m, n, 0.9) < SIGNIFICANCE


def test_the_law_of_another_size_does_not_fit() -> None:
    counts = _group_counts(0.9)[0]["wild"]
    assert _p_value_of_the_law(counts, sum(m for m, _ in GROUPS.values()), 200, 0.9) < SIGNIFICANCE


def test_the_pooled_quantile_fails_the_groups() -> None:
    pooled = _group_counts(0.9)[1]
    assert pooled["easy"] > 0.95
    assert pooled["wild"] < 0.75
