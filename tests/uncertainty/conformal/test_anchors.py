from __future__ import annotations

import torch

from uncal.uncertainty.conformal.intervals import Anchors


def test_scores_by_hand() -> None:
    anchors = Anchors(torch.tensor([0.0]), torch.tensor([4.0]), torch.tensor([2.0]))
    for target, score in ((-3.0, 1.5), (0.0, 0.0), (1.0, -0.5), (2.0, -1.0), (5.0, 0.5)):
        assert anchors.scores(torch.tensor([target])).item() == score


def test_the_score_is_the_widening_at_which_a_target_is_held() -> None:
    generator = torch.Generator().manual_seed(0)
    lower = torch.randn(500, generator=generator, dtype=torch.float64)
    upper = lower + torch.rand(500, generator=generator, dtype=torch.float64)
    unit = torch.rand(500, generator=generator, dtype=torch.float64) + 0.1
    anchors = Anchors(lower, upper, unit)
    target = 2 * torch.randn(500, generator=generator, dtype=torch.float64)
    score = anchors.scores(target)
    low, high = anchors.widened(score + 1e-9)
    assert ((low <= target) & (target <= high)).all()
    low, high = anchors.widened(score - 1e-9)
    # Not where the interval has shrunk to its midpoint, which may be the target itself.
    assert ((target < low) | (target > high)).all()


def test_crossed_bounds_become_their_midpoint() -> None:
    anchors = Anchors(torch.tensor([0.0, 0.0]), torch.tensor([1.0, 4.0]), torch.ones(2))
    lower, upper = anchors.widened(torch.tensor(-1.0))
    assert lower.tolist() == [0.5, 1.0]
    assert upper.tolist() == [0.5, 3.0]


def test_infinite_widening() -> None:
    lower, upper = Anchors(torch.zeros(1), torch.zeros(1), torch.ones(1)).widened(
        torch.tensor([torch.inf])
    )
    assert (lower.item(), upper.item()) == (-torch.inf, torch.inf)
