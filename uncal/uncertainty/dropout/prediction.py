"""What MC dropout says of a batch."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from uncal.errors import UncertaintyError


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

    @classmethod
    def of(cls, samples: Tensor, keep: bool = False) -> Prediction:
        """Mean and σ of (N, B, D) single passes, held on to if they are to be kept.

        >>> import torch
        >>> prediction = Prediction.of(torch.tensor([[[1.0]], [[3.0]]]))
        >>> prediction.mean.item(), prediction.std.item()
        (2.0, 1.0)
        """
        mean, std = samples.mean(0), samples.std(0, correction=0)
        return cls(mean, std, len(samples), samples if keep else None)

    def first(self, passes: int) -> Prediction:
        """What the first n passes, 2 ≤ n ≤ N, would have said: one of 50 also answers 5, 10 and 25.

        Passes are independent and identically distributed, so that the first n of N are n passes
        like any others; with fixed masks they are the passes of an engine with n masks.

        Raises:
            UncertaintyError: the samples were not kept, or n is out of range.

        >>> import torch
        >>> many = Prediction.of(torch.arange(12.0).view(4, 3, 1), keep=True)
        >>> many.first(2).mean.flatten().tolist()
        [1.5, 2.5, 3.5]
        """
        if self.samples is None:
            raise UncertaintyError(
                "the single passes were not kept: make the engine with keep_samples=True"
            )
        if not 2 <= passes <= self.passes:
            raise UncertaintyError(
                f"{passes} of {self.passes} passes: ask for 2 to {self.passes} of them"
            )
        return Prediction.of(self.samples[:passes], keep=True)
