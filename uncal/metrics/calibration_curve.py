"""Empirical against nominal coverage, over many levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor


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
