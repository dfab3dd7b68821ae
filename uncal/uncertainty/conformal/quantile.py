"""The conformal quantile by exact ranks (eq. 4), and the coverage that follows from them."""

from __future__ import annotations

import math
import warnings
from fractions import Fraction

import torch
from scipy import stats  # type: ignore[import-untyped]
from torch import Tensor


def miscoverage(level: float | Fraction) -> Fraction:
    """α = 1 - level, exactly: in floating point 1 - 0.9 is less than 0.1 and costs a rank.

    Args:
        level: coverage level 1-α in (0, 1); a float counts as the decimal number it prints as.

    Raises:
        ValueError: a level outside (0, 1).

    >>> miscoverage(0.9)
    Fraction(1, 10)
    """
    return 1 - _exact(level, "level", "0.9 for 90% intervals")


def conformal_rank(m: int, alpha: float | Fraction) -> int:
    """Rank k = ⌈(m+1)(1-α)⌉ in rational arithmetic (eq. 4); k > m means an infinite interval.

    A float α counts as the decimal number it prints as, so write 0.1, not 1 - 0.9 (which prints
    as 0.09999999999999998), or take :func:`miscoverage` of the level.

    Args:
        m: samples in the uncertainty calibration set, at least 1.
        alpha: miscoverage level α in (0, 1).

    Raises:
        ValueError: m below 1 or α outside (0, 1).

    >>> conformal_rank(100, 0.1), conformal_rank(149, 0.18), conformal_rank(40, 0.01)
    (91, 123, 41)
    """
    if m < 1:
        raise ValueError(f"m = {m} samples; a conformal quantile needs at least one.")
    return math.ceil((m + 1) * (1 - _exact(alpha, "alpha", "0.1 for 90% intervals")))


def samples_needed(alpha: float | Fraction) -> int:
    """The smallest m with a finite quantile: ⌈(1-α)/α⌉.

    >>> samples_needed(0.01), samples_needed(0.1)
    (99, 9)
    """
    exact = _exact(alpha, "alpha", "0.1 for 90% intervals")
    return math.ceil((1 - exact) / exact)


def conformal_quantile(scores: Tensor, alpha: float | Fraction) -> Tensor:
    """Q(1-α): the k-th smallest score with k = :func:`conformal_rank`; never interpolated.

    With k > m no finite quantile has the coverage: the answer is +inf, with one warning for the
    whole tensor.

    Args:
        scores: (m, ...) nonconformity scores; +inf is a score, NaN is not.
        alpha: miscoverage level α in (0, 1).

    Returns:
        (...) quantiles along dimension 0.

    Raises:
        ValueError: no samples, NaN scores, or α outside (0, 1).

    >>> conformal_quantile(torch.arange(1.0, 101.0), 0.1).item()
    91.0
    """
    if scores.ndim == 0 or len(scores) == 0:
        raise ValueError(
            f"scores of shape {tuple(scores.shape)}: at least one sample along dimension 0 is "
            "needed, shape (m, ...)."
        )
    if not scores.is_floating_point():
        scores = scores.to(torch.get_default_dtype())
    if n_nan := int(scores.isnan().sum()):
        raise ValueError(
            f"{n_nan} of {scores.numel()} scores are NaN: a quantile over them means nothing; "
            "find what made them (0/0 for an exact prediction with σ = 0?)."
        )
    rank = conformal_rank(len(scores), alpha)
    if rank > len(scores):
        warn_too_few(len(scores), alpha, stacklevel=3)
        return torch.full_like(scores[0], torch.inf)
    return scores.kthvalue(rank, dim=0).values


def warn_too_few(
    m: int,
    alpha: float | Fraction,
    stacklevel: int = 2,
    *,
    what: str = "samples in the uncertainty calibration set",
    needed: int | None = None,
) -> None:
    """Say that m samples allow no finite interval at this level, and how many are missing.

    ``what`` is counted; ``needed``: how many it takes, None for :func:`samples_needed`.
    """
    needed = samples_needed(alpha) if needed is None else needed
    level = 100 * (1 - Fraction(str(alpha)))
    warnings.warn(
        f"{m} {what} are too few for a {float(level):g}% interval: it needs {needed}, "
        f"{needed - m} more. The interval is infinite.",
        stacklevel=stacklevel,
    )


def _exact(value: float | Fraction, name: str, example: str) -> Fraction:
    """The decimal number that a float prints as, if it is in (0, 1)."""
    try:
        exact = Fraction(str(value))
    except ValueError:  # "nan", "inf"
        exact = Fraction(-1)
    if not 0 < exact < 1:
        raise ValueError(f"{name} = {value} is outside (0, 1); give for instance {example}.")
    return exact


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

    Each tail beyond the band has at most probability (1 - confidence)/2; the other arguments and
    errors are those of :func:`coverage_law`.

    Returns:
        Lowest and highest covered fraction inside the band, both included.

    Raises:
        ValueError: confidence outside (0, 1).

    >>> coverage_band(n=1000, m=1000, alpha=0.1, confidence=0.998)
    (0.855, 0.938)
    """
    if not 0 < confidence < 1:
        raise ValueError(f"confidence = {confidence} is outside (0, 1); give for instance 0.999.")
    law = coverage_law(n, m, alpha)
    tail = (1 - confidence) / 2
    return float(law.ppf(tail)) / n, float(law.isf(tail)) / n
