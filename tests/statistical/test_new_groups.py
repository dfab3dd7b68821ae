"""A frame of a group that the fit has not seen: what pooling all frames promises, and what holds.

Errors are a bias of the group plus heavy-tailed noise: frames of a group are alike. Each trial is
one output of a calibrator, a column: K groups of n frames and one frame of a new group, all drawn
afresh, so that trials are independent.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import torch
from scipy import stats  # type: ignore[import-untyped]
from torch import Tensor

from uncal.metrics.functional import covered
from uncal.uncertainty import (
    ConformalCalibrator,
    HierarchicalCalibrator,
    IntervalCalibrator,
    conformal_rank,
    miscoverage,
)

TRIALS = 4000
SIGNIFICANCE = 1e-3
"""Chance of a false alarm per check, had the seed not been fixed."""

K, LEVEL = 11, 0.8


@cache
def _errors(n_groups: int) -> Tensor:
    """(K + 1, up to 16 frames, TRIALS) errors; the last group is the new one."""
    rng = np.random.default_rng(n_groups)
    bias = rng.standard_normal((n_groups + 1, 1, TRIALS))
    return torch.from_numpy(bias + 0.1 * rng.standard_t(3, (n_groups + 1, 16, TRIALS)))


def _covered(calibrator: IntervalCalibrator, n_groups: int, level: float) -> int:
    """Trials whose interval holds the new group's first frame; groups have 4, 8 or 16 frames."""
    errors = _errors(n_groups)
    sizes = [(4, 8, 16)[k % 3] for k in range(n_groups)]
    target = torch.cat([errors[k, :size] for k, size in enumerate(sizes)])
    labels = [str(k) for k, size in enumerate(sizes) for _ in range(size)]
    zeros = torch.zeros_like(target)
    calibrator.fit(zeros, zeros + 1, target, groups=labels)
    intervals = calibrator.predict(zeros[:1], zeros[:1] + 1, level)
    return int(covered(intervals.lower, intervals.upper, errors[n_groups, :1]).sum())


def _p_value_of_too_few(count: int, level: float) -> float:
    return float(stats.binomtest(count, TRIALS, level, alternative="less").pvalue)


def test_pooled_frames_cover_a_new_group_too_rarely() -> None:
    assert _p_value_of_too_few(_covered(ConformalCalibrator(), K, LEVEL), LEVEL) < SIGNIFICANCE


def test_pooled_frames_do_cover_where_groups_do_not_matter() -> None:
    rng = np.random.default_rng(0)
    target = torch.from_numpy(rng.standard_t(3, (K * 9 + 1, TRIALS)))
    zeros = torch.zeros_like(target)
    calibrator = ConformalCalibrator().fit(zeros[1:], zeros[1:] + 1, target[1:])
    intervals = calibrator.predict(zeros[:1], zeros[:1] + 1, LEVEL)
    count = int(covered(intervals.lower, intervals.upper, target[:1]).sum())
    assert _p_value_of_too_few(count, LEVEL) > SIGNIFICANCE


@pytest.mark.parametrize(
    "calibrator",
    [
        HierarchicalCalibrator(),
        HierarchicalCalibrator(method="subsampling"),
        HierarchicalCalibrator(method="subsampling", repeats=20),
    ],
    ids=["weighted", "single subsampling", "repeated subsampling"],
)
def test_hierarchical_intervals_cover_a_new_group(calibrator: HierarchicalCalibrator) -> None:
    count = _covered(calibrator, K, LEVEL)
    assert _p_value_of_too_few(count, LEVEL) > SIGNIFICANCE
    assert count < TRIALS, "not by being infinite"


@pytest.mark.parametrize(("n_groups", "level"), [(9, 0.8), (11, 0.8), (11, 0.7), (19, 0.9)])
def test_single_subsampling_follows_the_exact_law(n_groups: int, level: float) -> None:
    count = _covered(HierarchicalCalibrator(method="subsampling"), n_groups, level)
    rank = conformal_rank(n_groups, miscoverage(level))
    exact = rank / (n_groups + 1)
    assert stats.binomtest(count, TRIALS, exact).pvalue > SIGNIFICANCE
    for wrong in (rank - 1, rank + 1):
        p_value = stats.binomtest(count, TRIALS, wrong / (n_groups + 1)).pvalue
        assert p_value < SIGNIFICANCE, "the test would notice a rank off by one"
