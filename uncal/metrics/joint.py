"""All outputs at once: how often a box of intervals holds the whole vector, and how big it is.

A box is (D,) intervals side by side. Six 90% intervals hold the whole pose far less than 90% of
the time, hence the joint coverage. A volume over metres and radians means little as a number, but
the ratio of two volumes means the same in any units; its D-th root, the geometric mean of the
ratios of the widths, reads as "so many times as wide per output".
"""

from __future__ import annotations

import torch
from torch import Tensor

from uncal.metrics.functional import covered, width


def jointly_covered(lower: Tensor, upper: Tensor, target: Tensor) -> Tensor:
    """Whether each box holds all outputs of its target at once.

    Arguments and errors are those of :func:`uncal.metrics.functional.covered`, with (n, D).

    Returns:
        (n,) bool.

    >>> jointly_covered(torch.zeros(2, 2), torch.ones(2, 2), torch.tensor([[0, 1.0], [0, 2.0]]))
    tensor([ True, False])
    """
    _check_boxes(lower)
    return covered(lower, upper, target).all(1)


def log_volume(lower: Tensor, upper: Tensor) -> Tensor:
    """Natural logarithm of each box's volume: Σ_j log(upper_j - lower_j).

    Returns:
        (n,) of (n, D) bounds: +inf for a box with an infinite side, even where another side has no
        width; -inf for a finite box with a side of no width.

    Raises:
        ValueError: as :func:`uncal.metrics.functional.width`, or no dimension D.

    >>> log_volume(torch.zeros(1, 2), torch.tensor([[2.0, 0.5]])).item()
    0.0
    """
    _check_boxes(lower)
    widths = width(lower, upper)
    # A side of no width and an infinite one would give inf - inf.
    unbounded = widths.isinf().any(1)
    return torch.where(unbounded, torch.inf, widths.log().sum(1))


def mean_log_volume(lower: Tensor, upper: Tensor) -> Tensor:
    """Mean over the samples of :func:`log_volume`; +inf as soon as one box is infinite.

    Arguments and errors are those of :func:`log_volume`.

    Returns:
        () logarithm of the geometric mean volume.

    >>> mean_log_volume(torch.zeros(2, 1), torch.tensor([[2.0], [0.5]])).item()
    0.0
    """
    logs = log_volume(lower, upper)
    return torch.where(logs.isposinf().any(), torch.inf, logs.mean())


def relative_size(lower: Tensor, upper: Tensor, other_lower: Tensor, other_upper: Tensor) -> Tensor:
    """How wide boxes A are relative to boxes B: the geometric mean of w_A/w_B.

    Taken over samples and outputs, (n, D) bounds each, so that it is free of units, and its D-th
    power is the ratio of the (geometric mean) volumes.

    Returns:
        () factor: +inf if only A has an infinite box, 0 if only B has one, NaN if both have, or if
        both have a finite box of no volume: then nothing can be said.

    Raises:
        ValueError: as :func:`log_volume`, or A and B of other shapes.

    >>> zeros = torch.zeros(1, 2)
    >>> relative_size(zeros, torch.tensor([[4.0, 9.0]]), zeros, torch.ones(1, 2)).round().item()
    6.0
    """
    if lower.shape != other_lower.shape:
        raise ValueError(
            f"boxes {tuple(lower.shape)} and {tuple(other_lower.shape)}: two sets of boxes can "
            "only be compared on the same samples and outputs."
        )
    difference = mean_log_volume(lower, upper) - mean_log_volume(other_lower, other_upper)
    return (difference / lower.shape[1]).exp()


def _check_boxes(lower: Tensor) -> None:
    if lower.ndim != 2 or lower.shape[1] == 0:
        raise ValueError(
            f"bounds of shape {tuple(lower.shape)}: boxes are (n, D) with D ≥ 1, one row per "
            "sample and one column per output."
        )
