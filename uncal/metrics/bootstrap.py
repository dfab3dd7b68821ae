"""Percentile bootstrap of a ratio of means, over groups of dependent samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

RESAMPLES, CONFIDENCE = 2000, 0.95
"""Of the bootstrap, and of its interval."""


def bootstrap_ratio(
    above: NDArray[np.float64],
    below: NDArray[np.float64],
    groups: Sequence[str],
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Percentile interval of mean(above) / mean(below), from whole groups drawn with replacement.

    Args:
        above: (n, D).
        below: (n, D).
        groups: n labels.
        resamples: how many times as many groups as there are are drawn.
        seed: of the draws.

    Returns:
        Lower and upper end, each (D,), at :data:`CONFIDENCE`.

    >>> low, high = bootstrap_ratio(np.array([[1.0], [3.0]]), np.ones((2, 1)), ["a", "b"])
    >>> low.item(), high.item()
    (1.0, 3.0)
    """
    names, index = np.unique(np.asarray(groups), return_inverse=True)
    n, width = len(names), above.shape[1]
    sums = np.zeros((n, 2 * width))
    np.add.at(sums, index, np.concatenate([above, below], 1))
    random = np.random.default_rng(seed)
    at_once = max(1, 2**20 // n)  # a few megabytes, however many groups there are
    parts = []
    for start in range(0, resamples, at_once):
        rows = min(at_once, resamples - start)
        drawn = random.integers(0, n, (rows, n)) + n * np.arange(rows)[:, None]
        times = np.bincount(drawn.ravel(), minlength=rows * n).reshape(rows, n)
        totals = times.astype(np.float64) @ sums
        parts.append(ratio(totals[:, :width], totals[:, width:]))
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(np.concatenate(parts), [tail, 1 - tail], axis=0)
    return low, high


def ratio(above: NDArray[np.float64], below: NDArray[np.float64]) -> NDArray[np.float64]:
    """NaN over 0: a DoF that was never decalibrated."""
    return above / np.where(below > 0, below, np.nan)
