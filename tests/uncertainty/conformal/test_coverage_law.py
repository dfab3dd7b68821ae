from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from uncal.uncertainty import coverage_band, coverage_law


def test_against_enumeration_of_all_splits() -> None:
    # Which n of the m + n ranks are test samples is uniform; covered are those below the k-th
    # smallest of the others.
    m, n, rank = 4, 3, 4  # k = ceil(5 · 0.75)
    counts = np.zeros(n + 1)
    for test in itertools.combinations(range(m + n), n):
        scores = sorted(set(range(m + n)) - set(test))
        counts[sum(rank_of < scores[rank - 1] for rank_of in test)] += 1
    law = coverage_law(n, m, alpha=0.25)
    np.testing.assert_allclose(law.pmf(np.arange(n + 1)), counts / math.comb(m + n, n))


def test_mean_is_k_over_m_plus_one() -> None:
    assert coverage_law(200, 149, 0.18).mean() / 200 == pytest.approx(123 / 150)


def test_infinite_interval_covers_all() -> None:
    law = coverage_law(10, 40, 0.01)
    assert float(law.pmf(10)) == 1.0
    assert coverage_band(10, 40, 0.01) == (1.0, 1.0)


@pytest.mark.parametrize(
    ("n", "m", "alpha"), [(200, 300, 0.1), (57, 149, 0.18), (1000, 1000, 0.01)]
)
def test_band_is_equal_tailed_and_tight(n: int, m: int, alpha: float) -> None:
    low, high = coverage_band(n, m, alpha, confidence=0.99)
    law, first, last = coverage_law(n, m, alpha), round(low * n), round(high * n)
    assert float(law.cdf(first - 1)) <= 0.005 < float(law.cdf(first))
    assert 1 - float(law.cdf(last)) <= 0.005
    assert 1 - float(law.cdf(last - 1)) > 0.005


def test_band_of_the_usual_textbook_case() -> None:
    # m = n = 1000, 90%: one split's 99.8% range is .855-.938.
    assert coverage_band(1000, 1000, 0.1, confidence=0.998) == (0.855, 0.938)


def test_arguments() -> None:
    with pytest.raises(ValueError, match="n = 0"):
        coverage_law(0, 10, 0.1)
    with pytest.raises(ValueError, match="m = 0"):
        coverage_law(10, 0, 0.1)
    with pytest.raises(ValueError, match="confidence = 1"):
        coverage_band(10, 10, 0.1, confidence=1.0)
