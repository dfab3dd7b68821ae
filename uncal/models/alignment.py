"""From curves along the edges of a sweep to the pose: rounds, windows, and what dropout repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from uncal.data.network_input import NetworkInput
from uncal.edges.evidence import pack, project_edges, sharp_component, unpack
from uncal.errors import ConfigurationError
from uncal.geometry.decalibration import correct, decalibrate
from uncal.geometry.projection import true_displacement
from uncal.models.answer import Answer, Prior, Question, State
from uncal.models.edge_alignment import EdgeAlignmentEstimator
from uncal.models.evidence import STRIDES, EvidenceNetwork
from uncal.models.last_round import LastRound
from uncal.models.losses import cross_entropy, surprise
from uncal.models.operators import EAGER, Operators

PRIOR = 3.0
"""Precision of a uniform distribution over -1..1, the decalibrations in units of their range."""

LEAST = 1e-6
"""Smallest variance of a start: a thousandth of the range, squared, so that it can be inverted."""

BEYOND = 1.3
"""Estimates stay within this many ranges between rounds."""


@dataclass(frozen=True)
class LearningSettings:
    """What training minimises, and at which remaining decalibrations each scale is trained.

    Attributes:
        smallest: of each scale, the smallest remaining decalibration, in units of the range.
        largest: of each scale, the largest.
        pose_weight: of the pose's smooth L1 loss, beside the curves' cross-entropy.
        precision_weight: of the Gaussian log-likelihood of the pose.
    """

    smallest: Sequence[float]
    largest: Sequence[float]
    pose_weight: float
    precision_weight: float

    def __post_init__(self) -> None:
        """Check them now; the first step comes after the recordings are read.

        Raises:
            ConfigurationError: names all four.
        """
        n = len(STRIDES)
        pairs = zip(self.smallest, self.largest, strict=False)
        fits = len(self.smallest) == len(self.largest) == n and all(
            0 < a <= b <= 1 for a, b in pairs
        )
        if not fits or min(self.pose_weight, self.precision_weight) < 0:
            raise ConfigurationError(
                f"model.learning: smallest={list(self.smallest)}, largest={list(self.largest)}, "
                f"pose_weight={self.pose_weight}, precision_weight={self.precision_weight}: "
                f"expected {n} numbers each with 0 < smallest ≤ largest ≤ 1, weights from 0 on"
            )


class AlignmentEstimator(nn.Module):
    """Estimates in rounds: project with the pose so far, add up the evidence, solve, again.

    The prior is on the total decalibration: uniform, or around the pose that an alignment without
    training finds. That one looks at the whole range at once, so that no round has to find its way
    from afar; on images unlike those of the training the rounds lose theirs.

    Frames of a window share one decalibration, so that their normal equations are added before they
    are solved (:mod:`uncal.splits.windows`).

    Args:
        network: gives the curves.
        bounds: (6,) range of the decalibrations, metres and radians.
        rounds: stride of each round, coarse to fine.
        learning: what training minimises.
        start: finds the pose that rounds begin with; None: they begin with no decalibration.
        start_inflation: factor on the covariance of its error: the rounds read the same edges and
            the same image again, so that what the start says counts less than it would alone.
        reaches: how far around the pose so far each round looks, in units of the range; None: as
            far as the covariance of the round before says. Summed over a window that covariance
            soon is too small: errors that edges and frames have in common do not average out.

    Raises:
        ConfigurationError: a round at a scale that the network does not have, or reaches that do
            not fit the rounds.
    """

    def __init__(
        self,
        network: EvidenceNetwork,
        bounds: Tensor,
        rounds: Sequence[int],
        learning: LearningSettings,
        start: EdgeAlignmentEstimator | None = None,
        start_inflation: float = 16.0,
        reaches: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        if start_inflation < 1:
            raise ConfigurationError(
                f"model.start.inflation={start_inflation}: expected at least 1"
            )
        if not rounds or any(stride not in STRIDES for stride in rounds) or rounds[-1] != 1:
            raise ConfigurationError(
                f"model.rounds={list(rounds)}: expected strides out of {list(STRIDES)}, the last 1"
            )
        if reaches is not None and not (
            len(reaches) == len(rounds) and all(0 < reach <= 1 for reach in reaches)
        ):
            raise ConfigurationError(
                f"model.reaches={list(reaches)}: expected null, or a number above 0 and at most 1 "
                f"for each of model.rounds={list(rounds)}"
            )
        self.last: LastRound = LastRound(network, bounds).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.rounds = [STRIDES.index(stride) for stride in rounds]
        self.learning = learning
        self.start = start
        self.start_inflation = start_inflation
        self.reaches = reaches and tuple(reaches)

    @property
    def bounds(self) -> Tensor:
        """(6,) range of the decalibrations, metres and radians."""
        return self.last.bounds

    def begin(self, batch: NetworkInput, operators: Operators = EAGER) -> State:
        """What is known before the first round.

        Args:
            batch: B frames of n units.
            operators: others where an exported graph lacks the usual ones.
        """
        n = len(batch.unit_index)
        if self.start is None:
            return State(
                batch.K.new_zeros(n, 6), (torch.eye(6) / PRIOR).to(batch.K).expand(n, 6, 6)
            )
        pose, covariance, _ = self.start.align(batch, operators)
        covariance = self.start_inflation * covariance + LEAST * torch.eye(6).to(covariance)
        return State(pose, covariance, Prior(pose, operators.inverse(covariance)))

    def align(self, batch: NetworkInput, rounds: int) -> State:
        """The first rounds, without dropout."""
        return self.refine(
            batch, self.last.network.describe(batch.x), self.begin(batch), rounds, EAGER
        )

    def refine(
        self,
        batch: NetworkInput,
        maps: list[tuple[Tensor, Tensor]],
        state: State,
        rounds: int,
        operators: Operators,
    ) -> State:
        """The first rounds from :meth:`begin` on.

        Args:
            batch: B frames of n units.
            maps: features of the frames' images.
            state: what is known before.
            rounds: how many.
            operators: as in :meth:`begin`.
        """
        size = (batch.x.shape[-2], batch.x.shape[-1])
        for number, level in enumerate(self.rounds[:rounds]):
            T = self.assumed(batch, state)
            projected = project_edges(batch.edges, batch.K, T, size, self.bounds)
            read = self.last.network.read(maps, projected, level)
            curves, weights = self.last.network.curves(read, batch.edges, batch.K, projected, level)
            around = self.around(number, state.covariance)[batch.unit]
            equations = self.last.equations(curves, weights, projected, around, level)
            packed = self.fuse(pack(*equations), batch.unit, len(batch.unit_index))
            state = self.solve(packed, state, operators)
        return state

    def around(self, number: int, covariance: Tensor) -> Tensor:
        """Where a round expects the pose to be.

        Args:
            number: of the round.
            covariance: (n, 6, 6) of the pose so far, in units of the range.

        Returns:
            (n, 6, 6) covariance about the pose so far.
        """
        if self.reaches is None:
            return covariance
        eye = torch.eye(6, dtype=covariance.dtype, device=covariance.device)
        return (self.reaches[number] ** 2 / PRIOR * eye).expand_as(covariance)

    def assumed(self, batch: NetworkInput, state: State) -> Tensor:
        """(B, 4, 4) extrinsics after what is known so far has been taken out."""
        return correct(batch.T_init, (state.pose * self.bounds)[batch.unit])

    @staticmethod
    def fuse(packed: Tensor, unit: Tensor, n: int) -> Tensor:
        """Add up the normal equations of each unit's frames.

        Args:
            packed: (..., B, 27).
            unit: (B,) which unit each frame belongs to.
            n: number of units.

        Returns:
            (..., n, 27).
        """
        total = packed.new_zeros(*packed.shape[:-2], n, packed.shape[-1])
        return total.index_add(packed.ndim - 2, unit, packed)

    @staticmethod
    def solve(packed: Tensor, state: State, operators: Operators = EAGER) -> State:
        """The total decalibration after one round, and its covariance.

        Args:
            packed: (..., n, 27) normal equations of what is left.
            state: before.
            operators: as in :meth:`begin`.

        Returns:
            (..., n, 6) and (..., n, 6, 6).
        """
        normal, right = unpack(packed)
        uniform = Prior(torch.zeros_like(state.pose), PRIOR * torch.eye(6).to(normal))
        mean, precision = state.prior or uniform
        right = right + (precision @ (mean - state.pose)[..., None]).squeeze(-1)
        step, covariance = operators.solve(normal + precision, right)
        return State((state.pose + step).clamp(-BEYOND, BEYOND), covariance, state.prior)

    @property
    def repeated(self) -> nn.Module:
        """What stochastic passes repeat."""
        return self.last

    def pose(self, batch: NetworkInput) -> Tensor:
        """The estimate of all rounds, without dropout.

        Returns:
            (n, 6) metres and radians.
        """
        return self.align(batch, len(self.rounds)).pose * self.bounds

    def question(self, batch: NetworkInput) -> Question:
        """All rounds but the last, which stochastic passes repeat."""
        before = len(self.rounds) - 1
        state = self.align(batch, before)
        T = self.assumed(batch, state)
        around = self.around(before, state.covariance)[batch.unit]
        return Question((batch.x, batch.edges, batch.K, T, around), state)

    def answer(self, samples: Tensor, batch: NetworkInput, question: Question) -> Answer:
        """Poses of the stochastic passes, and what the solver itself knows of their error.

        Args:
            samples: (N, B, 27) of :class:`LastRound`.
            batch: the same batch.
            question: what was asked.

        Returns:
            (N, n, 6) poses and (n, 6, 6) covariance, metres and radians.
        """
        assert question.state is not None
        packed = self.fuse(samples, batch.unit, len(batch.unit_index))
        poses = self.solve(packed, question.state).pose
        covariance = self.solve(packed.mean(0), question.state).covariance
        scales = self.bounds[:, None] * self.bounds
        return Answer(poses * self.bounds, covariance * scales)

    def loss(self, batch: NetworkInput) -> Tensor:
        """Cross-entropy of the curves, error and log-likelihood of the pose, over all scales.

        Each scale meets its own range of remaining decalibrations, drawn here; the batch's own
        decalibration is taken out first.
        """
        n = len(batch.x)
        T_true = correct(batch.T_init, batch.target)
        maps = self.last.network.describe(batch.x)
        size = (batch.x.shape[-2], batch.x.shape[-1])
        total = batch.x.new_zeros(())
        for level, stride in enumerate(STRIDES):
            low, high = self.learning.smallest[level], self.learning.largest[level]
            reach = low + (high - low) * torch.rand(n, 1, device=batch.x.device)
            if level == 0:  # most often at the very start
                reach = torch.where(torch.rand_like(reach) < 0.7, high, reach)
            left = (2 * torch.rand(n, 6, device=reach.device) - 1) * reach
            found = (2 * torch.rand(n, 6, device=reach.device) - 1) * (1 - reach).clamp(min=0)
            T = decalibrate(T_true, left * self.bounds)
            covariance = torch.diag_embed((reach**2 / PRIOR).expand(n, 6))
            projected = project_edges(batch.edges, batch.K, T, size, self.bounds)
            read = self.last.network.read(maps, projected, level)
            curves, weights = self.last.network.curves(read, batch.edges, batch.K, projected, level)
            equations = self.last.equations(curves, weights, projected, covariance, level)
            after = self.solve(pack(*equations), State(found, covariance))
            truth = found + left
            moved = true_displacement(projected.points_cam, batch.K, T, left * self.bounds)
            offset = sharp_component(moved, projected.along)
            total = total + cross_entropy(curves, offset, projected.seen, stride)
            scale = reach.clamp(min=0.1)
            total = total + self.learning.pose_weight * F.smooth_l1_loss(
                after.pose / scale, truth / scale, beta=0.1
            )
            total = total + self.learning.precision_weight * surprise(after, truth)
        return total
