"""Posterior of a decalibration from any log-likelihood: tempered adaptive importance sampling."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import torch
from torch import Tensor

from uncal.errors import ConfigurationError
from uncal.models.answer import State

Operator = Callable[[Tensor], Tensor]
"""Of one tensor: lower Cholesky factor of (n, 6, 6), or cumulative normal distribution."""

LogLikelihood = Callable[[Tensor], Tensor]
"""(n, P, 6) poses in units of the range → (n, P)."""

_PARTS, _DIVISIONS = 16, 5
"""The interval in which the temperature is sought is divided so often into so many parts."""

_FLOOR = 1e-5
"""Added to the variances of the proposal, lest it collapse."""


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """How much work a search does.

    Attributes:
        samples: poses per round.
        effective: samples that at least must share a round's weight; a likelihood too sharp for
            that is flattened until they do.
        widening: factor on the covariance from one round's posterior to the next one's proposal.
        seed: of the quasi-random poses, which are the same for every unit.
    """

    samples: int
    effective: int
    widening: float
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ConfigurationError: a number is out of its range.
        """
        if not 7 <= self.effective <= self.samples or self.widening < 1:
            raise ConfigurationError(
                f"model.search: samples={self.samples}, effective={self.effective}, "
                f"widening={self.widening}: expected 7 ≤ effective ≤ samples and widening ≥ 1"
            )


def search(
    rounds: Sequence[LogLikelihood],
    n: int,
    settings: SearchSettings,
    cholesky: Operator = torch.linalg.cholesky,
    ndtr: Operator = torch.special.ndtr,
) -> State:
    """Mean and covariance of the posterior, under a uniform prior over the range.

    A pose ξ in (-1, 1)⁶ is searched as y = Φ⁻¹((ξ + 1) / 2), whose prior is N(0, I), so that no
    sample leaves the range. Each round draws y from a Gaussian q and weights it with
    L(ξ)^γ N(y; 0, I) / q(y); γ ≤ 1 is the largest exponent that leaves enough effective samples
    (annealed importance sampling, Neal 2001). The weighted moments, widened, are the next q. The
    last two rounds, if they have the same likelihood, give the result together.

    The poses come from one Sobol sequence for all units, and nothing is sorted or cut off: a unit's
    result depends on no other unit.

    Args:
        rounds: the log-likelihood of each round, smooth ones first, the sharpest last.
        n: number of units.
        settings: samples and seed.
        cholesky: another one where an exported graph has none.
        ndtr: the same.

    Returns:
        The state, in units of the range; on the device and of the type of the likelihood's values.

    >>> def near(pose: Tensor) -> Tensor:
    ...     return -0.5 * ((pose - 0.4) / 0.1).square().sum(-1)
    >>> settings = SearchSettings(samples=256, effective=24, widening=1.3)
    >>> pose, covariance, _ = search([near] * 6, 1, settings)
    >>> bool((pose - 0.4).abs().max() < 0.03), round(covariance[0, 0, 0].sqrt().item(), 1)
    (True, 0.1)
    """
    if not rounds:
        raise ConfigurationError("model.rounds: expected at least one round")
    draws = standard_normals(len(rounds), settings.samples, settings.seed)
    mean, covariance = draws.new_zeros(n, 6), torch.eye(6).expand(n, 6, 6)
    kept: list[tuple[LogLikelihood, Tensor, Tensor, Tensor]] = []
    exponent = mean[:, :1]
    for likelihood, z in zip(rounds, draws, strict=True):
        factor = cholesky(covariance)
        y = mean[:, None] + z.to(mean) @ factor.transpose(1, 2)
        log_det = factor.diagonal(dim1=1, dim2=2).log().sum(1)
        # Of prior and proposal; their constants cancel.
        ratio = 0.5 * (z.to(mean).square().sum(-1) - y.square().sum(-1)) + log_det[:, None]
        pose = 2.0 * ndtr(y) - 1.0
        log = likelihood(pose)
        mean, covariance, y, ratio = (t.to(log) for t in (mean, covariance, y, ratio))
        exponent = temper(log, ratio, settings.effective)
        weight = (exponent * log + ratio).softmax(1)[..., None]
        mean = (weight * y).sum(1)
        centred = y - mean[:, None]
        covariance = settings.widening * ((weight * centred).transpose(1, 2) @ centred)
        covariance = covariance + _FLOOR * torch.eye(6).to(covariance)
        # Only samples of one likelihood can be weighed against each other.
        kept = [*(k for k in kept[-1:] if k[0] is likelihood), (likelihood, pose, log, ratio)]
    pose = torch.cat([pose.to(log) for _, pose, log, _ in kept], 1)
    total = torch.cat([exponent * log + ratio for _, _, log, ratio in kept], 1)
    weight = total.softmax(1)[..., None]
    best = (weight * pose).sum(1)
    centred = pose - best[:, None]
    return State(best, (weight * centred).transpose(1, 2) @ centred)


def temper(log: Tensor, ratio: Tensor, effective: float) -> Tensor:
    """Largest exponent, at most 1, that leaves enough effective samples, 1 / Σ w².

    Args:
        log: (n, P) log-likelihood.
        ratio: (n, P) log-ratio of prior and proposal.
        effective: samples wanted.

    Returns:
        (n, 1); nearly 0 where no exponent leaves so many.

    >>> log = torch.tensor([[0.0, 0.0, -9.0, -9.0]])
    >>> temper(log, torch.zeros(1, 4), 2).item(), temper(log, torch.zeros(1, 4), 4).item() < 1e-3
    (1.0, True)
    """

    def enough(exponents: Tensor) -> Tensor:
        weight = (exponents[..., None] * log[:, None] + ratio[:, None]).softmax(-1)
        return weight.square().sum(-1) * effective <= 1.0

    low = torch.zeros_like(log[:, :1])
    whole = enough(low + 1.0)
    between = torch.arange(1, _PARTS, device=log.device).to(log) / _PARTS
    width = 1.0
    for _ in range(_DIVISIONS):
        # All of them at once: single steps would take longer to start than to compute.
        good = enough(low + width * between)
        width = width / _PARTS
        low = low + width * good.to(log).sum(1, keepdim=True)
    return torch.where(whole, torch.ones_like(low), low)


@lru_cache(maxsize=8)
def standard_normals(rounds: int, samples: int, seed: int) -> Tensor:
    """(rounds, samples, 6) quasi-random N(0, I), float32, on the CPU.

    >>> draws = standard_normals(2, 256, seed=0)
    >>> draws.shape, bool(draws.mean(1).abs().max() < 0.02)
    (torch.Size([2, 256, 6]), True)
    """
    smallest = 0.5 / samples
    engines = [
        torch.quasirandom.SobolEngine(6, scramble=True, seed=seed + number)  # type: ignore[no-untyped-call]
        for number in range(rounds)
    ]
    uniform = torch.stack([engine.draw(samples, dtype=torch.float64) for engine in engines])
    return cast(Tensor, torch.special.ndtri(uniform.clamp(smallest, 1.0 - smallest)).float())
