"""The metrics of boxes as torchmetrics: coverage of all outputs at once, and sizes."""

from __future__ import annotations

import torch
from torch import Tensor
from torchmetrics import Metric

from uncal.metrics.joint import jointly_covered, log_volume


class JointPICP(Metric):
    """Fraction of samples whose box holds all outputs; see :func:`joint.joint_picp`.

    >>> metric = JointPICP()
    >>> metric.update(torch.zeros(2, 2), torch.ones(2, 2), torch.tensor([[0.0, 1.0], [0.0, 2.0]]))
    >>> metric.compute()
    tensor(0.5000)
    """

    full_state_update = False
    is_differentiable = False
    higher_is_better = None
    inside: Tensor
    count: Tensor

    def __init__(self) -> None:
        """Make empty counts."""
        super().__init__()
        self.add_state("inside", default=torch.tensor(0), dist_reduce_fx="sum")
        self.add_state("count", default=torch.tensor(0), dist_reduce_fx="sum")

    def update(self, lower: Tensor, upper: Tensor, target: Tensor) -> None:
        """Add (n, D) intervals and their targets."""
        held = jointly_covered(lower, upper, target)
        self.inside += held.sum()
        self.count += len(held)

    def compute(self) -> Tensor:
        """() the fraction in 0..1."""
        return self.inside / self.count


class _LogVolumes(Metric):
    """Mean log-volumes of one or more sets of boxes.

    Infinite boxes are counted, not summed: with a box of no volume in another batch or process the
    sum would be inf - inf.

    Args:
        num_outputs: D, the number of outputs.
        num_sets: how many sets of boxes there are.
    """

    full_state_update = False
    is_differentiable = False
    higher_is_better = False
    total: Tensor
    infinite: Tensor
    count: Tensor

    def __init__(self, num_outputs: int, num_sets: int) -> None:
        """Make empty sums."""
        super().__init__()
        if num_outputs < 1:
            raise ValueError(f"num_outputs = {num_outputs}; a metric needs at least one output.")
        self.num_outputs = num_outputs
        self.add_state("total", default=torch.zeros(num_sets), dist_reduce_fx="sum")
        self.add_state(
            "infinite", default=torch.zeros(num_sets, dtype=torch.int64), dist_reduce_fx="sum"
        )
        self.add_state("count", default=torch.tensor(0), dist_reduce_fx="sum")

    def _add(self, *boxes: tuple[Tensor, Tensor]) -> None:
        """Add the (n, D) bounds of each set."""
        shapes = [tuple(lower.shape) for lower, _ in boxes]
        if any(shape[1:] != (self.num_outputs,) or shape != shapes[0] for shape in shapes):
            raise ValueError(
                f"boxes of shape {', '.join(map(str, shapes))}; expected (n, {self.num_outputs}) "
                f"as num_outputs = {self.num_outputs} says."
            )
        logs = torch.stack([log_volume(lower, upper) for lower, upper in boxes])
        unbounded = logs.isposinf()
        self.infinite += unbounded.sum(1)
        self.total += torch.where(unbounded, 0.0, logs).sum(1)
        self.count += logs.shape[1]

    def _means(self) -> Tensor:
        """(num_sets,) mean log-volumes."""
        return torch.where(self.infinite > 0, torch.inf, self.total / self.count)


class MeanLogVolume(_LogVolumes):
    """Mean log-volume of boxes; see :func:`joint.mean_log_volume`.

    Args:
        num_outputs: D, the number of outputs.

    >>> metric = MeanLogVolume(num_outputs=1)
    >>> metric.update(torch.zeros(2, 1), torch.tensor([[2.0], [0.5]]), torch.zeros(2, 1))
    >>> metric.compute()
    tensor(0.)
    """

    def __init__(self, num_outputs: int) -> None:
        """Make empty sums."""
        super().__init__(num_outputs, num_sets=1)

    def update(self, lower: Tensor, upper: Tensor, target: Tensor) -> None:
        """Add (n, D) intervals; the targets only keep the call the same for all metrics."""
        self._add((lower, upper))

    def compute(self) -> Tensor:
        """() the mean; +inf as soon as one box is infinite."""
        return self._means()[0]


class GeometricMeanWidth(MeanLogVolume):
    """Geometric mean width of boxes; see :func:`joint.geometric_mean_width`.

    Args:
        num_outputs: D, the number of outputs.

    >>> metric = GeometricMeanWidth(num_outputs=2)
    >>> metric.update(torch.zeros(1, 2), torch.tensor([[4.0, 9.0]]), torch.zeros(1, 2))
    >>> metric.compute().round()
    tensor(6.)
    """

    def compute(self) -> Tensor:
        """() the width; +inf as soon as one box is infinite."""
        return (self._means()[0] / self.num_outputs).exp()


class RelativeSize(_LogVolumes):
    """How wide boxes A are relative to boxes B; see :func:`joint.relative_size`.

    Args:
        num_outputs: D, the number of outputs.

    >>> metric = RelativeSize(num_outputs=1)
    >>> zeros = torch.zeros(2, 1)
    >>> metric.update(zeros, torch.full((2, 1), 4.0), zeros, torch.full((2, 1), 2.0))
    >>> metric.compute()
    tensor(2.)
    """

    def __init__(self, num_outputs: int) -> None:
        """Make empty sums."""
        super().__init__(num_outputs, num_sets=2)

    def update(
        self, lower: Tensor, upper: Tensor, other_lower: Tensor, other_upper: Tensor
    ) -> None:
        """Add the (n, D) bounds of A and of B."""
        self._add((lower, upper), (other_lower, other_upper))

    def compute(self) -> Tensor:
        """() the factor; +inf if only A is infinite somewhere, 0 if only B, NaN if both."""
        first, second = self._means()
        ratio: Tensor = (first - second) / self.num_outputs
        return ratio.exp()
