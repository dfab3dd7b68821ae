"""One pass without dropout: what the paper's σ is compared with."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn

from uncal.uncertainty.dropout.fingerprint import PredictorIdentity
from uncal.uncertainty.dropout.layers import only_active
from uncal.uncertainty.dropout.mc_dropout import MCDropout
from uncal.uncertainty.dropout.nested import iterate_tensors
from uncal.uncertainty.dropout.prediction import Prediction


class SinglePass(MCDropout):
    """A network asked once with all dropout off; stands where MC dropout stands, with σ = 0.

    For intervals that need no σ: from absolute errors, or from a quantile head.

    Args:
        network: maps arguments to a tensor (B, D).

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
        """Run the pass.

        Returns:
            The output as mean, and σ = 0.
        """
        with torch.inference_mode(), only_active(self.network, []):
            output = next(iterate_tensors(self.network(*args, **kwargs)))
        # A copy outside inference mode can be used with autograd.
        return Prediction.of(output.clone()[None], self.keep_samples)
