"""Groups too small for their own quantile: the shared category covers, all frames pooled do not.

One large easy group and eight small hard ones; labels are drawn at random, so that the frames of a
trial are exchangeable. One new frame per trial.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch
from scipy import stats  # type: ignore[import-untyped]

from uncal.uncertainty import ConformalCalibrator, MondrianCalibrator

TRIALS = 3000
SIGNIFICANCE = 1e-3
LEVEL = 0.8
M = 60


def _trials() -> tuple[int, int, int]:
    """Of the trials whose new frame is of a small group: how many, covered by ours, by all frames
    pooled.
    """
    rng = np.random.default_rng(0)
    shares = [0.68] + [0.04] * 8
    n_small = ours = pooled_hits = 0
    for _ in range(TRIALS):
        group = rng.choice(9, size=M + 1, p=shares)
        if (group[:M] == group[M]).sum() >= 4:
            continue  # has a quantile of its own at this level
        score = np.abs(rng.standard_t(3, M + 1)) * np.where(group == 0, 1.0, 5.0)
        target = torch.from_numpy(score)[:, None]
        zeros, labels = torch.zeros_like(target), [str(g) for g in group]
        calibrator = MondrianCalibrator()
        calibrator.fit(zeros[:M], zeros[:M] + 1, target[:M], groups=labels[:M])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            quantile = calibrator.quantile(LEVEL, groups=labels[M:])
        pooled = ConformalCalibrator().fit(zeros[:M], zeros[:M] + 1, target[:M]).quantile(LEVEL)
        n_small += 1
        ours += int(score[M] <= quantile.item())
        pooled_hits += int(score[M] <= pooled.item())
    return n_small, ours, pooled_hits


@pytest.mark.slow
def test_small_groups_share_a_quantile_that_covers() -> None:
    n_small, ours, pooled = _trials()
    assert n_small > 500
    assert stats.binomtest(ours, n_small, LEVEL, alternative="less").pvalue > SIGNIFICANCE
    assert ours / n_small < LEVEL + 0.15, "not by being infinite"
    assert stats.binomtest(pooled, n_small, LEVEL, alternative="less").pvalue < SIGNIFICANCE
