"""Coverage within bins as torchmetrics: fixed edges, or quantiles of all that has been seen."""

from __future__ import annotations

import torch
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from uncal.metrics.conditional import (
    BinnedCoverage,
    check_binnable,
    check_edges,
    count_by_bin,
    coverage_by_bin,
    worst_bin_coverage,
)
from uncal.metrics.functional import covered


class CoverageByBin(Metric):
    """Coverage in bins with fixed edges; see :func:`conditional.coverage_by_bin`.

    Args:
        num_outputs: D, the number of outputs.
        edges: (G-1,) or (G-1, D) inner edges, not decreasing.

    >>> metric = CoverageByBin(num_outputs=1, edges=torch.tensor([2.5]))
    >>> lower, upper = torch.zeros(4, 1), torch.ones(4, 1)
    >>> target = torch.tensor([[0.5], [0.5], [0.5], [1.5]])
    >>> metric.update(lower, upper, target, values=torch.tensor([1.0, 2.0, 3.0, 4.0]))
    >>> metric.compute().coverage.tolist()
    [[1.0], [0.5]]
    """

    full_state_update = False
    is_differentiable = False
    higher_is_better: bool | None = None
    edges: Tensor
    inside: Tensor
    counts: Tensor

    def __init__(self, num_outputs: int, edges: Tensor) -> None:
        """Make empty counts."""
        super().__init__()
        self.register_buffer("edges", check_edges(edges, num_outputs).clone(), persistent=False)
        zeros = torch.zeros(len(edges) + 1, num_outputs, dtype=torch.int64)
        self.add_state("inside", default=zeros, dist_reduce_fx="sum")
        self.add_state("counts", default=zeros.clone(), dist_reduce_fx="sum")

    def update(self, lower: Tensor, upper: Tensor, target: Tensor, values: Tensor) -> None:
        """Add (n, D) intervals, their targets and the (n,) or (n, D) values to bin by."""
        held = covered(lower, upper, target)
        _check_outputs(held, self.edges.shape[1])
        counts, inside = count_by_bin(held, check_binnable(held, values), self.edges)
        self.counts += counts
        self.inside += inside

    def compute(self) -> BinnedCoverage:
        """Edges, counts and coverage of all samples so far."""
        return BinnedCoverage(self.edges, self.counts, self.inside / self.counts)


class CoverageByQuantileBin(Metric):
    """Coverage in bins of equal size; see :func:`conditional.coverage_by_bin`.

    The edges are quantiles of all samples of all processes, so that the values are kept: two
    numbers per sample and output, the values in the metric's own type (``set_dtype``; float32).

    Args:
        num_outputs: D, the number of outputs.
        bins: G, at least 1.

    >>> metric = CoverageByQuantileBin(num_outputs=1, bins=2)
    >>> lower, upper = torch.zeros(4, 1), torch.ones(4, 1)
    >>> target = torch.tensor([[0.5], [0.5], [0.5], [1.5]])
    >>> metric.update(lower, upper, target, values=torch.tensor([1.0, 2.0, 3.0, 4.0]))
    >>> metric.compute().coverage.tolist()
    [[1.0], [0.5]]
    """

    full_state_update = False
    is_differentiable = False
    higher_is_better: bool | None = None
    inside: list[Tensor]
    values: list[Tensor]

    def __init__(self, num_outputs: int, bins: int) -> None:
        """Make empty lists."""
        super().__init__()
        if num_outputs < 1 or bins < 1:
            raise ValueError(f"num_outputs = {num_outputs}, bins = {bins}: expected at least 1.")
        self.num_outputs = num_outputs
        self.bins = bins
        self.add_state("inside", default=[], dist_reduce_fx="cat")
        self.add_state("values", default=[], dist_reduce_fx="cat")

    def update(self, lower: Tensor, upper: Tensor, target: Tensor, values: Tensor) -> None:
        """Add (n, D) intervals, their targets and the (n,) or (n, D) values to bin by."""
        held = covered(lower, upper, target)
        _check_outputs(held, self.num_outputs)
        values = check_binnable(held, values)
        # Flat and of one type: torchmetrics lets a process without samples send just that.
        self.inside.append(held.flatten().to(self.dtype))
        self.values.append(values.flatten().to(self.dtype))

    def compute(self) -> BinnedCoverage:
        """Edges, counts and coverage of all samples so far."""
        inside, values = (
            dim_zero_cat(state).reshape(-1, self.num_outputs)
            for state in (self.inside, self.values)
        )
        return coverage_by_bin(inside > 0, values, self.bins)


class WorstBinCoverage(CoverageByQuantileBin):
    """The lowest coverage of any quantile bin; see :func:`conditional.worst_bin_coverage`.

    Args:
        num_outputs: D, the number of outputs.
        bins: G, at least 1.

    >>> metric = WorstBinCoverage(num_outputs=1, bins=2)
    >>> lower, upper = torch.zeros(4, 1), torch.ones(4, 1)
    >>> target = torch.tensor([[0.5], [0.5], [0.5], [1.5]])
    >>> metric.update(lower, upper, target, values=torch.tensor([1.0, 2.0, 3.0, 4.0]))
    >>> metric.compute().item()
    0.5
    """

    higher_is_better = True

    def compute(self) -> Tensor:  # type: ignore[override]  # one number made of the bins
        """(D,) fraction in 0..1; torchmetrics makes D = 1 a scalar."""
        return worst_bin_coverage(super().compute())


def _check_outputs(held: Tensor, num_outputs: int) -> None:
    if held.ndim != 2 or held.shape[1] != num_outputs:
        raise ValueError(
            f"intervals of shape {tuple(held.shape)}; expected (n, {num_outputs}) as the metric "
            "was made for."
        )
