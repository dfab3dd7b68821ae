"""Dropout masks as a pure function of integers, the same on every device.

A mask is not drawn from a generator whose state depends on what was drawn before; it is a hash of
(seed, layer, pass, row). So a pass is the same whether it runs alone or in a batch of N, on one
process or on two, on a CPU or on a GPU. The hash is SplitMix64 (Steele, Lea, Flood, OOPSLA 2014)
run as a counter: word j of a stream with key s is mix(s + (j + 1) γ). Each 64-bit word serves four
elements, so that rates are exact to 1/65,536.
"""

from __future__ import annotations

import hashlib

import torch
from torch import Tensor, nn

from uncal.errors import UncertaintyError

_GAMMA = 0x9E3779B97F4A7C15 - (1 << 64)
_FIRST = 0xBF58476D1CE4E5B9 - (1 << 64)
_SECOND = 0x94D049BB133111EB - (1 << 64)
_LANES = 1 << 16


def mix(values: Tensor) -> Tensor:
    """SplitMix64's output function: int64 values, changed in place, whose neighbours it scatters.

    >>> [hex(v & (2**64 - 1)) for v in mix(torch.arange(1, 3) * _GAMMA).tolist()]
    ['0xe220a8397b1dcdaf', '0x6e789e6aa1b965f4']
    """
    # Shifts of int64 copy the sign bit, hence the masks.
    for shift, factor in ((30, _FIRST), (27, _SECOND)):
        values.bitwise_xor_((values >> shift).bitwise_and_((1 << (64 - shift)) - 1))
        values.mul_(factor)
    return values.bitwise_xor_((values >> 31).bitwise_and_((1 << 33) - 1))


def keep_masks(keys: Tensor, size: int, p: float) -> Tensor:
    """(R, size) float32 masks of (R,) int64 keys: 1 with probability 1-p, else 0.

    >>> masks = keep_masks(torch.arange(4), 100_000, p=0.25)
    >>> [round(m, 2) for m in masks.mean(1).tolist()]
    [0.75, 0.75, 0.75, 0.75]
    """
    words = (size + 3) // 4
    steps = torch.arange(1, words + 1, device=keys.device).mul_(_GAMMA)
    # Keys in a row would make streams that are shifted copies of each other.
    bits = mix(mix(keys.clone())[:, None] + steps)
    lanes = bits.view(torch.int16)[:, :size]
    kept = torch.empty(lanes.shape, device=keys.device)
    # Straight into floats: from bool it takes five times as long on a CPU.
    threshold = round(p * _LANES) - _LANES // 2
    return kept.zero_() if p == 1.0 else torch.ge(lanes, threshold, out=kept)


def scaled_masks(keys: Tensor, size: int, p: float) -> Tensor:
    """:func:`keep_masks` times 1/(1-p), so that the mean of a layer's output stays."""
    masks = keep_masks(keys, size, p)
    return masks if p == 1.0 else masks.mul_(1.0 / (1.0 - p))


def layer_key(name: str, call: int) -> int:
    """64-bit number of a layer's ``call``-th use within one pass.

    >>> layer_key("head.1", 0) != layer_key("head.1", 1)
    True
    """
    digest = hashlib.sha256(f"{name}|{call}".encode()).digest()
    return int.from_bytes(digest[:8], "little", signed=True)


def stream_keys(seeds: Tensor, passes: range, layer: int) -> Tensor:
    """(P · B,) int64 keys of the masks of P passes, outermost, of rows with (B,) int64 seeds."""
    numbers = torch.arange(passes.start, passes.stop, device=seeds.device)
    return mix(mix(seeds + layer) + numbers[:, None] * _GAMMA).flatten()


def row_seeds(seed: int, rows: int) -> Tensor:
    """(rows,) int64 seeds that differ from row to row and from seed to seed."""
    # Any integer will do, and torch takes 64 bits with a sign.
    start = (seed + (1 << 63)) % (1 << 64) - (1 << 63)
    return mix(mix(torch.tensor([start])) + torch.arange(rows))


class FixedMasks(nn.Module):
    """The N masks per layer of a predictor that is one deterministic function of its input.

    Every frame meets the same N masks: same frame, same interval, whatever the batch, the order or
    the machine's random state. As the masks are integer arithmetic of the seed, the seed is all
    that the checkpoint has to keep; they are worked out once per layer and held in memory.

    Args:
        seed: of the masks; a loaded state brings its own.

    >>> masks = FixedMasks(seed=3)
    >>> torch.equal(masks.of("dropout", 0, 25, 8, 0.5), FixedMasks(3).of("dropout", 0, 25, 8, 0.5))
    True
    """

    seed: Tensor

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.register_buffer("seed", row_seeds(seed, 1)[0])
        self._known: dict[tuple[str, int], tuple[float, Tensor]] = {}
        self._drawn_from: tuple[int, torch.device] | None = None

    def of(self, layer: str, call: int, passes: int, size: int, p: float) -> Tensor:
        """(N, size) float32 masks of one layer, scaled by 1/(1-p).

        Raises:
            UncertaintyError: the layer was met with another size before.
        """
        state = (int(self.seed), self.seed.device)
        if state != self._drawn_from:
            self._known.clear()
            self._drawn_from = state
        rate, known = self._known.get((layer, call), (p, None))
        if known is not None and known.shape[1] != size:
            raise UncertaintyError(
                f"fixed masks of {layer}: drawn for {known.shape[1]} elements a row, now {size}. "
                "A network with fixed masks takes inputs of one size; resize them, or use fresh "
                "masks (mcd.masks=random)."
            )
        if known is None or len(known) < passes or rate != p:
            keys = stream_keys(self.seed[None], range(passes), layer_key(layer, call))
            known = scaled_masks(keys, size, p)
            self._known[layer, call] = (p, known)
        return known[:passes]

    def digest(self) -> str:
        """16 hexadecimal digits that tell these masks from others."""
        return f"{int(self.seed) & (2**64 - 1):016x}"
