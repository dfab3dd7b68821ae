"""Running stochastic passes: which rows go through the network together, and what is shared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass

import torch
from lightning_utilities.core.apply_func import apply_to_collection
from torch import Tensor, nn

from uncal.errors import UncertaintyError
from uncal.uncertainty.dropout.masks import FixedMasks
from uncal.uncertainty.dropout.replicated import Replicated, iterate_tensors
from uncal.uncertainty.dropout.shared_prefix import DivergedError, SharedPrefix
from uncal.uncertainty.dropout.stochastic_layers import StochasticLayers

CACHE_BYTES = 1 << 22
"""What the output of the largest dropout layer may take in one call on a CPU."""

GPU_SHARE = 64
"""One of so many parts of a GPU's memory is what it may take there."""


@dataclass(frozen=True)
class Arguments:
    """What the network is called with."""

    args: tuple[object, ...]
    kwargs: Mapping[str, object]
    batch: int  # B, the first dimension of the first tensor
    device: torch.device  # of that tensor

    @classmethod
    def of(cls, args: tuple[object, ...], kwargs: Mapping[str, object]) -> Arguments:
        """Find the batch, or say that there is no tensor, or one without rows."""
        first = next(iterate_tensors((args, dict(kwargs))), None)
        if first is None or len(first) == 0:
            shape = "no tensor" if first is None else f"a tensor of shape {tuple(first.shape)}"
            raise UncertaintyError(
                f"the network's arguments start with {shape}; expected a batch (B, ...), B ≥ 1."
            )
        return cls(args, dict(kwargs), len(first), first.device)

    def map(self, function: Callable[[Tensor], Tensor], batch: int) -> Arguments:
        """Apply a function to every tensor that has the batch in front."""

        def apply(value: Tensor) -> Tensor:
            return function(value) if value.ndim > 0 and len(value) == self.batch else value

        args, kwargs = apply_to_collection((self.args, dict(self.kwargs)), Tensor, apply)
        return Arguments(args, kwargs, batch, self.device)

    def rows(self, which: slice | list[int]) -> Arguments:
        """Some rows of the batch."""
        if which == slice(0, self.batch):
            return self
        index = list(range(self.batch))[which] if isinstance(which, slice) else which
        return self.map(lambda value: value[which], len(index))

    def signature(self) -> tuple[object, ...]:
        """Shapes and types, batch size apart from whether it is one, and autocast's type."""
        device = self.device.type
        autocast = torch.is_autocast_enabled(device) and torch.get_autocast_dtype(device)
        tensors = iterate_tensors((self.args, dict(self.kwargs)))
        shapes = (
            (tuple(t.shape[1:]) if len(t) == self.batch else tuple(t.shape), t.dtype)
            for t in tensors
        )
        return (self.device, self.batch == 1, autocast, *shapes)


