"""An exchangeability martingale: whether a stream still looks like the references.

Vovk, Nouretdinov, Gammerman (2003), "Testing exchangeability on-line"; Vovk, Petej, Nouretdinov,
Ahlberg, Carlsson, Gammerman (2021), "Retrain or not retrain: conformal test martingales for
change-point detection" (arXiv 2102.10439).
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


class PValues:
    """Smoothed conformal p-values of one statistic, on-line.

    p = (#{i: a_i > a} + U #{i: a_i = a}) / (m + 1), the new value counted among the a_i = a, with
    U uniform. Each value joins the bag afterwards: only so are successive p-values independent
    (with a bag that stays, one unlucky bag makes all p-values small).

    Args:
        references: values of the references.

    >>> values = PValues([1.0, 2.0, 3.0])
    >>> values.of(2.5, 0.5)
    0.375
    """

    def __init__(self, references: Sequence[float]) -> None:
        self.bag = sorted(float(value) for value in references)

    def of(self, value: float, uniform: float) -> float:
        """The p-value of the next one: small where it is large, near 1 where it is small.

        Args:
            value: of the statistic.
            uniform: drawn from (0, 1).
        """
        low, high = bisect.bisect_left(self.bag, value), bisect.bisect_right(self.bag, value)
        larger, same = len(self.bag) - high, high - low + 1
        self.bag.insert(high, value)
        return (larger + uniform * same) / len(self.bag)


EXPONENTS: tuple[float, ...] = (0.2, 0.5)
"""ε of the power bets: bold, and cautious."""


def bets(p: Vector) -> Vector:
    """Power bets ε p^(ε-1) on small p, and the same on small 1 - p.

    The mean of each over a uniform p is 1, so that its products are martingales.

    Args:
        p: (K,) in [0, 1].

    Returns:
        (K, 2, number of exponents).

    >>> bets(np.array([0.25]))[0, 0, 1].item()
    1.0
    """
    both = np.clip(np.stack([p, 1.0 - p], 1), 1e-12, 1.0)[..., None]
    epsilon = np.array(EXPONENTS)
    return np.asarray(epsilon * both ** (epsilon - 1.0))


class ExchangeabilityMartingale:
    """Wealth of a gambler who bets against exchangeability; large wealth is evidence.

    One test lasts ``period`` values. Its unit of money is shared evenly among strategies
    (statistic, side, exponent) and among the moments at which one may begin, so that a change late
    in the period is found as soon as one at its start: with bets b, the share A of a strategy is

        A_n = (A_(n-1) + 1/period) · b(p_n),    wealth = mean A_n + (1 - n/period).

    Means of martingales are martingales, whatever the dependence between the statistics, so that
    by Ville's inequality P(wealth ever ≥ 1/δ) ≤ δ while the values are exchangeable with the
    references. Then the next test begins with the references alone.

    Args:
        references: (m, K) values of the statistics.
        period: values of one test.
        seed: of the random ties.
    """

    def __init__(self, references: Vector, period: int, seed: int) -> None:
        self.references = np.asarray(references, float)
        self.period = period
        self.seed = seed
        self.tests = 0
        self.restart()

    def restart(self) -> None:
        """Begin the next test."""
        self.tests += 1
        self.fed: list[Vector] = []
        self.values = [PValues(column) for column in self.references.T.tolist()]
        self.shares = np.zeros((self.references.shape[1], 2, len(EXPONENTS)))

    def go_on(self, tests: int, fed: Vector, shares: Vector) -> None:
        """Become what another martingale with the same references was.

        Args:
            tests: how many it had begun.
            fed: (n, K) values of its present test.
            shares: its.
        """
        self.restart()
        self.tests = tests
        self.fed = list(fed)
        for row in self.fed:
            for known, value in zip(self.values, row, strict=True):
                bisect.insort(known.bag, float(value))
        self.shares = np.array(shares)

    @property
    def wealth(self) -> float:
        """At least 0; 1 before the first value."""
        return float(self.shares.mean()) + 1.0 - len(self.fed) / self.period

    @property
    def oddest(self) -> int:
        """Which statistic has brought most."""
        return int(self.shares.max((1, 2)).argmax())

    def within(self, values: Vector) -> bool:
        """Whether values lie within the range of the references, all of them.

        Args:
            values: (K,) one of each statistic.
        """
        low, high = self.references.min(0), self.references.max(0)
        return bool(((values >= low) & (values <= high)).all())

    def feed(self, values: Vector) -> float:
        """Bet on the next values.

        Args:
            values: (K,) one of each statistic.

        Returns:
            The wealth after it.
        """
        if len(self.fed) >= self.period:
            self.restart()
        # No generator that goes along: what is drawn depends on the place in the stream alone.
        draw = np.random.default_rng([self.seed, self.tests, len(self.fed)])
        uniform = draw.uniform(size=len(self.values))
        p = np.array(
            [
                known.of(float(value), float(u))
                for known, value, u in zip(self.values, values, uniform, strict=True)
            ]
        )
        self.shares = (self.shares + 1.0 / self.period) * bets(p)
        self.fed.append(np.array(values, float))
        return self.wealth
