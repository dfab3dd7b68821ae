"""What an interval method is given and what it answers."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Intervals:
    """Prediction intervals in the units of the network (eq. 5).

    Attributes:
        mean: (..., D) centres ŷ.
        std: (..., D) σ as used: after the floor where the method divides by σ, else as given.
        lower: (..., D) lower bounds, such as ŷ - Q σ.
        upper: (..., D) upper bounds, such as ŷ + Q σ.
        level: the nominal coverage 1-α, per output or jointly.
        joint: whether the level is that of all D outputs at once.
    """

    mean: Tensor
    std: Tensor
    lower: Tensor
    upper: Tensor
    level: float
    joint: bool = False


@dataclass(frozen=True)
class Anchors:
    """The family of nested intervals [lower - q·unit, upper + q·unit] that a method widens.

    The score of a target y is the q at which the interval starts to hold it:
    max(lower - y, y - upper) / unit, which is |ŷ - y|/σ for lower = upper = ŷ and unit = σ.

    Attributes:
        lower: (..., D) lower bounds at q = 0.
        upper: (..., D) upper bounds at q = 0.
        unit: (..., D) positive, what one unit of q adds on each side.
    """

    lower: Tensor
    upper: Tensor
    unit: Tensor

    def scores(self, target: Tensor) -> Tensor:
        """(..., D) the smallest q whose interval holds each target; negative well inside."""
        return (self.lower - target).maximum(target - self.upper) / self.unit

    def widened(self, quantile: Tensor) -> tuple[Tensor, Tensor]:
        """Lower and upper bounds at q; where a negative q would cross them, their midpoint.

        Args:
            quantile: q, broadcast to (..., D).
        """
        half = quantile * self.unit
        lower, upper = self.lower - half, self.upper + half
        crossed = lower > upper
        middle = (self.lower + self.upper) / 2
        return lower.where(~crossed, middle), upper.where(~crossed, middle)