class Passes:
    """The network with its dropout layers under control; a context manager."""

    def __init__(
        self,
        network: nn.Module,
        active: Mapping[str, nn.Module],  # its active dropout layers by name
        masks: FixedMasks | None,  # fixed ones
        seeds: Tensor,  # (B,) of the rows
    ) -> None:
        self.network = network
        self.layers = StochasticLayers(active, masks)
        self.prefix = SharedPrefix(network, active.values())
        self.seeds = seeds
        self._stack = ExitStack()

    def __enter__(self) -> Passes:
        """Take over the modules' forward."""
        with ExitStack() as stack:
            if self.layers.own:
                self._seed_global(stack)
            stack.enter_context(self.prefix.installed())
            stack.enter_context(self.layers.installed())
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        """Give it back."""
        self.prefix.clear()
        self._stack.close()

    def _seed_global(self, stack: ExitStack) -> None:
        """For layers that draw by themselves; what was there comes back when the stack closes."""
        device, seed = self.seeds.device, int(self.seeds.sum())
        stack.enter_context(torch.random.fork_rng(devices=[device] if self.seeds.is_cuda else []))
        # torch.manual_seed would seed every GPU, and only this one is put back.
        torch.default_generator.manual_seed(seed)
        if self.seeds.is_cuda:
            stack.enter_context(torch.cuda.device(device))
            torch.cuda.manual_seed(seed)

    def sample(
        self, strategy: str, chunk: int, passes: range, arguments: Arguments, first: int = 0
    ) -> Tensor:
        """(P, B, D) of P passes, float32 or better, with at most ``chunk`` rows in one call.

        ``first``: which of the seeds belongs to the first row.
        """
        size = min(arguments.batch, chunk)
        parts = []
        for start in range(0, arguments.batch, size):
            stop = min(start + size, arguments.batch)
            part = arguments.rows(slice(start, stop))
            seeds = self.seeds[first + start : first + stop]
            group = 1 if strategy == "loop" else max(1, chunk // part.batch)
            parts.append(self._sample_part(strategy == "shared", group, passes, part, seeds))
        return torch.cat(parts, dim=1)

    def disagreement(self, strategy: str, arguments: Arguments) -> str | None:
        """Compare a strategy with single rows, looped: the first and the last of the inputs.

        Returns:
            None if the samples are the same up to rounding, else what is wrong. Where they cannot
            be compared (layers that draw their own random numbers), sharing is ruled out and
            anything else accepted.
        """
        if self.layers.own:
            return "some layers draw random numbers of their own" if strategy == "shared" else None
        if strategy == "loop" and (arguments.batch == 1 or self.layers.fixed is None):
            return None
        if strategy == "loop" and not self.layers.reached:
            self.sample("loop", 1, range(1), arguments.rows(slice(0, 1)))
        last = arguments.batch - 1
        pair = arguments.rows([0, last]) if last else arguments
        seeds, self.seeds = self.seeds, self.seeds[[0, last] if last else [0]]
        passes = range(2)
        try:
            tried = self.sample(strategy, 2 * pair.batch, passes, pair)[:, -1]
            alone = pair.rows([pair.batch - 1])
            single = self.sample("loop", 1, passes, alone, first=pair.batch - 1)[:, 0]
        except (DivergedError, RuntimeError) as error:
            return f"{type(error).__name__}: {error}"
        finally:
            self.seeds = seeds
        if self.layers.unaligned and strategy != "shared":
            return None
        scale = single.abs().max().item()
        worst = (tried - single).abs().max().item()
        tolerance = 1e-3 if tried.dtype in (torch.float32, torch.float64) else 5e-2
        if torch.is_autocast_enabled(self.seeds.device.type):
            tolerance = 5e-2
        if worst <= tolerance * scale:
            return None
        return f"samples differ by {worst:.2g} from single rows, of {scale:.2g}"

    def auto_chunk(self) -> int | None:
        """Rows per call by the size of the largest dropout layer; None before any was met."""
        largest = self.layers.largest_row
        if largest == 0:
            return None
        budget = CACHE_BYTES
        if self.seeds.is_cuda:
            budget = torch.cuda.get_device_properties(self.seeds.device).total_memory // GPU_SHARE
        return max(1, budget // largest)

    def _sample_part(
        self, share: bool, group: int, passes: range, part: Arguments, seeds: Tensor
    ) -> Tensor:
        if share:
            self.layers.stops = True
            try:
                self.prefix.record(lambda: self._call(part), part.batch)
            finally:
                self.layers.stops = False
        runs = []
        for start in range(passes.start, passes.stop, group):
            some = range(start, min(start + group, passes.stop))
            runs.append(self._run(share, some, part, seeds))
        return torch.cat(runs)

    def _run(self, share: bool, passes: range, part: Arguments, seeds: Tensor) -> Tensor:
        """(P, B, D): one call of the network."""
        times, rows = len(passes), len(passes) * part.batch
        self.layers.begin(passes, seeds)
        if share:
            many = part.map(lambda value: Replicated(value, times), rows)
            output = self.prefix.replay(lambda: self._call(many), times)
        elif times > 1:
            # cat, unlike expand + reshape, keeps channels_last.
            output = self._call(part.map(lambda value: torch.cat([value] * times), rows))
        else:
            output = self._call(part)
        if not isinstance(output, Tensor) or output.ndim == 0 or len(output) != rows:
            got = tuple(output.shape) if isinstance(output, Tensor) else type(output).__name__
            raise UncertaintyError(
                f"{type(self.network).__name__} returned {got} for {rows} rows; MC dropout needs "
                "one tensor with one row per input row (wrap the network to select its output)."
            )
        # Half precision is too coarse for a variance.
        precise = output.to(torch.promote_types(output.dtype, torch.float32))
        return precise.reshape(times, -1, *precise.shape[1:])

    def _call(self, arguments: Arguments) -> object:
        return self.network(*arguments.args, **arguments.kwargs)
