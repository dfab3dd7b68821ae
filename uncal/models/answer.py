"""What passes between an estimator, its stochastic passes and the module around them."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from torch import Tensor, nn

from uncal.data.network_input import NetworkInput


class Prior(NamedTuple):
    """What is known of each unit before the rounds, a Gaussian in units of the range.

    Attributes:
        mean: (n, 6).
        precision: (n, 6, 6), or (6, 6) for all alike; the inverse of the covariance.
    """

    mean: Tensor
    precision: Tensor


class State(NamedTuple):
    """What the rounds of an estimate know of each unit so far, in units of the range.

    Attributes:
        pose: (n, 6) estimated decalibration.
        covariance: (n, 6, 6) of its error.
        prior: what was known before; None: only that decalibrations are uniform over the range.
    """

    pose: Tensor
    covariance: Tensor
    prior: Prior | None = None


class Question(NamedTuple):
    """What stochastic passes are asked.

    Attributes:
        arguments: of the network that they repeat; one row per frame.
        state: what went before; None where there is nothing.
    """

    arguments: tuple[Tensor, ...]
    state: State | None


class Answer(NamedTuple):
    """What stochastic passes answer.

    Attributes:
        samples: (N, n, 6) poses in metres and radians; (N, n, 18) with two quantiles behind.
        covariance: (n, 6, 6) of the error as the solver knows it; None without a solver.
    """

    samples: Tensor
    covariance: Tensor | None


class Estimator(Protocol):
    """From a batch of frames to the poses of its units."""

    @property
    def repeated(self) -> nn.Module:
        """The network that stochastic passes repeat; one row of output per frame."""
        ...

    def pose(self, batch: NetworkInput) -> Tensor:
        """(n, 6) estimates without dropout, metres and radians."""
        ...

    def question(self, batch: NetworkInput) -> Question:
        """What to ask the stochastic passes."""
        ...

    def answer(self, samples: Tensor, batch: NetworkInput, question: Question) -> Answer:
        """What their (N, B, D) outputs mean."""
        ...

    def loss(self, batch: NetworkInput) -> Tensor:
        """What training minimises."""
        ...
