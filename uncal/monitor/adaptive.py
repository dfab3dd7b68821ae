"""By how much σ is multiplied: fixed after calibration, or adjusted where references arrive.

Without references of the stream itself nothing can tell that coverage has been lost, so that an
adjustment without them would follow a guess: it is off then.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from uncal.errors import ConfigurationError
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator

Vector = NDArray[np.float64]

STEP = 0.02
"""γ of adaptive conformal inference."""

PID_RATE = 0.1
"""η of the quantile tracker, relative to the calibrated quantile."""

PID_GAIN = 0.5
"""K_I of the error integrator, relative to the calibrated quantile."""

PID_SATURATION = 2.0
"""C_sat: how soon the integrator saturates."""


class Quantiles:
    """Calibrated quantiles of |error| / σ, per DoF and of the largest of the six.

    Args:
        calibrators: of estimates from 1 … W frames.
        level: of the intervals and of the joint region.
    """

    def __init__(self, calibrators: Sequence[IntervalCalibrator], level: float) -> None:
        self.calibrators = calibrators
        self.level = level
        self.table = np.stack([self._at(n, np.full(7, level)) for n in range(len(calibrators))])

    def of(self, frames: int) -> Vector:
        """(7,) multiples of σ: six DoF, then the joint box.

        Args:
            frames: whose evidence is in the estimate, 1 … W.
        """
        return np.array(self.table[frames - 1])

    def observe(self, frames: int, scores: Vector) -> None:
        """Take in what a reference says of the last estimate.

        Args:
            frames: whose evidence was in it.
            scores: (7,) |error| / σ of six DoF, and the largest of them.
        """

    def state(self) -> dict[str, Vector]:
        """What has been adjusted."""
        return {}

    def load(self, state: Mapping[str, Vector]) -> None:
        """Go on from there.

        Args:
            state: of :meth:`state`.
        """

    def _at(self, number: int, levels: Vector) -> Vector:
        return np.array([self._one(number, j, float(level)) for j, level in enumerate(levels)])

    def _one(self, number: int, j: int, level: float) -> float:
        if level <= 0.0:
            return 0.0
        if level >= 1.0:
            return math.inf
        calibrator = self.calibrators[number]
        if j == 6:
            return float(calibrator.joint_quantile(level))
        return float(calibrator.quantile(level)[j])


class AdaptiveLevels(Quantiles):
    """Adaptive conformal inference (Gibbs & Candès 2021, arXiv 2106.00170, eq. 2).

    α_(t+1) = α_t + γ (α - err_t), with err_t = 1 where the interval missed; α_t ≤ 0 makes it
    infinite, α_t ≥ 1 empty. The share of misses over T references is within (1 + γ)/(γ T) of α,
    whatever the stream does.
    """

    def __init__(self, calibrators: Sequence[IntervalCalibrator], level: float) -> None:
        super().__init__(calibrators, level)
        self.alpha = np.full(7, 1.0 - level)
        self._known: dict[tuple[int, int, float], float] = {}

    def of(self, frames: int) -> Vector:
        """As :meth:`Quantiles.of`, at the levels as they are now."""
        found = []
        for j, alpha in enumerate(self.alpha):
            key = (frames - 1, j, round(1.0 - float(alpha), 6))
            if key not in self._known:
                self._known[key] = self._one(*key)
            found.append(self._known[key])
        return np.array(found)

    def observe(self, frames: int, scores: Vector) -> None:
        """One step of every level."""
        missed = (scores > self.of(frames)).astype(float)
        self.alpha = self.alpha + STEP * (1.0 - self.level - missed)
        self._known.clear()

    def state(self) -> dict[str, Vector]:
        """The levels."""
        return {"alpha": self.alpha}

    def load(self, state: Mapping[str, Vector]) -> None:
        """Go on from there."""
        self.alpha = np.array(state["alpha"], float)


class ConformalPID(Quantiles):
    """Conformal PID control without a scorecaster (Angelopoulos, Candès, Tibshirani 2023).

    The quantile, in units of the calibrated one, follows (arXiv 2307.16895, eqs. 5 and 6)

        q_(t+1) = q̂_(t+1) + r_t,    q̂_(t+1) = q̂_t + η (err_t - α),
        r_t = K_I tan(log(t + 1) / (C_sat (t + 1)) · Σ_i (err_i - α)).
    """

    def __init__(self, calibrators: Sequence[IntervalCalibrator], level: float) -> None:
        super().__init__(calibrators, level)
        self.tracked = np.ones(7)
        self.excess = np.zeros(7)
        self.count = 0

    def of(self, frames: int) -> Vector:
        """As :meth:`Quantiles.of`, times what the controller says."""
        t = max(self.count, 1)
        angle = math.log(t + 1) / (PID_SATURATION * (t + 1)) * self.excess
        integral = PID_GAIN * np.tan(np.clip(angle, -1.5, 1.5))
        return np.asarray(self.table[frames - 1] * np.maximum(self.tracked + integral, 0.0))

    def observe(self, frames: int, scores: Vector) -> None:
        """One step of the controller."""
        missed = (scores > self.of(frames)).astype(float)
        over = missed - (1.0 - self.level)
        self.tracked = self.tracked + PID_RATE * over
        self.excess = self.excess + over
        self.count += 1

    def state(self) -> dict[str, Vector]:
        """Tracker, integral and number of references."""
        return {"tracked": self.tracked, "excess": self.excess, "count": np.array(self.count)}

    def load(self, state: Mapping[str, Vector]) -> None:
        """Go on from there."""
        self.tracked = np.array(state["tracked"], float)
        self.excess = np.array(state["excess"], float)
        self.count = int(state["count"])


def make_quantiles(
    adapt: str, calibrators: Sequence[IntervalCalibrator], level: float
) -> Quantiles:
    """The one that a setting names.

    Args:
        adapt: one of :data:`uncal.monitor.settings.ADAPTATIONS`.
        calibrators: of estimates from 1 … W frames.
        level: of the intervals.

    Raises:
        ConfigurationError: an infinite quantile cannot be controlled.
    """
    kinds = {"off": Quantiles, "aci": AdaptiveLevels, "pid": ConformalPID}
    made = kinds[adapt](calibrators, level)
    if adapt == "pid" and not np.isfinite(made.table).all():
        raise ConfigurationError(
            f"adapt=pid: too few references for level={level:g}; calibrate with more"
        )
    return made


def scores_of(mean: Vector, std: Vector, truth: Vector, floor: float) -> Vector:
    """(7,) |error| / σ of six DoF, and the largest of them.

    Args:
        mean: (6,) estimate.
        std: (6,) σ.
        truth: (6,) what the reference says.
        floor: smallest σ to divide by.
    """
    scores = np.abs(mean - truth) / np.maximum(std, floor)
    return np.append(scores, scores.max())
