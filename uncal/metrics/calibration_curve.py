"""Empirical against nominal coverage, over many levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from uncal.metrics.functional import covered


class CalibrationError(NamedTuple):
    """How far a calibration curve is from the diagonal.

    Attributes:
        absolute: (D,) mean over the levels of |empirical - nominal|, in 0..1.
        signed: (D,) mean over the levels of empirical - nominal; positive: intervals too wide.
    """

    absolute: Tensor
    signed: Tensor


def calibration_curve(lower: Tensor, upper: Tensor, target: Tensor) -> Tensor:
    """Observed coverage per output at each of L levels.

    Even a perfect conformal method is not on the diagonal: at each point the
    Beta-Binomial law (:func:`uncal.uncertainty.coverage_band` at that level) says how far off it
    may be. The points of one curve share their samples, hence are dependent.

    Args:
        lower: (L, n, D) lower bounds, one set of intervals per level; -inf allowed.
        upper: (L, n, D) upper bounds; +inf allowed, such an interval covers.
        target: (n, D) finite truth.

    Returns:
        (L, D) covered fraction in 0..1.

    Raises:
        ValueError: other shapes, no levels, no samples, NaN, crossed bounds, an infinite target.

    >>> lower, target = torch.zeros(2, 4, 1), torch.tensor([[0.5], [1.0], [1.5], [2.5]])
    >>> upper = torch.stack([torch.full((4, 1), 1.0), torch.full((4, 1), 2.0)])
    >>> calibration_curve(lower, upper, target).flatten().tolist()
    [0.5, 0.75]
    """
    inside = covered_per_level(lower, upper, target)
    return inside.to(torch.promote_types(target.dtype, torch.float32)).mean(1)


def calibration_error(observed: Tensor, levels: Sequence[float]) -> CalibrationError:
    """Mean distance of a calibration curve from the diagonal, per output.

    Args:
        observed: (L, D) :func:`calibration_curve`.
        levels: L nominal levels, in (0, 1).

    Returns:
        The mean absolute and the mean signed distance, both (D,).

    Raises:
        ValueError: another number of levels, none, or a level outside (0, 1).

    >>> error = calibration_error(torch.tensor([[0.6], [0.7]]), levels=[0.5, 0.8])
    >>> [round(value.item(), 3) for value in error]
    [0.1, 0.0]
    """
    check_levels(levels)
    if observed.ndim != 2 or len(observed) != len(levels):
        raise ValueError(
            f"a curve of shape {tuple(observed.shape)} for {len(levels)} levels; expected "
            f"({len(levels)}, D), one row per level."
        )
    nominal = torch.tensor(list(levels), dtype=observed.dtype, device=observed.device)
    distance = observed - nominal[:, None]
    return CalibrationError(distance.abs().mean(0), distance.mean(0))


def covered_per_level(lower: Tensor, upper: Tensor, target: Tensor) -> Tensor:
    """Whether each target lies in its interval of each level.

    Args:
        lower: (L, n, D) lower bounds.
        upper: (L, n, D) upper bounds.
        target: (n, D) finite truth.

    Returns:
        (L, n, D) bool.

    Raises:
        ValueError: as :func:`calibration_curve`.
    """
    if lower.ndim != 3 or target.ndim != 2 or lower.shape[1:] != target.shape:
        raise ValueError(
            f"bounds {tuple(lower.shape)} and target {tuple(target.shape)}; expected (L, n, D) and "
            "(n, D), one set of intervals per level."
        )
    return covered(lower, upper, target.expand_as(lower))


def check_levels(levels: Sequence[float]) -> None:
    """Refuse levels that a curve cannot have.

    Raises:
        ValueError: none, or one outside (0, 1).
    """
    bad = [level for level in levels if not 0 < level < 1]
    if bad or not levels:
        raise ValueError(
            f"levels {list(levels)}: expected at least one, all in (0, 1), such as 0.9 for 90%."
        )
