from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torchmetrics import MetricCollection

from uncal.metrics import MPIW, PICP, IntervalScore, interval_score, mpiw, picp


def _intervals(n: int = 50) -> tuple[Tensor, Tensor, Tensor]:
    lower = torch.randn(n, 6)
    return lower, lower + torch.rand(n, 6), torch.randn(n, 6)


def test_batches_accumulate_to_the_functions() -> None:
    lower, upper, target = _intervals()
    metrics: tuple[PICP | MPIW | IntervalScore, ...]
    metrics = (PICP(6), MPIW(6), IntervalScore(6, alpha=0.1))
    for part in (slice(0, 7), slice(7, 8), slice(8, 50)):
        for metric in metrics:
            metric.update(lower[part], upper[part], target[part])
    expected = (
        picp(lower, upper, target),
        mpiw(lower, upper),
        interval_score(lower, upper, target, 0.1),
    )
    for accumulated, value in zip(metrics, expected, strict=True):
        torch.testing.assert_close(accumulated.compute(), value)


def test_states_are_sums_over_processes() -> None:
    # What torchmetrics does under DDP: stack the states of the processes and reduce them.
    data, first, second = _intervals(), PICP(6), PICP(6)
    first.update(*(values[:20] for values in data))
    second.update(*(values[20:] for values in data))
    stacked = {name: reduce for name, reduce in first._reductions.items() if callable(reduce)}
    assert {name: reduce(torch.ones(2, 3)).tolist() for name, reduce in stacked.items()} == {
        "total": [2.0] * 3,
        "count": [2.0] * 3,
    }
    first.total += second.total
    first.count += second.count
    torch.testing.assert_close(first.compute(), picp(*data))


def test_infinite_intervals() -> None:
    bounds = torch.full((3, 6), -torch.inf), torch.full((3, 6), torch.inf)
    target = torch.zeros(3, 6)
    coverage, widths, scores = PICP(6), MPIW(6), IntervalScore(6, alpha=0.1)
    metrics: tuple[PICP | MPIW | IntervalScore, ...] = (coverage, widths, scores)
    for metric in metrics:
        metric.update(*bounds, target)
    assert coverage.compute().tolist() == [1.0] * 6
    assert widths.compute().tolist() == scores.compute().tolist() == [torch.inf] * 6


def test_reset_and_collection() -> None:
    data = _intervals()
    collection = MetricCollection({"picp": PICP(6), "is": IntervalScore(6, alpha=0.1)})
    collection.update(*data)
    collection.reset()
    collection.update(*(values[:5] for values in data))
    torch.testing.assert_close(collection.compute()["picp"], picp(*(v[:5] for v in data)))


def test_refusals() -> None:
    with pytest.raises(ValueError, match=r"expected \(n, 3\)"):
        PICP(3).update(*_intervals())
    with pytest.raises(ValueError, match="num_outputs = 0"):
        MPIW(0)
    with pytest.raises(ValueError, match="alpha = 10"):
        IntervalScore(6, alpha=10)
    with pytest.raises(ValueError, match="NaN"):
        MPIW(6).update(torch.full((1, 6), torch.nan), torch.ones(1, 6), torch.zeros(1, 6))
