"""How many test samples a split conformal interval covers: the Beta-Binomial law of the count."""

from __future__ import annotations

from fractions import Fraction

from scipy import stats  # type: ignore[import-untyped]

from uncal.uncertainty.conformal.quantile import conformal_rank


def coverage_law(n: int, m: int, alpha: float | Fraction) -> stats.distributions.rv_frozen:
    """Law of the number of covered samples among n test samples: Beta-Binomial(n, k, m+1-k).

    k = ⌈(m+1)(1-α)⌉. Exact for one output, and for a joint box as a whole, when the m + n samples
    are exchangeable and their scores have no ties, whatever their distribution; ties can only raise
    the coverage. Within a group that has its own quantile it holds with that group's m and n. With
    k > m the interval is infinite and all n are covered.

    Args:
        n: test samples.
        m: samples in the uncertainty calibration set.
        alpha: miscoverage level α in (0, 1).

    Raises:
        ValueError: n or m below 1, or α outside (0, 1).

    >>> float(coverage_law(n=1000, m=999, alpha=0.1).mean())
    900.0
    """
    if n < 1:
        raise ValueError(f"n = {n} test samples; the covered count needs at least one.")
    rank = conformal_rank(m, alpha)
    return stats.binom(n, 1.0) if rank > m else stats.betabinom(n, rank, m + 1 - rank)


def coverage_band(
    n: int, m: int, alpha: float | Fraction, confidence: float = 0.999
) -> tuple[float, float]:
    """Equal-tailed band of the coverage that one test set shows with the given probability.

    Each tail beyond the band has at most probability (1 - confidence)/2.

    Args:
        n: test samples.
        m: samples in the uncertainty calibration set.
        alpha: miscoverage level α in (0, 1).
        confidence: probability of the band, in (0, 1).

    Returns:
        Lowest and highest covered fraction inside the band, both included.

    Raises:
        ValueError: n or m below 1, or α or confidence outside (0, 1).

    >>> coverage_band(n=1000, m=1000, alpha=0.1, confidence=0.998)
    (0.855, 0.938)
    """
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence} is outside (0, 1); give for instance 0.999.")
    law = coverage_law(n, m, alpha)
    tail = (1 - confidence) / 2
    return float(law.ppf(tail)) / n, float(law.isf(tail)) / n
