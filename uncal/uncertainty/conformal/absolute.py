"""Split conformal intervals of constant width, which look at no σ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor

from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.intervals import Anchors


class AbsoluteCalibrator(IntervalCalibrator):
    """Intervals [ŷ - Q, ŷ + Q] that hold each output with probability at least 1-α.

    s = |ŷ - y|, Q = s_(⌈(m+1)(1-α)⌉): what conformal prediction gives without any σ, and so the
    measure of what σ adds. The box of :meth:`predict_joint` has the score max_j |r_j| / scale_j
    and half widths Q·scale_j: metres and radians need scales to be compared.

    Args:
        names: the outputs' names in messages.
        scales: (D,) such as the largest decalibration per output, in its units. Constants, since
            scales learned from the scores' own frames would cost the guarantee. None for ones.

    Raises:
        ConfigurationError: scales that are not positive and finite.

    >>> target = torch.arange(1.0, 10.0)[:, None] * torch.tensor([0.1, 1.0])
    >>> zeros = torch.zeros(9, 2)
    >>> calibrator = AbsoluteCalibrator(scales=[0.1, 2.0]).fit(zeros, zeros, target)
    >>> calibrator.predict(zeros[0], zeros[0], 0.5).upper
    tensor([0.5000, 5.0000])
    >>> calibrator.predict_joint(zeros[0], zeros[0], 0.5).upper
    tensor([ 0.5000, 10.0000])
    """

    kind: ClassVar[str] = "absolute"
    needs_std: ClassVar[bool] = False

    def __init__(
        self, names: Sequence[str] | None = None, scales: Sequence[float] | None = None
    ) -> None:
        """Make an unfitted calibrator."""
        super().__init__(names, scales=scales)

    def _anchors(self, mean: Tensor, std: Tensor, bounds: tuple[Tensor, Tensor] | None) -> Anchors:
        return Anchors(mean, mean, torch.ones_like(mean))
