"""The calibration curve as torchmetrics."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torchmetrics import Metric

from uncal.metrics.calibration_curve import calibration_error, check_levels, covered_per_level


class CalibrationCurve(Metric):
    """Observed coverage per level and output; see :func:`calibration_curve.calibration_curve`.

    Args:
        num_outputs: D, the number of outputs.
        levels: L coverage levels in (0, 1).

    >>> metric = CalibrationCurve(num_outputs=1, levels=[0.5, 0.8])
    >>> upper = torch.tensor([1.0, 2.0])[:, None, None].expand(2, 4, 1)
    >>> metric.update(torch.zeros(2, 4, 1), upper, torch.tensor([[0.5], [1.0], [1.5], [2.5]]))
    >>> metric.compute().flatten().tolist()
    [0.5, 0.75]
    """

    full_state_update = False
    is_differentiable = False
    higher_is_better: bool | None = None
    inside: Tensor
    count: Tensor

    def __init__(self, num_outputs: int, levels: Sequence[float]) -> None:
        """Make empty counts."""
        super().__init__()
        if num_outputs < 1:
            raise ValueError(f"num_outputs = {num_outputs}; a metric needs at least one output.")
        check_levels(levels)
        self.levels = tuple(levels)
        counts = torch.zeros(len(self.levels), num_outputs, dtype=torch.int64)
        self.add_state("inside", default=counts, dist_reduce_fx="sum")
        self.add_state("count", default=torch.tensor(0), dist_reduce_fx="sum")

    def update(self, lower: Tensor, upper: Tensor, target: Tensor) -> None:
        """Add (L, n, D) intervals, one set per level, and their (n, D) targets."""
        if (len(lower), target.shape[-1]) != tuple(self.inside.shape):
            raise ValueError(
                f"bounds {tuple(lower.shape)} and target {tuple(target.shape)}; expected "
                f"({len(self.levels)}, n, {self.inside.shape[1]}), one set per level of the metric."
            )
        self.inside += covered_per_level(lower, upper, target).sum(1)
        self.count += len(target)

    def compute(self) -> Tensor:
        """(L, D) the covered fractions in 0..1."""
        return self.inside / self.count


class CalibrationCurveError(CalibrationCurve):
    """Mean absolute distance of the curve from the diagonal, per output.

    See :func:`calibration_curve.calibration_error`.

    Args:
        num_outputs: D, the number of outputs.
        levels: L coverage levels in (0, 1).
        signed: the mean signed distance instead: positive where intervals are too wide.

    >>> metric = CalibrationCurveError(num_outputs=1, levels=[0.5, 0.8])
    >>> upper = torch.tensor([1.0, 2.0])[:, None, None].expand(2, 4, 1)
    >>> metric.update(torch.zeros(2, 4, 1), upper, torch.tensor([[0.5], [1.0], [1.5], [2.5]]))
    >>> round(metric.compute().item(), 4)
    0.025
    """

    higher_is_better = False

    def __init__(self, num_outputs: int, levels: Sequence[float], signed: bool = False) -> None:
        """Make empty counts."""
        super().__init__(num_outputs, levels)
        self.signed = signed

    def compute(self) -> Tensor:
        """(D,) the error in 0..1; torchmetrics makes D = 1 a scalar."""
        error = calibration_error(self.inside / self.count, self.levels)
        return error.signed if self.signed else error.absolute
