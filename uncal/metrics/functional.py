"""Quality of prediction intervals: coverage, width and interval score, as pure functions.

Every function exists per sample (``covered``, ``width``, ``score``) and as the paper's mean over
the samples (``picp``, ``mpiw``, ``interval_score``), the latter along dimension 0. Infinite bounds
are intervals like others; NaN never is. Half precision is computed in float32.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor


def covered(lower: Tensor, upper: Tensor, target: Tensor) -> Tensor:
    """Whether each target lies in its closed interval [lower, upper].

    Args:
        lower: (n, ...) lower bounds, -inf allowed.
        upper: (n, ...) upper bounds, +inf allowed.
        target: (n, ...) finite truth.

    Returns:
        (n, ...) bool.

    Raises:
        ValueError: other shapes, no samples, NaN, crossed bounds, or an infinite target.

    >>> covered(torch.zeros(3), torch.ones(3), torch.tensor([-0.1, 0.0, 1.0])).tolist()
    [False, True, True]
    """
    lower, upper, target = _checked_target(lower, upper, target)
    return (lower <= target) & (target <= upper)


def width(lower: Tensor, upper: Tensor) -> Tensor:
    """The width of each interval: (n, ...), at least 0, in the bounds' units.

    Arguments and errors are those of :func:`covered`.

    >>> width(torch.tensor([0.0, -torch.inf]), torch.tensor([2.0, torch.inf])).tolist()
    [2.0, inf]
    """
    lower, upper = _checked_bounds(lower, upper)
    return upper - lower


def score(lower: Tensor, upper: Tensor, target: Tensor, alpha: float) -> Tensor:
    """The interval score of each sample: width plus 2/α times the distance of a miss.

    Arguments and errors are those of :func:`covered`; alpha is the miscoverage level in (0, 1).

    Returns:
        (n, ...) scores in the bounds' units; lower is better, +inf for an infinite interval.

    >>> score(torch.zeros(2), torch.ones(2), torch.tensor([0.5, 1.5]), alpha=0.5).tolist()
    [1.0, 3.0]
    """
    if not 0 < alpha < 1:
        raise ValueError(f"alpha = {alpha} is outside (0, 1); give for instance 0.1 for 90%.")
    lower, upper, target = _checked_target(lower, upper, target)
    # Distances instead of the paper's indicator products: 0 · inf would be NaN.
    below = (lower - target).clamp_min(0)
    above = (target - upper).clamp_min(0)
    return (upper - lower) + (2 / alpha) * (below + above)


def picp(lower: Tensor, upper: Tensor, target: Tensor) -> Tensor:
    """Prediction interval coverage probability: 1/m Σ 1(y ∈ [lower, upper])   (paper, eq. 6).

    Arguments and errors are those of :func:`covered`, with (n, D) for (n, ...).

    Returns:
        (D,) covered fraction in 0..1.

    >>> picp(torch.zeros(4), torch.ones(4), torch.tensor([-0.1, 0.0, 0.5, 1.0])).item()
    0.75
    """
    inside = covered(lower, upper, target)
    return inside.to(torch.promote_types(target.dtype, torch.float32)).mean(0)


def mpiw(lower: Tensor, upper: Tensor) -> Tensor:
    """Mean prediction interval width: 1/m Σ (upper - lower)   (paper, eq. 7).

    Arguments and errors are those of :func:`width`, with (n, D) for (n, ...).

    Returns:
        (D,) mean width in the bounds' units; +inf if any interval is infinite.

    >>> mpiw(torch.tensor([0.0, -1.0]), torch.tensor([1.0, 2.0])).item()
    2.0
    """
    return width(lower, upper).mean(0)


def interval_score(lower: Tensor, upper: Tensor, target: Tensor, alpha: float) -> Tensor:
    """Mean interval score (Gneiting and Raftery 2007; paper, eq. 8).

    IS = 1/m Σ [(upper - lower) + 2/α (lower - y) 1(y < lower) + 2/α (y - upper) 1(y > upper)]

    Arguments and errors are those of :func:`score`, with (n, D) for (n, ...).

    Returns:
        (D,) mean score in the bounds' units; lower is better, +inf if any interval is infinite.

    >>> interval_score(torch.zeros(2), torch.ones(2), torch.tensor([0.5, 1.5]), alpha=0.5).item()
    2.0
    """
    return score(lower, upper, target, alpha).mean(0)


def _checked_bounds(lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor]:
    if lower.shape != upper.shape or lower.ndim == 0 or len(lower) == 0:
        raise ValueError(
            f"lower {tuple(lower.shape)} and upper {tuple(upper.shape)} must have one shape (n, D) "
            "with at least one sample."
        )
    for name, values in (("lower", lower), ("upper", upper)):
        if n_nan := int(values.isnan().sum()):
            raise ValueError(
                f"{n_nan} of {values.numel()} values of {name} are NaN; a mean over them would "
                "hide it. Find where they come from, or leave those samples out."
            )
    # Also [inf, inf], which holds no number and has no width.
    crossed = (lower > upper) | (lower == torch.inf) | (upper == -torch.inf)
    if n_crossed := int(crossed.sum()):
        raise ValueError(
            f"{n_crossed} of {lower.numel()} intervals are empty (lower > upper, or lower = inf, "
            "or upper = -inf); give lower first, then upper."
        )
    return _at_least_float32(lower), _at_least_float32(upper)


def _checked_target(lower: Tensor, upper: Tensor, target: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    lower, upper = _checked_bounds(lower, upper)
    if target.shape != lower.shape:
        raise ValueError(
            f"target {tuple(target.shape)} must have the bounds' shape {tuple(lower.shape)}."
        )
    if n_bad := int((~target.isfinite()).sum()):
        raise ValueError(
            f"{n_bad} of {target.numel()} values of target are NaN or infinite; the truth must be "
            "finite. Leave those samples out."
        )
    return lower, upper, _at_least_float32(target)


def _at_least_float32(values: Tensor) -> Tensor:
    return values.to(torch.promote_types(values.dtype, torch.float32))


class CalibrationError(NamedTuple):
    """How far a calibration curve is from the diagonal.

    Attributes:
        absolute: (D,) mean over the levels of |empirical - nominal|, in 0..1.
        signed: (D,) mean over the levels of empirical - nominal; positive: intervals too wide.
    """

    absolute: Tensor
    signed: Tensor


def calibration_error(observed: Tensor, levels: Sequence[float]) -> CalibrationError:
    """Mean distance of a calibration curve from the diagonal, per output.

    Even a perfect conformal method is not on the diagonal: at each point the Beta-Binomial law
    (:func:`uncal.uncertainty.coverage_band` at that level) says how far off it may be.

    Args:
        observed: (L, D) empirical coverage in 0..1, one row per level.
        levels: L nominal levels, in (0, 1).

    Raises:
        ValueError: another number of levels, none, or a level outside (0, 1).

    >>> error = calibration_error(torch.tensor([[0.6], [0.7]]), levels=[0.5, 0.8])
    >>> [round(value.item(), 3) for value in error]
    [0.1, 0.0]
    """
    if not levels or not all(0 < level < 1 for level in levels):
        raise ValueError(
            f"levels {list(levels)}: expected at least one, all in (0, 1), such as 0.9 for 90%."
        )
    if observed.ndim != 2 or len(observed) != len(levels):
        raise ValueError(
            f"a curve of shape {tuple(observed.shape)} for {len(levels)} levels; expected "
            f"({len(levels)}, D), one row per level."
        )
    nominal = torch.tensor(list(levels), dtype=observed.dtype, device=observed.device)
    distance = observed - nominal[:, None]
    return CalibrationError(distance.abs().mean(0), distance.mean(0))
