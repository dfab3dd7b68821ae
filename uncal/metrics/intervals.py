"""The interval metrics as torchmetrics: accumulated over batches and summed over processes."""

from __future__ import annotations

import torch
from torch import Tensor
from torchmetrics import Metric

from uncal.metrics.functional import covered, score, width


class _MeanPerOutput(Metric):
    """The mean over samples of something per output: a sum and a count."""

    full_state_update = False
    is_differentiable = False
    total: Tensor
    count: Tensor

    def __init__(self, num_outputs: int) -> None:
        super().__init__()
        if num_outputs < 1:
            raise ValueError(f"num_outputs = {num_outputs}; a metric needs at least one output.")
        self.num_outputs = num_outputs
        self.add_state("total", default=torch.zeros(num_outputs), dist_reduce_fx="sum")
        self.add_state("count", default=torch.tensor(0), dist_reduce_fx="sum")

    def compute(self) -> Tensor:
        """(D,) the mean over all samples so far; torchmetrics makes D = 1 a scalar."""
        return self.total / self.count

    def _accumulate(self, values: Tensor) -> None:
        """Add (n, D) values."""
        if values.ndim != 2 or values.shape[1] != self.num_outputs:
            raise ValueError(
                f"intervals of shape {tuple(values.shape)}; expected (n, {self.num_outputs}) as "
                f"num_outputs = {self.num_outputs} says."
            )
        self.total += values.sum(0)
        self.count += len(values)


class PICP(_MeanPerOutput):
    """Prediction interval coverage probability per output; see :func:`functional.picp`.

    >>> metric = PICP(num_outputs=1)
    >>> metric.update(torch.zeros(4, 1), torch.ones(4, 1), torch.tensor([[-1.], [0.], [.5], [1.]]))
    >>> metric.compute()
    tensor(0.7500)
    """

    higher_is_better = None

    def update(self, lower: Tensor, upper: Tensor, target: Tensor) -> None:
        """Add (n, D) intervals and their targets."""
        self._accumulate(covered(lower, upper, target))


class MPIW(_MeanPerOutput):
    """Mean prediction interval width per output; see :func:`functional.mpiw`.

    >>> metric = MPIW(num_outputs=1)
    >>> metric.update(torch.zeros(2, 1), torch.tensor([[1.0], [3.0]]), torch.zeros(2, 1))
    >>> metric.compute()
    tensor(2.)
    """

    higher_is_better = False

    def update(self, lower: Tensor, upper: Tensor, target: Tensor) -> None:
        """Add (n, D) intervals; the targets only keep the call the same for all metrics."""
        self._accumulate(width(lower, upper))


class IntervalScore(_MeanPerOutput):
    """Mean interval score per output at one level α; see :func:`functional.interval_score`.

    >>> metric = IntervalScore(num_outputs=1, alpha=0.5)
    >>> metric.update(torch.zeros(2, 1), torch.ones(2, 1), torch.tensor([[0.5], [1.5]]))
    >>> metric.compute()
    tensor(2.)
    """

    higher_is_better = False

    def __init__(self, num_outputs: int, alpha: float) -> None:
        super().__init__(num_outputs)
        if not 0 < alpha < 1:
            raise ValueError(f"alpha = {alpha} is outside (0, 1); give for instance 0.1 for 90%.")
        self.alpha = alpha

    def update(self, lower: Tensor, upper: Tensor, target: Tensor) -> None:
        """Add (n, D) intervals and their targets."""
        self._accumulate(score(lower, upper, target, self.alpha))
