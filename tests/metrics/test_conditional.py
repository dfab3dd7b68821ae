from __future__ import annotations

import numpy as np
import pytest
import torch
from mapie.metrics.regression import (  # type: ignore[import-untyped]
    regression_ssc,
)

from uncal.metrics.conditional import (
    coverage_by_bin,
    quantile_edges,
)
from uncal.metrics.functional import covered, width


def test_by_hand() -> None:
    # Sorted by value: 1 2 | 3 4 | 5 6 in the first output, the reverse in the second.
    values = torch.tensor([[5.0, 2.0], [1.0, 6.0], [3.0, 4.0], [2.0, 5.0], [6.0, 1.0], [4.0, 3.0]])
    inside = torch.tensor([[1, 1], [1, 0], [0, 1], [1, 1], [0, 1], [0, 1]]).bool()
    binned = coverage_by_bin(inside, values, bins=3)
    assert binned.edges.tolist() == [[3.0, 3.0], [5.0, 5.0]]
    assert binned.counts.tolist() == [[2, 2]] * 3
    assert binned.coverage.tolist() == [[1.0, 1.0], [0.0, 1.0], [0.5, 0.5]]


def test_one_value_for_all_outputs() -> None:
    inside = torch.tensor([[True, False], [True, True], [False, True]])
    binned = coverage_by_bin(inside, torch.tensor([0.5, 1.0, 2.0]), bins=2)
    assert binned.edges.tolist() == [[1.0, 1.0]]  # the edge belongs to the upper bin
    assert binned.counts.tolist() == [[1, 1], [2, 2]]
    assert binned.coverage.tolist() == [[1.0, 0.0], [0.5, 1.0]]


@pytest.mark.parametrize("bins", [2, 3, 10])
def test_against_mapie(bins: int) -> None:
    rng = np.random.default_rng(0)
    target, lower = rng.normal(size=300), rng.normal(size=300) - 1
    upper = lower + rng.exponential(2.0, 300)
    low, high, truth = (torch.from_numpy(values)[:, None] for values in (lower, upper, target))
    binned = coverage_by_bin(covered(low, high, truth), width(low, high), bins)
    pairs = np.stack([lower, upper], axis=1)[:, :, None]
    expected = regression_ssc(target, pairs, num_bins=bins)[0]
    np.testing.assert_allclose(binned.coverage[:, 0].numpy(), expected, rtol=1e-6)


def test_ties_are_never_split() -> None:
    inside = torch.tensor([True, False, True, False])[:, None]
    constant = coverage_by_bin(inside, torch.full((4,), 7.0), bins=3)
    assert constant.counts.flatten().tolist() == [0, 0, 4]
    assert constant.coverage[:2].isnan().all()
    assert constant.coverage[2].item() == 0.5
    halves = coverage_by_bin(inside, torch.tensor([0.0, 0.0, 0.0, 1.0]), bins=2)
    assert halves.counts.flatten().tolist() == [0, 4]  # the median 0 opens the upper bin
    even = coverage_by_bin(inside, torch.tensor([0.0, 0.0, 1.0, 1.0]), bins=2)
    assert even.counts.flatten().tolist() == [2, 2]


def test_fewer_samples_than_bins() -> None:
    edges = quantile_edges(torch.tensor([[2.0], [1.0]]), bins=5)
    assert edges.flatten().tolist() == [1.0, 1.0, 2.0, 2.0]
    binned = coverage_by_bin(torch.tensor([[True], [False]]), torch.tensor([2.0, 1.0]), bins=5)
    assert binned.counts.flatten().tolist() == [0, 0, 1, 0, 1]


def test_infinite_values_have_a_bin() -> None:
    values = torch.tensor([1.0, torch.inf, 2.0, torch.inf])
    binned = coverage_by_bin(torch.ones(4, 1).bool(), values, bins=2)
    assert binned.edges.item() == torch.inf
    assert binned.counts.flatten().tolist() == [2, 2]


def test_single_bin_is_the_whole() -> None:
    inside = torch.rand(30, 6) < 0.7
    binned = coverage_by_bin(inside, torch.randn(30), bins=1)
    assert binned.edges.shape == (0, 6)
    torch.testing.assert_close(binned.coverage[0], inside.float().mean(0))


def test_refusals() -> None:
    inside, values = torch.ones(4, 2).bool(), torch.randn(4, 2)
    for bad, message in (
        ((inside.float(), values, 2), "expected \\(n, D\\) bool"),
        ((inside, values[:3], 2), "expected one per"),
        ((inside, values * torch.nan, 2), "8 of 8 values to bin by are NaN"),
        ((inside[:0], values[:0], 2), "at least one sample"),
        ((inside, values, 0), "bins = 0"),
    ):
        with pytest.raises(ValueError, match=message):
            coverage_by_bin(*bad)
