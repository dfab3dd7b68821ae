"""N passes after n of them with N - n more."""

import pytest
import torch
from torch import nn

from uncal.uncertainty.dropout.masks import FixedMasks
from uncal.uncertainty.dropout.mc_dropout import MCDropout

SEEDS = [3, 1, 4, 1]


def network(*layers: nn.Module) -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(3, 16), *layers, nn.Linear(16, 2)).eval()


def samples(engine: MCDropout, x: torch.Tensor) -> torch.Tensor:
    kept = engine(x, seed=SEEDS).samples
    assert kept is not None
    return kept


@pytest.mark.parametrize("strategy", ["shared", "batch", "loop"])
@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("known", [1, 3, 7])
def test_more_passes_are_those_that_all_at_once_would_have_been(
    strategy: str, fixed: bool, known: int
) -> None:
    subject, x = network(nn.Dropout(0.5), nn.ReLU()), torch.randn(4, 3)
    masks = FixedMasks(0) if fixed else None
    engine = MCDropout(subject, 8, 3, strategy=strategy, masks=masks, keep_samples=True)
    whole = samples(engine, x)
    extended = engine.extend(whole[:known], x, seed=SEEDS)
    assert extended.passes == 8
    assert extended.samples is not None
    torch.testing.assert_close(extended.samples, whole)
    torch.testing.assert_close(extended.std, whole.std(0, correction=0))
    # What is known is taken as it is, not run again.
    marked = engine.extend(whole[:known] + 100.0, x, seed=SEEDS).samples
    assert marked is not None
    torch.testing.assert_close(marked[:known], whole[:known] + 100.0)
    torch.testing.assert_close(marked[known:], whole[known:])


def test_layers_that_draw_for_themselves_are_run_anew() -> None:
    subject, x = network(nn.AlphaDropout(0.5)), torch.randn(4, 3)
    engine = MCDropout(subject, 8, keep_samples=True)
    whole = samples(engine, x)
    extended = engine.extend(whole[:3] + 100.0, x, seed=SEEDS).samples
    assert extended is not None
    torch.testing.assert_close(extended, whole)
    assert len({tuple(each.flatten().tolist()) for each in extended}) == 8
