"""Recognise the predictor that a calibrator was fitted with.

Scores are valid for one predictor only: these weights, this number of passes, these dropout rates,
and these masks where they are fixed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from uncal.uncertainty.dropout.layers import dropout_rates


def fingerprint(network: nn.Module) -> str:
    """SHA-256 over the names, types, shapes and bytes of a network's parameters and buffers.

    The same on every device and in every memory format, and for a network and its
    ``torch.compile`` d self. Another number type is another network: its outputs differ.
    Entries of the state that are no tensors (``get_extra_state``) do not count.

    Args:
        network: the network alone, without the calibrator that the fingerprint is for.

    Returns:
        64 hexadecimal digits.

    >>> layer = nn.Linear(2, 1)
    >>> before = fingerprint(layer)
    >>> before == fingerprint(layer)
    True
    >>> _ = nn.init.zeros_(layer.bias)
    >>> before == fingerprint(layer)
    False
    """
    digest = hashlib.sha256()
    for name, value in network.state_dict().items():
        if not isinstance(value, Tensor):
            continue
        label = f"{name.replace('_orig_mod.', '')} {value.dtype} {tuple(value.shape)}\n"
        digest.update(label.encode())
        # Through bytes, since numpy knows no bfloat16.
        raw = value.detach().cpu().contiguous().reshape(-1).view(torch.uint8)
        digest.update(raw.numpy().tobytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class PredictorIdentity:
    """All that makes two MC-dropout predictors the same function in distribution.

    Attributes:
        weights: :func:`fingerprint` of the network.
        passes: number of stochastic passes N.
        rates: p of every dropout layer that is switched on, in module order.
        masks: hexadecimal digest of the dropout masks if they are fixed; "" if every pass draws
            fresh random ones.
    """

    weights: str
    passes: int
    rates: tuple[float, ...]
    masks: str = ""

    @classmethod
    def of(
        cls,
        network: nn.Module,
        passes: int,
        rates: Mapping[str, float] | None = None,
        masks: str = "",
    ) -> PredictorIdentity:
        """Describe a network asked with N passes and these dropout layers on; None: all.

        >>> PredictorIdentity.of(nn.Sequential(nn.Linear(1, 1), nn.Dropout(0.25)), 25).rates
        (0.25,)
        """
        active = dropout_rates(network) if rates is None else rates
        return cls(fingerprint(network), passes, tuple(active.values()), masks)

    def differences(self, other: PredictorIdentity) -> list[str]:
        """What keeps another predictor, "now", from being this one, in words; empty if nothing.

        >>> PredictorIdentity("ab", 25, (0.1,)).differences(PredictorIdentity("ab", 5, (0.1,)))
        ['passes: 25 then, 5 now']
        """
        found = []
        if self.weights != other.weights:
            found.append(
                f"weights: fingerprint {self.weights[:12]}… then, {other.weights[:12]}… now"
            )
        if self.passes != other.passes:
            found.append(f"passes: {self.passes} then, {other.passes} now")
        if len(self.rates) != len(other.rates):
            found.append(f"dropout layers: {len(self.rates)} then, {len(other.rates)} now")
        elif self.rates != other.rates:
            changed = [(a, b) for a, b in zip(self.rates, other.rates, strict=True) if a != b]
            before, now = changed[0]
            found.append(
                f"dropout rates: {len(changed)} of {len(self.rates)} changed, "
                f"the first from {before:g} to {now:g}"
            )
        if self.masks != other.masks:
            found.append(f"masks: {_mask_words(self.masks)} then, {_mask_words(other.masks)} now")
        return found


def _mask_words(masks: str) -> str:
    return f"fixed ({masks[:12]}…)" if masks else "random"
