"""Find a network's dropout layers and switch on exactly those.

Layers are found by type: every subclass of torch's dropout base class, anywhere in the network.
Dropout without a module of its own cannot be found that way and stays off: ``F.dropout(x,
training=self.training)``, the ``dropout_p`` of ``scaled_dot_product_attention``, the ``dropout``
argument of ``nn.MultiheadAttention`` and of ``nn.LSTM``. Such a network needs an ``nn.Dropout``
module in the place of the functional call.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import nn
from torch.nn.modules.dropout import _DropoutNd


def dropout_layers(network: nn.Module) -> dict[str, _DropoutNd]:
    """Every dropout layer of a network, active (p > 0) or not, by its name, in module order.

    >>> list(dropout_layers(nn.Sequential(nn.Linear(2, 2), nn.Dropout2d(0.1))))
    ['1']
    """
    return {
        name: module for name, module in network.named_modules() if isinstance(module, _DropoutNd)
    }


def dropout_rates(network: nn.Module) -> dict[str, float]:
    """The probability p of every dropout layer by the layer's name, in module order.

    >>> dropout_rates(nn.Sequential(nn.Dropout(0.25), nn.Linear(2, 2), nn.Dropout(0.05)))
    {'0': 0.25, '2': 0.05}
    """
    return {name: float(layer.p) for name, layer in dropout_layers(network).items()}


@contextmanager
def only_dropout_active(network: nn.Module) -> Iterator[None]:
    """Dropout layers in training mode, all else (BatchNorm above all) in evaluation mode.

    Every module's own training flag is put back on leaving, after an exception too. Torch's fused
    inference path for transformer layers looks at the layer's flag only, and so would skip the
    dropout layers inside; it is switched off meanwhile.

    Args:
        network: any network; its flags are changed in place and restored.
    """
    flags = [(module, module.training) for module in network.modules()]
    fastpath = torch.backends.mha.get_fastpath_enabled()
    try:
        torch.backends.mha.set_fastpath_enabled(False)
        network.eval()
        for layer in dropout_layers(network).values():
            layer.train()
        yield
    finally:
        torch.backends.mha.set_fastpath_enabled(fastpath)
        for module, training in flags:
            module.training = training
