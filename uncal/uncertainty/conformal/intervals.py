"""What an interval method is given and what it answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from uncal.errors import UncertaintyError


class InputChecks:
    """Refuses, with an UncertaintyError that names the outputs, what allows no valid interval.

    Args:
        names: the outputs' names; None numbers them.
        asker: the interval method in the messages.
    """

    def __init__(self, names: Sequence[str] | None, asker: str) -> None:
        self.names = None if names is None else tuple(names)
        self.asker = asker

    def sizes(self, mean: Tensor, std: Tensor, target: Tensor, n_scales: int) -> None:
        """Refuse anything but three (m, D) with m ≥ 1, one name and one scale per output."""
        if mean.ndim != 2 or len(mean) == 0 or not mean.shape == std.shape == target.shape:
            raise UncertaintyError(
                f"mean {tuple(mean.shape)}, std {tuple(std.shape)}, target {tuple(target.shape)}: "
                "all three must be (m, D) with m ≥ 1 samples of the uncertainty calibration set."
            )
        if self.names is not None and mean.shape[1] != len(self.names):
            raise UncertaintyError(
                f"{mean.shape[1]} outputs for {len(self.names)} names ({', '.join(self.names)}): "
                "give one name per output, in the network's order."
            )
        if n_scales not in (0, mean.shape[1]):
            raise UncertaintyError(
                f"{mean.shape[1]} outputs for {n_scales} scales: give one scale per output."
            )

    def finite(self, label: str, values: Tensor) -> None:
        """Refuse (..., D) values that are NaN or infinite, with how many of each output."""
        bad = ~values.isfinite()
        if bad.any():
            raise UncertaintyError(
                f"{int(bad.sum())} of {bad.numel()} values of {label} are NaN or infinite "
                f"({self._counts(bad)}): expected finite numbers. Leave those frames out, or "
                "find where the network diverges."
            )

    def spread(self, std: Tensor) -> None:
        """Refuse outputs whose (m, D) σ is 0 in all samples."""
        silent = (std == 0).all(0)
        if silent.any():
            names = zip(self._output_names(len(silent)), silent.tolist(), strict=True)
            raise UncertaintyError(
                f"σ = 0 in all {len(std)} samples of {', '.join(a for a, bad in names if bad)}: "
                "dropout does not reach them. Check that MC dropout is on (mcd.passes, dropout "
                "rates p > 0)."
            )

    def floored(self, std: Tensor, floor: float) -> Tensor:
        """(..., D) max(σ, floor), refusing σ that is negative, or 0 where there is no floor."""
        bad = std <= 0 if floor == 0 else std < 0
        if bad.any():
            raise UncertaintyError(
                f"{int(bad.sum())} of {bad.numel()} σ are not positive "
                f"({self._counts(bad)}), the smallest {float(std.min()):g}: a score divides "
                "by σ. Check that MC dropout is on, or set a small positive sigma_floor."
            )
        return std.clamp_min(floor)

    def bounds(
        self, bounds: tuple[Tensor, Tensor] | None, shape: torch.Size
    ) -> tuple[Tensor, Tensor]:
        """The lower and upper quantile outputs in float32 or better, if of the mean's shape."""
        if bounds is None or not bounds[0].shape == bounds[1].shape == shape:
            got = "none" if bounds is None else " and ".join(str(tuple(b.shape)) for b in bounds)
            raise UncertaintyError(
                f"{self.asker} needs bounds=(lower, upper), the network's own quantile outputs, "
                f"both {tuple(shape)}; got {got}."
            )
        for label, values in zip(("lower", "upper"), bounds, strict=True):
            self.finite(f"the {label} bounds", values)
        return at_least_float32(bounds[0]), at_least_float32(bounds[1])

    def groups(self, groups: Sequence[str] | None, rows: int | None = None) -> Sequence[str]:
        """The labels, one per row if the number of rows is given."""
        if groups is None or isinstance(groups, str):
            raise UncertaintyError(
                f"{self.asker} needs groups=, one label per row such as its drive or rig; "
                f"got {groups!r}."
            )
        if rows is not None and len(groups) != rows:
            raise UncertaintyError(f"{len(groups)} groups for {rows} rows: give one label per row.")
        return groups

    def _counts(self, mask: Tensor) -> str:
        """Such as "X: 3, Yaw: 1", for the marked entries of a (..., D) mask."""
        per_output = mask.reshape(-1, mask.shape[-1]).sum(0).tolist()
        names = self._output_names(len(per_output))
        return ", ".join(f"{a}: {n}" for a, n in zip(names, per_output, strict=True) if n)

    def _output_names(self, size: int) -> tuple[str, ...]:
        if self.names is not None and len(self.names) == size:
            return self.names
        return tuple(f"output {j}" for j in range(size))


def at_least_float32(values: Tensor) -> Tensor:
    """Half precision made float32; the rest as it is.

    >>> at_least_float32(torch.ones(1, dtype=torch.bfloat16)).dtype
    torch.float32
    """
    return values.to(torch.promote_types(values.dtype, torch.float32))


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
        """Bounds at q, broadcast to (..., D); where a negative q would cross them, the midpoint."""
        half = quantile * self.unit
        lower, upper = self.lower - half, self.upper + half
        crossed = lower > upper
        middle = (self.lower + self.upper) / 2
        return lower.where(~crossed, middle), upper.where(~crossed, middle)
