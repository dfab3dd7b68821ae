"""Self-attention of `transformers`' MobileViT through torch's fused kernel."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from transformers.models.mobilevit.modeling_mobilevit import MobileViTSelfAttention


class FusedSelfAttention(nn.Module):
    """The numbers of ``MobileViTSelfAttention`` without storing its maps of tokens × tokens.

    At 192×640 those maps outrun the caches of a CPU. Names and shapes of the weights stay.

    Args:
        attention: the module to take over; without dropout on the attention maps.

    >>> from transformers import MobileViTConfig
    >>> slow = MobileViTSelfAttention(MobileViTConfig(), hidden_size=8).eval()
    >>> x = torch.randn(2, 5, 8)
    >>> torch.allclose(slow(x), FusedSelfAttention(slow)(x), atol=1e-6)
    True
    """

    def __init__(self, attention: MobileViTSelfAttention) -> None:
        super().__init__()
        self.heads = attention.num_attention_heads
        self.query: nn.Linear = attention.query
        self.key: nn.Linear = attention.key
        self.value: nn.Linear = attention.value

    def forward(self, hidden_states: Tensor) -> Tensor:
        """Attend.

        Args:
            hidden_states: (B, T, C) tokens.

        Returns:
            (B, T, C).
        """
        batch, tokens, channels = hidden_states.shape
        layers = (self.query, self.key, self.value)
        weight = torch.cat(tuple(layer.weight for layer in layers))
        biases = tuple(layer.bias for layer in layers if layer.bias is not None)
        projected = F.linear(hidden_states, weight, torch.cat(biases) if biases else None)
        split = projected.view(batch, tokens, 3, self.heads, channels // self.heads)
        q, k, v = split.permute(2, 0, 3, 1, 4)
        attended = F.scaled_dot_product_attention(q, k, v)
        return attended.transpose(1, 2).reshape(batch, tokens, channels)


def use_fused_attention(network: nn.Module) -> nn.Module:
    """Replace every MobileViT self-attention without dropout on its maps, in place.

    Args:
        network: any module.

    Returns:
        The same module.
    """
    for parent in network.modules():
        for name, child in parent.named_children():
            if isinstance(child, MobileViTSelfAttention) and child.dropout.p == 0.0:
                setattr(parent, name, FusedSelfAttention(child))
    return network
