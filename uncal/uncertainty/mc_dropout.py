"""Monte Carlo dropout for any network: N stochastic passes as one replicated batch (eqs. 1-2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from uncal.errors import ConfigurationError
from uncal.uncertainty.dropout import dropout_rates, only_dropout_active
from uncal.uncertainty.errors import UncertaintyError
from uncal.uncertainty.fingerprint import PredictorIdentity
from uncal.uncertainty.nested import iterate_tensors, map_tensors


@dataclass(frozen=True)
class Prediction:
    """Mean and spread of N stochastic passes (eq. 2).

    Attributes:
        mean: (B, D) ŷ_mean, float32 or better.
        std: (B, D) σ with 1/N as in the paper, not 1/(N-1).
        passes: N.
        samples: (N, B, D) the single passes, if they were asked for.
    """

    mean: Tensor
    std: Tensor
    passes: int
    samples: Tensor | None = None


class MCDropout:
    """Ask a network N times with random dropout masks.

    ŷ_i = f(x; θ_i), ŷ_mean = 1/N Σ ŷ_i, σ = √(1/N Σ (ŷ_i - ŷ_mean)²)   (paper, eqs. 1 and 2)

    The N passes are one batch of N·B rows, so that every row gets a mask of its own. Exactly the
    dropout layers are switched on, whatever mode the network is in (Lightning's validation and
    test loops call ``eval()``); see :mod:`uncal.uncertainty.dropout` for those that can be found.
    Not a module itself, so that holding one beside the network adds nothing to a ``state_dict``.

    Args:
        network: maps arguments to a tensor (B, D).
        passes: N, at least 2.
        chunk: most rows to push through the network at once when memory is short; None for all.
        keep_samples: return the single passes too.

    Raises:
        ConfigurationError: ``passes`` below 2 or ``chunk`` below 1.

    >>> network = nn.Sequential(nn.Linear(3, 8), nn.Dropout(0.5), nn.Linear(8, 2))
    >>> prediction = MCDropout(network, passes=25)(torch.ones(4, 3), seed=0)
    >>> tuple(prediction.mean.shape), bool((prediction.std > 0).all())
    ((4, 2), True)
    """

    def __init__(
        self,
        network: nn.Module,
        passes: int,
        chunk: int | None = None,
        *,
        keep_samples: bool = False,
    ) -> None:
        """Check the settings; the network is looked at when called."""
        if passes < 2:
            raise ConfigurationError(
                f"{passes} stochastic passes give no spread; set at least 2 (the paper: 25)."
            )
        if chunk is not None and chunk < 1:
            raise ConfigurationError(f"chunk = {chunk} rows; set at least 1, or None for no limit.")
        self.network = network
        self.passes = passes
        self.chunk = chunk
        self.keep_samples = keep_samples

    def identity(self) -> PredictorIdentity:
        """What a calibrator remembers of this predictor, and compares before use."""
        return PredictorIdentity.of(self.network, self.passes)

    def __call__(self, *args: object, seed: int | None = None, **kwargs: object) -> Prediction:
        """Run the passes.

        Args:
            *args: the network's arguments. The first tensor found tells the batch size B; every
                tensor whose first dimension is B is replicated, also inside tuples, lists and
                dicts; everything else is passed on as it is.
            seed: makes the result a pure function of weights, inputs, seed and chunk, and leaves
                the global random state (CPU and the inputs' GPU) untouched.
            **kwargs: the network's keyword arguments, treated alike.

        Returns:
            Mean and σ per row and output.

        Raises:
            ConfigurationError: no dropout layer of the network is active.
            UncertaintyError: no batch among the arguments, an output that is not one row per
                input row, or σ = 0 everywhere.
        """
        rates = dropout_rates(self.network)
        if not any(rate > 0 for rate in rates.values()):
            raise ConfigurationError(
                f"{type(self.network).__name__} has no active dropout layer "
                f"({len(rates)} found, p = 0 in all of them): MC dropout would see no spread. Set "
                "p > 0 or add nn.Dropout modules (functional dropout cannot be switched on)."
            )
        first = next(iterate_tensors((args, kwargs)), None)
        if first is None or len(first) == 0:
            raise UncertaintyError(
                "MC dropout needs a batch: a tensor argument with at least one row, got "
                + ("no tensor." if first is None else f"shape {tuple(first.shape)}.")
            )
        with only_dropout_active(self.network), _seeded(seed, first.device):
            samples = self._sample(args, kwargs, len(first))
        std, mean = torch.std_mean(samples, dim=0, correction=0)
        # Rows of one batch may differ in the last bits without any dropout: rounding is no spread.
        rounding = 4 * torch.finfo(torch.float32).eps * samples.abs().amax(0)
        if (std <= rounding).all():
            raise UncertaintyError(
                f"σ = 0 for all {mean.numel()} outputs over {self.passes} passes although "
                f"{type(self.network).__name__} has active dropout layers: their effect does not "
                "reach the output (a layer off the path, an output clamp, or features that vanish "
                "because the network is not trained yet)."
            )
        return Prediction(mean, std, self.passes, samples if self.keep_samples else None)

    def _sample(self, args: tuple[object, ...], kwargs: Mapping[str, object], batch: int) -> Tensor:
        """(N, B, D) single passes, in at most ``chunk`` rows at a time."""
        limit = self.chunk or self.passes * batch
        rows = min(batch, limit)
        columns = []
        for start in range(0, batch, rows):
            part = slice(start, min(start + rows, batch))
            group = limit // (part.stop - start)
            runs = [
                self._run(args, kwargs, batch, part, min(group, self.passes - done))
                for done in range(0, self.passes, group)
            ]
            columns.append(torch.cat(runs))
        return torch.cat(columns, dim=1)

    def _run(
        self,
        args: tuple[object, ...],
        kwargs: Mapping[str, object],
        batch: int,
        part: slice,
        times: int,
    ) -> Tensor:
        """(times, rows, D): one call of the network with some rows, each ``times`` times."""

        def replicate(value: Tensor) -> Tensor:
            if value.ndim == 0 or len(value) != batch:
                return value
            # cat, unlike expand + reshape, keeps channels_last.
            return torch.cat([value[part]] * times)

        with torch.inference_mode():
            output = self.network(
                *(map_tensors(value, replicate) for value in args),
                **{name: map_tensors(value, replicate) for name, value in kwargs.items()},
            )
        rows = times * (part.stop - part.start)
        if not isinstance(output, Tensor) or output.ndim == 0 or len(output) != rows:
            got = tuple(output.shape) if isinstance(output, Tensor) else type(output).__name__
            raise UncertaintyError(
                f"{type(self.network).__name__} returned {got} for {rows} rows; MC dropout needs "
                "one tensor with one row per input row (wrap the network to select its output)."
            )
        # Half precision is too coarse for a variance; the copy also leaves inference mode behind.
        precise = output.to(torch.promote_types(output.dtype, torch.float32), copy=True)
        return precise.reshape(times, -1, *precise.shape[1:])


@contextmanager
def _seeded(seed: int | None, device: torch.device) -> Iterator[None]:
    """Draw from a seed and put the random state back; without a seed, do nothing."""
    if seed is None:
        yield
        return
    cuda = device.type == "cuda"
    with torch.random.fork_rng(devices=[device] if cuda else []):
        # torch.manual_seed would seed every GPU, and only this one is put back.
        torch.default_generator.manual_seed(seed)
        if cuda:
            with torch.cuda.device(device):
                torch.cuda.manual_seed(seed)
        yield
