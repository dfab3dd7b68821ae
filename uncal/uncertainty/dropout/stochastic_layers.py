"""Dropout layers while MC dropout runs: their own forward, replaced by masks chosen by number."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import cast

import torch
from torch import Tensor, nn

from uncal.errors import UncertaintyError
from uncal.uncertainty.dropout.layers import rate_of
from uncal.uncertainty.dropout.masks import FixedMasks, layer_key, scaled_masks, stream_keys
from uncal.uncertainty.dropout.replicated import Replicated

_FEATUREWISE = (nn.Dropout1d, nn.Dropout2d, nn.Dropout3d)

Forward = Callable[..., object]


class StochasticLayers:
    """Masks the outputs of dropout layers by (seed, layer, pass, row).

    Layers whose arithmetic is known (``nn.Dropout``, ``nn.Dropout1d/2d/3d``, and any layer with the
    attribute ``elementwise_dropout = True``) get masks that do not depend on how the passes are
    batched. Others (``nn.AlphaDropout``, layers found by name) run their own forward in training
    mode with torch's random numbers.
    """

    def __init__(self, layers: Mapping[str, nn.Module], fixed: FixedMasks | None) -> None:
        self.fixed = fixed
        self.known = {name: layer for name, layer in layers.items() if _axes(layer) is not None}
        self.own = {name: layer for name, layer in layers.items() if name not in self.known}
        if fixed is not None and self.own:
            name, layer = next(iter(self.own.items()))
            raise UncertaintyError(
                f"{name} is a {type(layer).__name__}: fixed masks need layers that zero elements "
                "or channels (nn.Dropout, nn.Dropout1d, 2d or 3d)."
            )
        self.stops = False
        self.largest_row = 0
        self.unaligned: set[str] = set()
        self.reached: set[str] = set()
        self._passes, self._seeds = range(1), torch.zeros(1, dtype=torch.int64)
        self._calls: dict[str, int] = {}

    def begin(self, passes: range, seeds: Tensor) -> None:
        """Say what the next call holds: P passes, outermost, of B rows with (B,) seeds."""
        self._passes, self._seeds = passes, seeds
        self._calls.clear()

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Replace the layers' forward, and put it back on leaving."""
        with replaced_forwards({m: self._forward_of(n, m) for n, m in self.known.items()}):
            hooks = [layer.register_forward_pre_hook(self._stop) for layer in self.own.values()]
            try:
                yield
            finally:
                for hook in hooks:
                    hook.remove()

    def _stop(self, layer: nn.Module, args: object) -> None:
        if self.stops:
            raise FirstDropout

    def _forward_of(self, name: str, layer: nn.Module) -> Forward:
        p = rate_of(layer)

        def forward(x: Tensor, *_: object) -> Tensor:
            if self.stops:
                raise FirstDropout
            call = self._calls.get(name, 0)
            self._calls[name] = call + 1
            self.reached.add(name)
            return self._masked(name, call, layer, p, x)

        return forward

    def _masked(self, name: str, call: int, layer: nn.Module, p: float, x: Tensor) -> Tensor:
        n_passes, n_rows = len(self._passes), len(self._seeds)
        rows = n_passes * n_rows
        axis = batch_axis(x.shape, rows)
        if axis is None:
            self.unaligned.add(name)
            return self._masked_as_one(name, call, p, x)
        shared = isinstance(x, Replicated) and axis == 0
        source = x.source if isinstance(x, Replicated) and shared else x.transpose(0, axis)
        rest = source.shape[1:]
        fold = x.shape[axis] // rows
        axes = cast(int, _axes(layer)) or len(rest)
        size = fold * rest[:axes].numel()
        masks = self._masks(name, call, size, p).to(source.device, source.dtype)
        mask = masks.view(n_passes, -1, fold, *rest[:axes], *[1] * (len(rest) - axes))
        blocks = source.reshape(1 if shared else n_passes, n_rows, fold, *rest)
        out = (blocks * mask).reshape(rows * fold, *rest)
        self.largest_row = max(self.largest_row, out.nbytes // rows)
        return out.transpose(0, axis)

    def _masks(self, name: str, call: int, size: int, p: float) -> Tensor:
        """(P · B, size) fresh masks, or (P, size) fixed ones."""
        if self.fixed is not None:
            masks = self.fixed.of(name, call, self._passes.stop, size, p)
            return masks[self._passes.start :]
        keys = stream_keys(self._seeds, self._passes, layer_key(name, call))
        return scaled_masks(keys, size, p)

    def _masked_as_one(self, name: str, call: int, p: float, x: Tensor) -> Tensor:
        """A layer whose rows cannot be told apart still gets independent zeros."""
        if self.fixed is not None:
            raise UncertaintyError(
                f"{name} gets {tuple(x.shape)} in a batch of {len(self._passes)} passes of "
                f"{len(self._seeds)} rows: which elements belong to which row cannot be told, so "
                "fixed masks are not possible here. Put the batch first, or use fresh masks."
            )
        keys = stream_keys(self._seeds[:1], self._passes, layer_key(name, call))[:1]
        return x * scaled_masks(keys, x.numel(), p).view(x.shape).to(x.dtype)


class FirstDropout(BaseException):
    """Ends a run of the network at its first dropout layer.

    Not an error: no ``except Exception`` inside the network is meant to stop it.
    """


@contextmanager
def replaced_forwards(forwards: Mapping[nn.Module, Forward]) -> Iterator[None]:
    """Give modules another ``forward``, and their own back on leaving."""
    missing = object()
    before = {module: module.__dict__.get("forward", missing) for module in forwards}
    try:
        for module, forward in forwards.items():
            module.__dict__["forward"] = forward
        yield
    finally:
        for module, original in before.items():
            if original is missing:
                module.__dict__.pop("forward", None)
            else:
                module.__dict__["forward"] = original


def batch_axis(shape: Sequence[int], rows: int) -> int | None:
    """Which axis holds the batch: the first, the second, or the first folded with something.

    >>> batch_axis((6, 7), 6), batch_axis((5, 6, 8), 6), batch_axis((24, 7), 6), batch_axis((5,), 6)
    (0, 1, 0, None)
    """
    if len(shape) == 0:
        return None
    if shape[0] != rows and len(shape) > 1 and shape[1] == rows:
        return 1
    return 0 if shape[0] % rows == 0 else None


def _axes(layer: nn.Module) -> int | None:
    """Over how many axes behind the batch's a layer's mask varies; 0: all; None: not known."""
    if type(layer) is nn.Dropout or getattr(layer, "elementwise_dropout", False):
        return 0
    return 1 if type(layer) in _FEATUREWISE else None
