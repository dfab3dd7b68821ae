"""Where in a network dropout is switched on."""

from __future__ import annotations

from torch import nn
from transformers.models.mobilevit.modeling_mobilevit import MobileViTLayer

from uncal.uncertainty.dropout.layers import dropout_layers

ORDINALS = ("first", "second", "third", "fourth", "fifth")


def placements(network: nn.Module) -> dict[str, list[str]]:
    """Dropout layers from each transformer stage on, and in the head only.

    Returns:
        A description → names of the layers, for ``MCDropout(select=…)``; the earliest cut first.
    """
    names = list(dropout_layers(network))
    stages = [
        name for name, module in network.named_modules() if isinstance(module, MobileViTLayer)
    ]
    if not stages:
        return {"all layers": names}
    found: dict[str, list[str]] = {}
    for number, stage in enumerate(stages):
        first = next(i for i, name in enumerate(names) if name.startswith(f"{stage}."))
        last = number == len(stages) - 1
        found[f"from the {'last' if last else ORDINALS[number]} stage on"] = names[first:]
    inside = tuple(f"{stage}." for stage in stages)
    if behind := [name for name in names if not name.startswith(inside)]:
        found["head only"] = behind
    return found
