"""Monte Carlo dropout for any network: N stochastic passes, shared where nothing is random."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor, nn

from uncal.errors import ConfigurationError, UncertaintyError
from uncal.uncertainty.dropout.fingerprint import PredictorIdentity
from uncal.uncertainty.dropout.layers import dropout_layers, dropout_rates, only_active, rate_of
from uncal.uncertainty.dropout.masks import FixedMasks, row_seeds
from uncal.uncertainty.dropout.passes import Arguments, Passes
from uncal.uncertainty.dropout.prediction import Prediction
from uncal.uncertainty.dropout.replicated import iterate_tensors
from uncal.uncertainty.dropout.stochastic_layers import StochasticLayers

STRATEGIES = ("auto", "shared", "batch", "loop")

log = logging.getLogger(__name__)


class MCDropout:
    """Ask a network N times with random dropout masks.

    ŷ_i = f(x; θ_i), ŷ_mean = 1/N Σ ŷ_i, σ = √(1/N Σ (ŷ_i - ŷ_mean)²)   (paper, eqs. 1 and 2)

    Exactly the dropout layers are switched on, whatever mode the network is in (Lightning's
    validation and test loops call ``eval()``); see
    :mod:`uncal.uncertainty.dropout.layers` for those that can be found. Three strategies give the
    same samples up to rounding, because masks are a pure function of (seed, layer, pass, row):

    - ``loop``: one pass after the other;
    - ``batch``: N·B rows at once, as in the paper;
    - ``shared``: what lies before the first active dropout runs once, only the rest N times.

    ``auto`` takes the first of shared, batch, loop that agrees with single rows looped on the
    inputs at hand; the comparison costs a few passes, once per shape of the inputs. Not a module
    itself, so that holding one beside the network adds nothing to a ``state_dict``.

    Args:
        network: maps arguments to a tensor (B, D).
        passes: N, at least 2.
        chunk: most rows to push through the network at once; "auto": as many as keep the working
            set within the caches (a GPU: a fraction of its memory), by the layers' sizes alone, so
            that results do not depend on the load of the machine; None: all.
        strategy: one of the above.
        masks: fixed masks, which make the prediction one deterministic function of its input;
            None: fresh ones.
        select: which dropout layers to activate, by name, pattern or type; None: all.
        keep_samples: return the single passes too.

    Raises:
        ConfigurationError: ``passes`` below 2, ``chunk`` below 1, or an unknown strategy.

    >>> network = nn.Sequential(nn.Linear(3, 8), nn.Dropout(0.5), nn.Linear(8, 2))
    >>> prediction = MCDropout(network, passes=25)(torch.ones(4, 3), seed=0)
    >>> tuple(prediction.mean.shape), bool((prediction.std > 0).all())
    ((4, 2), True)
    """

    def __init__(
        self,
        network: nn.Module,
        passes: int,
        chunk: int | str | None = "auto",
        *,
        strategy: str = "auto",
        masks: FixedMasks | None = None,
        select: Sequence[str] | None = None,
        keep_samples: bool = False,
    ) -> None:
        if passes < 2:
            raise ConfigurationError(
                f"{passes} stochastic passes give no spread; set at least 2 (the paper: 25)."
            )
        if chunk is not None and chunk != "auto" and (isinstance(chunk, str) or chunk < 1):
            raise ConfigurationError(
                f"chunk = {chunk} rows; set at least 1, auto, or null for no limit."
            )
        if strategy not in STRATEGIES:
            raise ConfigurationError(
                f"strategy = {strategy!r}; expected one of {', '.join(STRATEGIES)}"
            )
        self.network = network
        self.passes = passes
        self.chunk = chunk
        self.strategy = strategy
        self.masks = masks
        self.select = select
        self.keep_samples = keep_samples
        self._chosen: dict[tuple[object, ...], tuple[str, int]] = {}

    def identity(self, passes: int | None = None) -> PredictorIdentity:
        """What a calibrator remembers of this predictor (or its first passes) and compares."""
        return PredictorIdentity.of(
            self.network,
            passes or self.passes,
            rates=dropout_rates(self.network, self.select),
            masks="" if self.masks is None else self.masks.digest(),
        )

    def __call__(
        self, *args: object, seed: int | Sequence[int] | None = None, **kwargs: object
    ) -> Prediction:
        """Run the passes.

        Args:
            *args: the network's arguments. The first tensor found tells the batch size B; every
                tensor whose first dimension is B is replicated, also inside tuples, lists, dicts
                and dataclasses; everything else is passed on as it is.
            seed: makes the result a pure function of weights, inputs and seed, and leaves the
                global random state (CPU and the inputs' GPU) untouched. One integer for the whole
                batch, or one for each row: then a row's result does not depend, up to rounding,
                on the batch that it is in.
            **kwargs: the network's keyword arguments, treated alike.

        Returns:
            Mean and σ per row and output.

        Raises:
            ConfigurationError: no dropout layer of the network is active.
            UncertaintyError: no batch among the arguments, an output that is not one row per
                input row, σ = 0 everywhere, a strategy that does not fit the network, or fixed
                masks for inputs of another size.
        """
        # A copy outside inference mode can be used with autograd.
        samples = self.sampler(*args, seed=seed, **kwargs)().clone()
        prediction = Prediction.of(samples, self.keep_samples)
        self._check_spread(prediction, samples)
        return prediction

    def extend(
        self, known: Tensor, *args: object, seed: Sequence[int], **kwargs: object
    ) -> Prediction:
        """Run only those passes that are not known yet: N answer after n with N - n more.

        The (n, B, D) first passes, n < N, are of the same inputs and seeds of rows, as in a call.

        Returns:
            What a call says, up to rounding; with its samples. Where layers draw random numbers of
            their own, passes have no number, and all of them are run.
        """
        first = 0 if self._draws_itself() else len(known)
        samples = self._sampler(Arguments.of(args, kwargs), seed, first)().clone()
        return Prediction.of(torch.cat([known[:first].to(samples), samples]), keep=True)

    def sampler(
        self, *args: object, seed: int | Sequence[int] | None = None, **kwargs: object
    ) -> Callable[[], Tensor]:
        """What gives the (N, B, D) passes of the same tensors again and again (as a CUDA graph)."""
        return self._sampler(Arguments.of(args, kwargs), seed, 0)

    def _sampler(
        self, arguments: Arguments, seed: int | Sequence[int] | None, first: int
    ) -> Callable[[], Tensor]:
        active = self._active_layers()
        run = Passes(_plain(self.network), active, self.masks, self._row_seeds(seed, arguments))

        def sample() -> Tensor:
            with torch.inference_mode(), only_active(self.network, list(active.values())), run:
                strategy, chunk = self._plan(run, arguments)
                return run.sample(strategy, chunk, range(first, self.passes), arguments)

        return sample

    def plan(self) -> dict[tuple[object, ...], tuple[str, int]]:
        """Strategy and rows per call in use, by the inputs' shapes and types."""
        return dict(self._chosen)

    def _active_layers(self) -> Mapping[str, nn.Module]:
        layers = dropout_layers(_plain(self.network), self.select)
        active = {name: layer for name, layer in layers.items() if rate_of(layer) > 0}
        if not active:
            raise ConfigurationError(
                f"{type(self.network).__name__} has no active dropout layer "
                f"({len(layers)} found, p = 0 in all of them): MC dropout would see no spread. Set "
                "p > 0, add nn.Dropout modules (functional dropout cannot be switched on), or put "
                "some in with uncal.uncertainty.insert_dropout."
            )
        return active

    def _draws_itself(self) -> bool:
        return bool(StochasticLayers(self._active_layers(), self.masks).own)

    def _row_seeds(self, seed: int | Sequence[int] | None, arguments: Arguments) -> Tensor:
        """(B,) on the inputs' device."""
        if seed is None:
            seed = int(torch.randint(-(2**63), 2**63 - 1, ()))
        if isinstance(seed, int):
            return row_seeds(seed, arguments.batch).to(arguments.device)
        if len(seed) != arguments.batch:
            raise UncertaintyError(
                f"{len(seed)} seeds for a batch of {arguments.batch}: give one integer, or one for "
                "each row"
            )
        return torch.cat([row_seeds(each, 1) for each in seed]).to(arguments.device)

    def _plan(self, run: Passes, arguments: Arguments) -> tuple[str, int]:
        """Strategy and most rows per call for inputs of these shapes."""
        key = arguments.signature()
        if key not in self._chosen:
            strategy = self._choose(run, arguments)
            limit = run.auto_chunk() if self.chunk == "auto" else self.chunk
            rows = self.passes * arguments.batch if limit is None else int(limit)
            self._chosen[key] = strategy, rows
            log.debug("%s: strategy %s, %d rows", type(self.network).__name__, strategy, rows)
        return self._chosen[key]

    def _choose(self, run: Passes, arguments: Arguments) -> str:
        wanted = ("shared", "batch", "loop") if self.strategy == "auto" else (self.strategy,)
        for strategy in wanted:
            problem = run.disagreement(strategy, arguments)
            if problem is None:
                return strategy
            if strategy == wanted[-1]:
                raise UncertaintyError(
                    f"strategy {strategy} does not fit {type(self.network).__name__}: {problem}. "
                    + (
                        "Rows seem to influence each other."
                        if strategy == "loop"
                        else "Use strategy auto or loop (mcd.strategy)."
                    )
                )
            log.info("%s: not %s: %s", type(self.network).__name__, strategy, problem)
        raise AssertionError("one strategy is always wanted")

    def _check_spread(self, prediction: Prediction, samples: Tensor) -> None:
        # Rows of one batch may differ in the last bits without any dropout: rounding is no spread.
        rounding = 4 * torch.finfo(torch.float32).eps * samples.abs().amax(0)
        if (prediction.std <= rounding).all():
            raise UncertaintyError(
                f"σ = 0 for all {prediction.mean.numel()} outputs over {self.passes} passes "
                f"although {type(self.network).__name__} has active dropout layers: their effect "
                "does not reach the output (a layer off the path, an output clamp, or features "
                "that vanish because the network is not trained yet)."
            )


def _plain(network: nn.Module) -> nn.Module:
    """The network inside torch.compile's wrapper, whose compiled code knows no masks."""
    inner = getattr(network, "_orig_mod", network)
    return inner if isinstance(inner, nn.Module) else network


class SinglePass(MCDropout):
    """A network asked once with all dropout off; stands where MC dropout stands, with σ = 0.

    For intervals that need no σ: from absolute errors, or from a quantile head.

    >>> network = nn.Sequential(nn.Linear(3, 8), nn.Dropout(0.5), nn.Linear(8, 2))
    >>> prediction = SinglePass(network)(torch.ones(4, 3))
    >>> prediction.passes, bool((prediction.std == 0).all())
    (1, True)
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__(network, passes=2)
        self.passes = 1

    def identity(self, passes: int | None = None) -> PredictorIdentity:
        """Weights alone: no dropout rate plays a part."""
        return PredictorIdentity.of(self.network, 1, rates={})

    def __call__(
        self, *args: object, seed: int | Sequence[int] | None = None, **kwargs: object
    ) -> Prediction:
        """The output of the pass as mean, and σ = 0."""
        with torch.inference_mode(), only_active(self.network, []):
            output = next(iterate_tensors(self.network(*args, **kwargs)))
        # A copy outside inference mode can be used with autograd.
        return Prediction.of(output.clone()[None], self.keep_samples)
