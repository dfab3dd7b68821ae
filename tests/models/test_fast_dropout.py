import pytest
import torch
from torch import nn
from torch.nn.modules.dropout import _DropoutNd

from uncal.models.dropout import FastDropout, use_fast_dropout


@pytest.mark.parametrize("rate", [0.05, 0.25, 0.5, 0.9])
def test_rate_and_scale(rate: float) -> None:
    torch.manual_seed(0)
    n = 1_000_003
    dropped = FastDropout(rate)(torch.ones(n))
    kept = dropped != 0
    torch.testing.assert_close(dropped[kept], torch.full_like(dropped[kept], 1 / (1 - rate)))
    # Five standard deviations of a binomial count.
    assert abs(int(kept.sum()) - n * (1 - rate)) < 5 * (n * rate * (1 - rate)) ** 0.5


def test_neighbours_in_one_random_word_are_independent() -> None:
    torch.manual_seed(0)
    kept = (FastDropout(0.5)(torch.ones(400_000)) != 0).reshape(-1, 4).float()
    correlation = torch.corrcoef(kept.T) - torch.eye(4)
    assert correlation.abs().max() < 0.016  # 5 / sqrt(100,000)


def test_masks_repeat_with_the_seed() -> None:
    layer = FastDropout(0.3)
    torch.manual_seed(3)
    first = layer(torch.ones(4, 5, 7))
    torch.manual_seed(3)
    assert torch.equal(first, layer(torch.ones(4, 5, 7)))


def test_evaluation_and_rate_zero_change_nothing() -> None:
    x = torch.randn(10)
    assert FastDropout(0.5).eval()(x) is x
    assert FastDropout(0.0)(x) is x


def test_gradient_flows_through_what_was_kept() -> None:
    x = torch.ones(1000, requires_grad=True)
    y = FastDropout(0.25)(x)
    y.sum().backward()
    assert x.grad is not None
    assert torch.equal(x.grad, y.detach())


def test_only_plain_dropout_is_replaced() -> None:
    network = nn.Sequential(nn.Dropout(0.2), nn.Sequential(nn.Dropout2d(0.3), nn.Dropout(0.0)))
    use_fast_dropout(network)
    kinds = [type(m) for m in network.modules() if isinstance(m, _DropoutNd)]
    assert kinds == [FastDropout, nn.Dropout2d, FastDropout]
