"""Scans compared with other images of the drive, however short a stretch of it is."""

from __future__ import annotations

import numpy as np
import pytest

from uncal.checking.clocks import LONGEST_LAG, _gain


@pytest.mark.parametrize("n", [1, 2, 3, 10])
def test_a_stretch_shorter_than_the_lag_says_nothing(n: int) -> None:
    table = np.arange(n * n, dtype=float).reshape(n, n)
    for lag in sorted(set(range(-LONGEST_LAG, LONGEST_LAG + 1)) - {0}):
        expected = [table[i, i + lag] - table[i, i] for i in range(n) if 0 <= i + lag < n]
        assert _gain(table, lag).tolist() == expected
