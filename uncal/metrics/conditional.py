"""Coverage within bins of something else, such as σ or the size of the decalibration.

A guarantee over all samples allows a method to fail on the hard ones and make up for it on the
easy ones. Split by what makes samples hard, the coverage shows it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class BinnedCoverage(NamedTuple):
    """Coverage per bin and output.

    Attributes:
        edges: (G-1, D) inner edges; bin g holds edges[g-1] ≤ value < edges[g], the first bin all
            below its edge, the last all from its edge on.
        counts: (G, D) int64, samples per bin.
        hits: (G, D) int64, covered samples per bin.
    """

    edges: Tensor
    counts: Tensor
    hits: Tensor

    @property
    def coverage(self) -> Tensor:
        """(G, D) covered fraction in 0..1; NaN in an empty bin."""
        return self.hits / self.counts


def quantile_edges(values: Tensor, bins: int) -> Tensor:
    """Inner edges of bins that hold about as many samples each: the order statistics ⌊gn/G⌋.

    Equal values are never split, since an edge belongs to the upper bin: with ties, or fewer
    samples than bins, some bins are larger and some empty.

    Args:
        values: (n, D) what to split by.
        bins: G, at least 1.

    Returns:
        (G-1, D) edges, not decreasing.

    Raises:
        ValueError: no samples, NaN, another shape, or no bins.

    >>> quantile_edges(torch.arange(6.0)[:, None], bins=3).flatten().tolist()
    [2.0, 4.0]
    """
    if bins < 1:
        raise ValueError(f"bins = {bins}; expected at least 1, such as 3 for terciles.")
    _check_values(values)
    n = len(values)
    ranks = torch.tensor([g * n // bins for g in range(1, bins)], dtype=torch.int64)
    return values.sort(dim=0).values[ranks.to(values.device)]


def coverage_by_bin(covered: Tensor, values: Tensor, bins: int) -> BinnedCoverage:
    """Coverage of the samples in each quantile bin of a value, per output.

    Args:
        covered: (n, D) bool, :func:`uncal.metrics.functional.covered`.
        values: (n, D) what to split by, per output; or (n,), the same for all outputs.
        bins: the number G of bins, whose edges are :func:`quantile_edges` of the values.

    Raises:
        ValueError: other shapes or types, no samples, NaN, or no bins.

    >>> inside = torch.tensor([[True], [True], [True], [False]])
    >>> coverage_by_bin(inside, torch.tensor([1.0, 2.0, 3.0, 4.0]), bins=2).coverage.tolist()
    [[1.0], [0.5]]
    """
    if covered.ndim != 2 or covered.dtype != torch.bool:
        raise ValueError(
            f"covered of shape {tuple(covered.shape)} and type {covered.dtype}; expected (n, D) "
            "bool, such as functional.covered gives."
        )
    if values.ndim == 1 and len(values) == len(covered):
        values = values[:, None].expand(covered.shape)
    if values.shape != covered.shape:
        raise ValueError(
            f"values {tuple(values.shape)} for covered {tuple(covered.shape)}; expected one per "
            "sample, (n,), or one per sample and output, (n, D)."
        )
    edges = quantile_edges(values, bins)
    columns = (each.T.contiguous() for each in (edges, values))
    index = torch.searchsorted(*columns, right=True).T
    zeros = torch.zeros(len(edges) + 1, values.shape[1], dtype=torch.int64, device=values.device)
    counts = zeros.scatter_add(0, index, torch.ones_like(index))
    return BinnedCoverage(edges, counts, zeros.scatter_add(0, index, covered.to(torch.int64)))


def _check_values(values: Tensor) -> None:
    if values.ndim != 2 or values.numel() == 0:
        raise ValueError(
            f"values of shape {tuple(values.shape)}; expected (n, D) with at least one sample."
        )
    if n_nan := int(values.isnan().sum()):
        raise ValueError(
            f"{n_nan} of {values.numel()} values to bin by are NaN and belong to no bin; leave "
            "those samples out."
        )
