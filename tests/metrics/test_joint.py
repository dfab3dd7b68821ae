from __future__ import annotations

import pytest
import torch

from uncal.metrics.functional import picp
from uncal.metrics.joint import (
    jointly_covered,
    log_volume,
    mean_log_volume,
    relative_size,
)

INF = torch.inf


def test_by_hand() -> None:
    # Boxes of 2 x 8 and 4 x 0.25; the first holds its target, the second misses in the second
    # output, the third at an edge holds.
    lower = torch.tensor([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    upper = torch.tensor([[2.0, 8.0], [5.0, 1.25], [1.0, 1.0]])
    target = torch.tensor([[1.0, 7.0], [2.0, 2.0], [1.0, 0.0]])
    assert jointly_covered(lower, upper, target).tolist() == [True, False, True]
    volumes = log_volume(lower, upper).exp()
    torch.testing.assert_close(volumes, torch.tensor([16.0, 1.0, 1.0]))
    assert mean_log_volume(lower, upper).exp().item() == pytest.approx(16 ** (1 / 3))


def test_the_box_holds_at_most_as_often_as_any_side() -> None:
    lower, target = torch.randn(200, 6), torch.randn(200, 6)
    upper = lower + 3 * torch.rand(200, 6)
    joint = jointly_covered(lower, upper, target).float().mean()
    assert joint <= picp(lower, upper, target).min()


def test_relative_size_is_free_of_units() -> None:
    zeros, a, b = torch.zeros(50, 3), 1 + torch.rand(50, 3), 1 + torch.rand(50, 3)
    units = torch.tensor([100.0, 1e-3, 57.3])
    plain = relative_size(zeros, a, zeros, b)
    torch.testing.assert_close(relative_size(zeros, a * units, zeros, b * units), plain)
    torch.testing.assert_close(plain, (a / b).log().mean().exp())
    torch.testing.assert_close(relative_size(zeros, b, zeros, a), 1 / plain)
    assert relative_size(zeros, 2 * a, zeros, a).item() == pytest.approx(2)


def test_infinite_and_empty_volumes() -> None:
    zeros, ones = torch.zeros(2, 2), torch.ones(2, 2)
    infinite = torch.tensor([[INF, 1.0], [1.0, 1.0]])
    flat = torch.tensor([[1.0, 1.0], [0.0, 1.0]])
    both = torch.tensor([[INF, 0.0], [1.0, 1.0]])
    assert log_volume(zeros, infinite).tolist() == [INF, 0.0]
    assert log_volume(zeros, flat).tolist() == [0.0, -INF]
    assert log_volume(zeros, both).tolist() == [INF, 0.0]
    mixed = torch.tensor([[INF, 1.0], [0.0, 1.0]])
    for unbounded in (infinite, both, mixed):
        assert mean_log_volume(zeros, unbounded).item() == INF
    assert mean_log_volume(zeros, flat).item() == -INF
    assert relative_size(zeros, infinite, zeros, ones).item() == INF
    assert relative_size(zeros, ones, zeros, infinite).item() == 0.0
    assert relative_size(zeros, infinite, zeros, infinite).isnan()
    assert jointly_covered(-infinite, infinite, zeros).all()
    assert jointly_covered(-infinite, infinite, torch.full((2, 2), 3.0)).tolist() == [False] * 2


def test_refusals() -> None:
    row = torch.zeros(3)
    for function in (log_volume, mean_log_volume):
        with pytest.raises(ValueError, match=r"boxes are \(n, D\)"):
            function(row, row + 1)
    with pytest.raises(ValueError, match=r"boxes are \(n, D\)"):
        jointly_covered(row, row + 1, row)
    with pytest.raises(ValueError, match="1 of 6 values of upper are NaN"):
        log_volume(torch.zeros(3, 2), torch.tensor([[torch.nan, 1.0]] + [[1.0, 1.0]] * 2))
    with pytest.raises(ValueError, match=r"\(3, 2\) and \(2, 2\)"):
        relative_size(*[torch.zeros(3, 2)] * 2, *[torch.zeros(2, 2)] * 2)
