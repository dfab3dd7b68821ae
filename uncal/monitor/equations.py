"""Normal equations of one frame from whatever estimator the weights have."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import cast

import torch
from torch import Tensor

from uncal.data.network_input import NetworkInput
from uncal.edges.evidence import pack, unpack
from uncal.models.alignment import PRIOR, AlignmentEstimator
from uncal.models.answer import Estimator, Prior
from uncal.models.edge_alignment import EdgeAlignment, EdgeAlignmentEstimator
from uncal.models.module import CalibrationModule
from uncal.monitor.sharing import computed_once
from uncal.uncertainty.dropout.layers import only_active

AVERAGED = 1e4
"""Precision of a frame's pose, in units of the range, where a network has no normal equations: the
same for all frames, and so large that the prior does not count. Windows are then plain means."""

Found = tuple[Tensor, float, Prior | None]
"""(N, 27) packed normal equations, the solver's residual in pixels, and what was known before."""

Seconds = dict[str, float]
"""Time spent in each stage."""


class Asker:
    """Asks the estimator of some weights what one frame says.

    Args:
        module: the weights.
        bounds: (6,) range of the decalibrations.
        seconds: that the time of each stage is added to.
    """

    def __init__(self, module: CalibrationModule, bounds: Tensor, seconds: Seconds) -> None:
        self.module = module
        self.bounds = bounds
        self.seconds = seconds

    @property
    def reads_edges(self) -> bool:
        """Whether the estimator looks at edges alone, and at no projected points."""
        return isinstance(self.module.estimator, AlignmentEstimator | EdgeAlignmentEstimator)

    @property
    def alignment(self) -> EdgeAlignment | None:
        """What scores edges without a network; None where the estimator has nothing of the kind."""
        estimator = self.module.estimator
        if isinstance(estimator, AlignmentEstimator) and estimator.start is not None:
            return estimator.start.network
        return estimator.network if isinstance(estimator, EdgeAlignmentEstimator) else None

    def __call__(self, inputs: NetworkInput, seed: int, counts_start: bool) -> Found:
        """Equations of the whole decalibration, without the uniform prior.

        Args:
            inputs: of one frame.
            seed: of its dropout masks.
            counts_start: whether what the start has found is part of the equations; otherwise it
                is the prior that goes with them.
        """
        estimator = self.module.estimator
        if isinstance(estimator, AlignmentEstimator):
            with computed_once(estimator):
                return self._rounds(estimator, inputs, seed, counts_start)
        if isinstance(estimator, EdgeAlignmentEstimator):
            with self._timed("start"), only_active(estimator, []):
                pose, covariance, _ = estimator.align(inputs)
            return without_prior(pose.float(), covariance.float()), 0.0, None
        other = cast(Estimator, estimator)
        with self._timed("network"), only_active(estimator, []):
            question = other.question(inputs)
        answer = other.answer(self._passes(question.arguments, seed), inputs, question)
        return averaged(answer.samples[:, 0, :6] / self.bounds), 0.0, None

    def _rounds(
        self, estimator: AlignmentEstimator, inputs: NetworkInput, seed: int, counts_start: bool
    ) -> Found:
        with only_active(estimator, []):
            with self._timed("start"):
                estimator.begin(inputs)
            with self._timed("network"):
                question = estimator.question(inputs)
                residual = float(estimator.last.residual(*question.arguments))
        samples = self._passes(question.arguments, seed)
        assert question.state is not None
        normal, right = unpack(samples[:, 0])
        # Of what is left after the rounds before; the whole is that and what they found.
        whole = right + normal @ question.state.pose[0]
        prior = question.state.prior
        if prior is not None and counts_start:
            # What the start has found adds up over a window as the rest does.
            known = beyond(prior.precision[0], PRIOR / estimator.start_inflation)
            normal, whole, prior = normal + known, whole + known @ prior.mean[0], None
        return pack(normal, whole), residual, prior

    def _passes(self, arguments: tuple[Tensor, ...], seed: int) -> Tensor:
        with self._timed("passes"):
            samples = self.module.engine(*arguments, seed=[seed]).samples
        assert samples is not None
        return samples

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        begin = perf_counter()
        yield
        self.seconds[stage] += perf_counter() - begin


def averaged(poses: Tensor) -> Tensor:
    """Poses of a network without normal equations as such; see :data:`AVERAGED`.

    Args:
        poses: (N, 6) in units of the range.

    Returns:
        (N, 27).
    """
    normal = (AVERAGED * torch.eye(6).to(poses)).expand(len(poses), 6, 6)
    return pack(normal, AVERAGED * poses)


def without_prior(pose: Tensor, covariance: Tensor) -> Tensor:
    """(1, 27) what a search has found beyond the prior, whose mean is zero."""
    information = torch.linalg.inv(covariance[0])
    return pack(beyond(information, PRIOR), information @ pose[0])[None]


def beyond(information: Tensor, precision: float) -> Tensor:
    """(6, 6) information without that of a prior of this precision, at least none."""
    eye = torch.eye(6).to(information)
    values, vectors = torch.linalg.eigh(information - precision * eye)
    rest: Tensor = (vectors * values.clamp(min=0)) @ vectors.T
    return rest
