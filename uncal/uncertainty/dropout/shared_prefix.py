"""What lies before the first dropout of a network, run once for all passes.

The network runs up to its first active dropout layer while the outputs of all modules without
dropout inside are kept; in the passes those modules answer with what they returned. No graph is
traced, so any Python in ``forward`` will do. Operations between the modules (a residual sum, a
reshape) are done again per pass; that is the price, small where the work is in modules.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Set
from contextlib import AbstractContextManager
from typing import NamedTuple

import torch
from lightning_utilities.core.apply_func import apply_to_collection
from torch import Tensor, nn

from uncal.uncertainty.dropout.replicated import Replicated, is_mappable, iterate_tensors
from uncal.uncertainty.dropout.stochastic_layers import (
    FirstDropout,
    Forward,
    batch_axis,
    replaced_forwards,
)


class DivergedError(Exception):
    """The network took another way than when its prefix was recorded."""


class _Known(NamedTuple):
    module: nn.Module
    output: object


def _source(tensor: Tensor) -> Tensor:
    return tensor.source if isinstance(tensor, Replicated) else tensor


def without(network: nn.Module, stochastic: Set[nn.Module]) -> list[nn.Module]:
    """Modules that have none of some modules inside and are not one of them."""
    pure: dict[nn.Module, bool] = {}

    def look(module: nn.Module) -> bool:
        if module not in pure:
            children = (child for child in module._modules.values() if child is not None)
            inside = [look(child) for child in children]
            pure[module] = all(inside) and module not in stochastic
        return pure[module]

    look(network)
    return [m for m, own in pure.items() if own and not isinstance(m, torch.jit.ScriptModule)]


class SharedPrefix:
    """Remembers outputs of the modules that run before the first dropout."""

    def __init__(self, network: nn.Module, active: Iterable[nn.Module]) -> None:
        self._pure = without(network, set(active))
        self._log: list[_Known] = []
        self._recording = self._replaying = False
        self._position = self._depth = self._times = self._rows = 0

    def installed(self) -> AbstractContextManager[None]:
        """Replace the modules' forward, and put it back on leaving."""
        return replaced_forwards({module: self._forward_of(module) for module in self._pure})

    def record(self, run: Callable[[], object], rows: int) -> None:
        """Call the network, of B rows, until a dropout layer ends it by :class:`FirstDropout`."""
        self._log.clear()
        self._recording, self._rows, self._depth = True, rows, 0
        try:
            run()
        except FirstDropout:
            pass
        finally:
            self._recording = False

    def replay(self, run: Callable[[], object], times: int) -> object:
        """What ``run``, which calls the network, returns with what is known put in, replicated.

        Raises:
            DivergedError: the modules are not called in the order in which they were recorded.
        """
        self._replaying, self._times = True, times
        self._position = self._depth = 0
        try:
            return run()
        finally:
            self._replaying = False

    def clear(self) -> None:
        """Let go of the remembered tensors."""
        self._log.clear()

    def _forward_of(self, module: nn.Module) -> Forward:
        original = module.forward

        def forward(*args: object, **kwargs: object) -> object:
            if self._depth == 0 and self._replaying and self._position < len(self._log):
                known = self._log[self._position]
                if known.module is not module:
                    raise DivergedError(type(module).__name__)
                self._position += 1
                if is_mappable(known.output):
                    return apply_to_collection(known.output, Tensor, self._replicate)
            elif self._replaying and self._position == len(self._log):
                tensors = list(iterate_tensors((args, kwargs)))
                if tensors and all(isinstance(tensor, Replicated) for tensor in tensors):
                    # Behind the first dropout, but on a branch of its own that none has reached.
                    args, kwargs = apply_to_collection((args, kwargs), Tensor, _source)
                    output = original(*args, **kwargs)
                    return apply_to_collection(output, Tensor, self._replicate)
            self._depth += 1
            try:
                output = original(*args, **kwargs)
            finally:
                self._depth -= 1
            if self._recording and self._depth == 0:
                self._log.append(_Known(module, output))
            return output

        return forward

    def _replicate(self, value: Tensor) -> Tensor:
        """Repeat along the batch, wherever it is; keep what has none."""
        axis = batch_axis(value.shape, self._rows)
        return value if axis is None else Replicated(value, self._times, axis)
