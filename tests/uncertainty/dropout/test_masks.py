from __future__ import annotations

import pytest
import torch
from scipy import stats  # type: ignore[import-untyped]

from uncal.uncertainty.dropout.masks import (
    FixedMasks,
    keep_masks,
    layer_key,
    row_seeds,
    scaled_masks,
    stream_keys,
)


def test_golden_bits() -> None:
    """A predictor with fixed masks must stay the same function on every machine and version."""
    kept = keep_masks(torch.tensor([0, 1]), 16, p=0.5)
    rows = ["".join(str(int(v)) for v in row) for row in kept.tolist()]
    assert rows == GOLDEN
    assert FixedMasks(0).digest() == DIGEST


def test_bits_are_splitmix64_in_plain_integers() -> None:
    def mix(z: int) -> int:
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) % 2**64
        return z ^ (z >> 31)

    key, p = 12345, 0.3
    kept = keep_masks(torch.tensor([key]), 10, p)[0].tolist()
    for element, value in enumerate(kept):
        word = mix((mix(key) + (element // 4 + 1) * 0x9E3779B97F4A7C15) % 2**64)
        lane = (word >> (16 * (element % 4))) & 0xFFFF
        signed = lane - 2**16 if lane >= 2**15 else lane
        assert value == float(signed >= round(p * 2**16) - 2**15)


GOLDEN = ["0100100110110100", "0000001100110100"]
DIGEST = "0000000000000000"


@pytest.mark.parametrize("p", [0.05, 0.25, 0.5, 0.9])
def test_rates_are_exact_and_elements_independent(p: float) -> None:
    n_masks, size = 400, 1000
    kept = keep_masks(stream_keys(row_seeds(0, 20), range(20), layer_key("a", 0)), size, p)
    assert set(kept.flatten().tolist()) == {0.0, 1.0}
    total = int(kept.sum())
    assert stats.binomtest(total, n_masks * size, 1 - p).pvalue > 1e-3
    # Counts per mask and per element are binomial too, if nothing hangs together.
    for counts, n in ((kept.sum(1), size), (kept.sum(0), n_masks)):
        z = (counts - n * (1 - p)) / (n * p * (1 - p)) ** 0.5
        chi2 = float(z.square().sum())
        assert 1e-3 < stats.chi2.cdf(chi2, len(z)) < 1 - 1e-3


def test_neighbouring_masks_do_not_hang_together() -> None:
    keys = stream_keys(row_seeds(7, 2), range(50), layer_key("layer", 0))
    keys = torch.cat([keys, stream_keys(row_seeds(8, 2), range(50), layer_key("layer", 1))])
    centred = keep_masks(keys, 4000, 0.5) - 0.5
    correlation = centred @ centred.T / (0.25 * 4000)
    off = correlation[~torch.eye(len(keys), dtype=torch.bool)]
    # 39,800 values with standard deviation 1/√4000: the largest is below 5 of them.
    assert off.abs().max() < 5 / 4000**0.5
    shifted = (centred[:, 1:] * centred[:, :-1]).mean(1) / 0.25
    assert shifted.abs().max() < 5 / 4000**0.5


def test_a_pass_has_the_same_mask_in_any_company() -> None:
    seeds, layer = row_seeds(3, 4), layer_key("x", 0)
    whole = stream_keys(seeds, range(6), layer).view(6, 4)
    assert torch.equal(stream_keys(seeds[2:3], range(4, 5), layer), whole[4, 2:3])
    assert len(set(whole.flatten().tolist())) == 24


def test_scale_and_extreme_rates() -> None:
    assert set(scaled_masks(torch.arange(3), 50, 0.75).flatten().tolist()) == {0.0, 4.0}
    assert (scaled_masks(torch.arange(3), 50, 1.0) == 0).all()


def test_fixed_masks_travel_in_a_state() -> None:
    masks, other = FixedMasks(1), FixedMasks(2)
    before = other.of("a", 0, 4, 100, 0.5)
    other.load_state_dict(masks.state_dict())
    assert torch.equal(other.of("a", 0, 4, 100, 0.5), masks.of("a", 0, 4, 100, 0.5))
    assert not torch.equal(before, other.of("a", 0, 4, 100, 0.5))
    assert masks.digest() == other.digest() != FixedMasks(2).digest()


def test_more_passes_keep_the_first_masks() -> None:
    masks = FixedMasks(1)
    few = masks.of("a", 0, 4, 100, 0.5).clone()
    assert torch.equal(masks.of("a", 0, 9, 100, 0.5)[:4], few)
    assert not torch.equal(masks.of("a", 1, 4, 100, 0.5), few)
    assert set(masks.of("a", 0, 4, 100, 0.2).flatten().tolist()) == {0.0, 1.25}
