"""The estimator along edges: with curves that say the truth, and with its own small network."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from uncal.data.network_input import NetworkInput
from uncal.edges.evidence import (
    ProjectedEdges,
    offsets_of,
    pack,
    project_edges,
    sharp_component,
    unpack,
)
from uncal.edges.sweep import COLUMNS, KIND, KINDS, STRENGTH
from uncal.errors import ConfigurationError
from uncal.geometry.decalibration import DecalibrationRange, decalibrate
from uncal.models.alignment import (
    BEYOND,
    PRIOR,
    AlignmentEstimator,
    LearningSettings,
)
from uncal.models.answer import State
from uncal.models.edge_alignment import EdgeAlignmentEstimator
from uncal.models.evidence import STRIDES, EvidenceNetwork
from uncal.models.losses import cross_entropy, surprise
from uncal.models.operators import Operators
from uncal.recordings.frame import FrameId
from uncal.uncertainty import MCDropout

RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)
LEARNING = LearningSettings([0.2, 0.1, 0.04], [1.0, 0.7, 0.44], 1.0, 0.1)
K = torch.tensor([[230.0, 0.0, 103.2], [0.0, 228.0, 41.7], [0.0, 0.0, 1.0]])
T = torch.tensor([[0.0, -1, 0, 0.05], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
SIZE = (80, 208)
ROUNDS = [4, 4, 2, 2, 1, 1]


def batch_of(n: int, edges: int = 1000, size: tuple[int, int] = SIZE) -> NetworkInput:
    """n single frames with edges everywhere in the image; the images are noise."""
    torch.manual_seed(0)
    camera = K.clone()
    camera[:2] *= size[1] / SIZE[1]
    rows = torch.rand(n, edges, len(COLUMNS))
    aside = (2 * rows[..., 1:3] - 1) * torch.tensor([0.42, 0.16])
    depth = 4.0 + 16.0 * rows[..., :1] ** 2
    rows[..., :3] = depth * torch.cat([torch.ones_like(depth), aside], -1)
    rows[..., KIND] = torch.arange(edges) % len(KINDS)
    target = RANGE.draw(n)
    return NetworkInput(
        x=torch.randn(n, 5, *size),
        inverse_depth=torch.zeros(n, 1, *size),
        K=camera.expand(n, 3, 3),
        T_init=decalibrate(T.expand(n, 4, 4), target),
        target=target,
        unit_index=torch.arange(n),
        frames=[FrameId("rig", "drive", i) for i in range(n)],
        unit=torch.arange(n),
        edges=rows,
    )


class Truthful(nn.Module):
    """In place of a network: curves that peak where the edges really are."""

    def __init__(self, sigma: float, n: int) -> None:
        super().__init__()
        self.reach = (8, 8, 8)
        self.sigma = sigma
        self.T = T.expand(n, 4, 4)

    def describe(self, x: Tensor) -> list[Tensor]:
        self.size = (x.shape[-2], x.shape[-1])
        return []

    def read(self, maps: list[Tensor], projected: ProjectedEdges, level: int) -> Tensor:
        return torch.empty(len(projected.seen), 0)

    def curves(
        self, read: Tensor, edges: Tensor, K: Tensor, projected: ProjectedEdges, level: int
    ) -> tuple[Tensor, Tensor]:
        truth = project_edges(edges, K, self.T, self.size, RANGE.bounds)
        offset = sharp_component(truth.pixels - projected.pixels, projected.along)
        offsets = offsets_of(STRIDES[level], self.reach[level], offset)
        curves = -0.5 * (offsets - offset[..., None]) ** 2 / self.sigma**2
        return curves, projected.seen * truth.seen


def truthful(n: int, sigma: float = 1.0) -> AlignmentEstimator:
    network: EvidenceNetwork = Truthful(sigma, n)  # type: ignore[assignment]
    made = AlignmentEstimator(network, RANGE.bounds, ROUNDS, LEARNING)
    # Curves that do not err count in full: so little is left of the prior.
    nn.init.zeros_(made.last.log_share)
    return made


def first_of(batch: NetworkInput) -> NetworkInput:
    return batch._replace(
        x=batch.x[:1],
        inverse_depth=batch.inverse_depth[:1],
        K=batch.K[:1],
        T_init=batch.T_init[:1],
        target=batch.target[:1],
        unit_index=batch.unit_index[:1],
        frames=batch.frames[:1],
        unit=batch.unit[:1],
        edges=batch.edges[:1],
    )


def learner(dropout: float = 0.25) -> AlignmentEstimator:
    torch.manual_seed(1)
    network = EvidenceNetwork(
        in_channels=5,
        camera_channels=3,
        image_edges="mean",
        window=5,
        widths=[8, 8, 8],
        features=4,
        reach=[3, 4, 4],
        channel_dropout=dropout,
        evidence_dropout=dropout,
    )
    return AlignmentEstimator(network, RANGE.bounds, [4, 2, 1], LEARNING)


SMALL = (32, 64)


def test_a_decalibration_is_recovered_from_curves_that_tell_the_truth() -> None:
    batch = batch_of(6)
    subject = truthful(6)
    error = (subject.pose(batch) - batch.target) / RANGE.bounds
    assert error.abs().max() < 0.15
    assert error.abs().mean() < 0.03


@pytest.mark.parametrize("dof", range(6))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_every_axis_is_found_with_its_sign(dof: int, sign: float) -> None:
    batch = batch_of(1)
    target = torch.zeros(1, 6)
    target[0, dof] = sign * 0.3 * RANGE.bounds[dof]
    batch = batch._replace(target=target, T_init=decalibrate(T[None], target))
    found = truthful(1).pose(batch) / RANGE.bounds
    torch.testing.assert_close(found, target / RANGE.bounds, atol=0.05, rtol=0.0)


def test_finer_rounds_come_nearer() -> None:
    batch, subject = batch_of(4), truthful(4)
    errors = []
    for many in (1, 2, 6):
        state = subject.align(batch, many)
        errors.append((state.pose - batch.target / RANGE.bounds).abs().mean().item())
    assert errors[0] > errors[1] > errors[2]


class Overconfident(Truthful):
    """Coarse curves that are sure of a place far from the true one, as what frames share is."""

    def curves(
        self, read: Tensor, edges: Tensor, K: Tensor, projected: ProjectedEdges, level: int
    ) -> tuple[Tensor, Tensor]:
        curves, weights = super().curves(read, edges, K, projected, level)
        return (curves.roll(2, -1), weights) if level == 0 else (curves, weights)


def test_a_reach_leads_back_from_where_coarse_rounds_were_surely_wrong() -> None:
    batch = batch_of(6)
    errors = []
    for reaches in (None, [1.0, 0.6, 0.3]):
        network: EvidenceNetwork = Overconfident(0.3, 6)  # type: ignore[assignment]
        made = AlignmentEstimator(network, RANGE.bounds, [4, 1, 1], LEARNING, reaches=reaches)
        nn.init.constant_(made.last.log_blur, -3.0)
        nn.init.zeros_(made.last.log_share)
        errors.append(((made.pose(batch) - batch.target) / RANGE.bounds).abs().mean().item())
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("reaches", [[1.0, 0.5], [1.0, 0.5, 0.0], [1.5, 0.5, 0.2]])
def test_reaches_must_fit_the_rounds(reaches: list[float]) -> None:
    network = learner().last.network
    with pytest.raises(ConfigurationError, match=r"model\.reaches=.* for each of model\.rounds"):
        AlignmentEstimator(network, RANGE.bounds, [4, 2, 1], LEARNING, reaches=reaches)


def test_without_edges_the_prior_answers() -> None:
    batch = batch_of(2)
    batch = batch._replace(edges=torch.full_like(batch.edges, torch.nan))
    state = truthful(2).align(batch, 3)
    assert (state.pose == 0).all()
    torch.testing.assert_close(state.covariance, (torch.eye(6) / PRIOR).expand(2, 6, 6))


def test_the_prior_is_on_the_total_decalibration() -> None:
    state = State(torch.full((1, 6), 0.7), torch.eye(6)[None])
    after = AlignmentEstimator.solve(torch.zeros(1, 27), state)
    torch.testing.assert_close(after.pose, torch.zeros(1, 6))
    far = pack(1e4 * torch.eye(6)[None], torch.full((1, 6), 1e5))
    assert (AlignmentEstimator.solve(far, state).pose == BEYOND).all()


def test_eight_copies_of_a_frame_have_an_eighth_of_the_covariance() -> None:
    one, subject = batch_of(1), truthful(8)
    eight = one._replace(
        x=one.x.repeat(8, 1, 1, 1),
        inverse_depth=one.inverse_depth.repeat(8, 1, 1, 1),
        K=one.K.repeat(8, 1, 1),
        T_init=one.T_init.repeat(8, 1, 1),
        frames=one.frames * 8,
        unit=torch.zeros(8, dtype=torch.int64),
        edges=one.edges.repeat(8, 1, 1),
    )
    alone = truthful(1)
    question = alone.question(one)
    packed = alone.repeated(*question.arguments)
    fused = subject.fuse(packed.repeat(8, 1), eight.unit, 1)
    # Without the prior, whose share does not grow.
    covariances = [torch.linalg.inv(unpack(each)[0]) for each in (packed, fused)]
    torch.testing.assert_close(covariances[1], covariances[0] / 8, rtol=1e-2, atol=1e-7)
    asked = subject.question(eight)
    answer = subject.answer(subject.repeated(*asked.arguments)[None], eight, asked)
    single = alone.answer(packed[None], one, question)
    assert answer.samples.shape == (1, 1, 6)
    assert answer.covariance is not None
    assert single.covariance is not None
    ratio = answer.covariance.diagonal(dim1=1, dim2=2) / single.covariance.diagonal(dim1=1, dim2=2)
    assert (ratio < 0.5).all()
    assert (ratio > 0.1).all()


def test_frames_count_for_their_own_unit() -> None:
    packed = torch.arange(4.0)[:, None].expand(4, 27)
    fused = AlignmentEstimator.fuse(packed, torch.tensor([0, 0, 1, 2]), 3)
    assert fused[:, 0].tolist() == [1.0, 2.0, 3.0]
    passes = AlignmentEstimator.fuse(packed.expand(5, 4, 27), torch.tensor([0, 1, 1, 1]), 2)
    assert passes.shape == (5, 2, 27)
    assert passes[3, :, 5].tolist() == [0.0, 6.0]


def test_the_answer_is_in_metres_and_radians() -> None:
    batch, subject = batch_of(3), truthful(3)
    question = subject.question(batch)
    output = subject.repeated(*question.arguments)
    answer = subject.answer(torch.stack([output, output]), batch, question)
    torch.testing.assert_close(answer.samples[0], subject.pose(batch), rtol=1e-4, atol=1e-7)
    assert answer.covariance is not None
    state = subject.align(batch, len(subject.rounds))
    expected = state.covariance * RANGE.bounds[:, None] * RANGE.bounds
    torch.testing.assert_close(answer.covariance, expected, rtol=1e-3, atol=1e-12)


def test_rows_do_not_influence_each_other_and_edges_have_no_order() -> None:
    batch, subject = batch_of(3, 60, SMALL), learner().eval()
    order = torch.tensor([2, 0, 1])
    shuffled = batch._replace(
        x=batch.x[order],
        K=batch.K[order],
        T_init=batch.T_init[order],
        target=batch.target[order],
        edges=batch.edges[order][:, torch.randperm(60)],
    )
    with torch.inference_mode():
        a, b = subject.pose(batch), subject.pose(shuffled)
        alone = subject.pose(first_of(batch))
    scale = RANGE.bounds
    torch.testing.assert_close(a[order] / scale, b / scale, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(a[:1] / scale, alone / scale, atol=1e-4, rtol=1e-4)


def test_the_loss_is_finite_and_reaches_every_parameter() -> None:
    batch, subject = batch_of(3, 60, SMALL), learner().train()
    batch.edges[:, 50:] = torch.nan
    loss = subject.loss(batch)
    assert loss.shape == ()
    assert loss.isfinite()
    loss.backward()  # type: ignore[no-untyped-call]
    for name, parameter in subject.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
    for name in ("last.log_share", "last.log_blur", "last.network.gain"):
        grad = subject.get_parameter(name).grad
        assert grad is not None
        assert (grad != 0).all(), name


def test_frames_without_edges_can_be_trained_on() -> None:
    batch, subject = batch_of(2, 20, SMALL), learner().train()
    loss = subject.loss(batch._replace(edges=torch.full_like(batch.edges, torch.nan)))
    loss.backward()  # type: ignore[no-untyped-call]
    assert loss.isfinite()
    grads = [p.grad for p in subject.parameters() if p.grad is not None]
    assert all(grad.isfinite().all() for grad in grads)


def test_every_strategy_of_stochastic_passes_gives_the_same_samples() -> None:
    batch, subject = batch_of(2, 60, SMALL), learner().eval()
    with torch.inference_mode():
        question = subject.question(batch)
    samples = {}
    for strategy in ("shared", "batch", "loop"):
        engine = MCDropout(subject.repeated, 4, strategy=strategy, keep_samples=True)
        found = engine(*question.arguments, seed=[7, 8]).samples
        assert found is not None
        samples[strategy] = subject.answer(found, batch, question).samples / RANGE.bounds
    for strategy in ("batch", "loop"):
        torch.testing.assert_close(samples[strategy], samples["shared"], atol=1e-4, rtol=1e-3)
    spread = samples["shared"].std(0)
    assert (spread > 0).all()


def test_dropout_takes_whole_blocks_of_the_image() -> None:
    batch, subject = batch_of(1, 300), learner(0.5)
    network = subject.last.network
    projected = project_edges(batch.edges, batch.K, batch.T_init, SIZE, RANGE.bounds)
    network.train()
    kept = network._kept(projected)[0]
    assert set(kept.tolist()) == {0.0, 2.0}
    block = (projected.pixels[0] / 24).long()
    for cell in block.unique(dim=0):  # type: ignore[no-untyped-call]
        assert len(kept[(block == cell).all(1)].unique()) == 1  # type: ignore[no-untyped-call]
    assert (network.eval()._kept(projected) == 1).all()


def test_an_untrained_network_aligns_edges_of_the_image() -> None:
    """A bright panel before a dark wall: its sides are where the fixed gradients say."""
    subject = learner().eval()
    network = subject.last.network
    for perceptron in network.queries:
        nn.init.zeros_(perceptron[-1].weight)  # type: ignore[index]
    x = torch.zeros(1, 5, *SIZE)
    x[..., 20:60, 50:150] = 1.0
    edges = torch.zeros(1, 40, len(COLUMNS))
    edges[..., STRENGTH] = 0.5
    rows = torch.linspace(25, 55, 20).repeat(2)
    columns = torch.tensor([49.5, 149.5]).repeat_interleave(20)
    rays = torch.stack([columns, rows, torch.ones(40)], -1) @ torch.linalg.inv(K).T
    edges[0, :, :3] = (torch.cat([10 * rays, torch.ones(40, 1)], -1) @ torch.linalg.inv(T).T)[:, :3]
    with torch.inference_mode():
        maps = network.describe(x)
        for level, stride in enumerate(STRIDES):
            projected = project_edges(edges, K[None], T[None], SIZE, RANGE.bounds)
            read = network.read(maps, projected, level)
            curves, weights = network.curves(read, edges, K[None], projected, level)
            offsets = offsets_of(stride, network.reach[level], curves)
            mean = (curves.softmax(-1) * offsets).sum(-1)
            assert (weights == 1).all()
            assert mean.abs().max() < 0.5 * stride


@pytest.mark.parametrize("rounds", [[], [4, 2], [8, 1], [1, 2]])
def test_rounds_at_scales_that_are_not_there_are_refused(rounds: list[int]) -> None:
    with pytest.raises(ConfigurationError, match=r"model\.rounds"):
        AlignmentEstimator(learner().last.network, RANGE.bounds, rounds, LEARNING)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"image_edges": "max"}, "image_edges"),
        ({"widths": [8, 8]}, "widths"),
        ({"window": 0}, "window"),
    ],
)
def test_settings_of_the_network_out_of_range_are_refused(
    changes: dict[str, object], named: str
) -> None:
    settings: dict[str, object] = {
        "in_channels": 5,
        "camera_channels": 3,
        "image_edges": "mean",
        "window": 5,
        "widths": [8, 8, 8],
        "features": 4,
        "reach": [3, 4, 4],
        "channel_dropout": 0.1,
        "evidence_dropout": 0.1,
    }
    with pytest.raises(ConfigurationError, match=named):
        EvidenceNetwork(**settings | changes)  # type: ignore[arg-type]


def test_cross_entropy_by_hand() -> None:
    curves = torch.log(torch.tensor([[[0.1, 0.2, 0.4, 0.2, 0.1]]])).expand(1, 4, 5)
    offset = torch.tensor([[2.0, 1.0, 7.0, 0.0]])  # a cell; half a cell; beyond; not seen
    seen = torch.tensor([[1.0, 1.0, 1.0, 0.0]])
    one, half = torch.tensor(0.2).log(), torch.tensor([0.2, 0.4]).log().mean()
    torch.testing.assert_close(cross_entropy(curves, offset, seen, stride=2), -(one + half) / 2)
    assert cross_entropy(curves, offset, 0 * seen, stride=2) == 0


def test_surprise_by_hand() -> None:
    state = State(torch.zeros(1, 6), 4.0 * torch.eye(6)[None])
    truth = torch.tensor([[2.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    expected = (0.5 + 6 * torch.tensor(2.0).log()) / 6
    torch.testing.assert_close(surprise(state, truth), expected)
    assert surprise(state, 100 * truth) == 8.0


class Elsewhere(nn.Module):
    """A start that always answers the same."""

    def align(self, batch: NetworkInput, operators: Operators) -> State:
        pose = torch.linspace(-0.5, 0.5, 6).expand(len(batch.unit_index), 6)
        return State(pose, 0.09 * torch.eye(6).expand(len(pose), 6, 6))


def test_without_evidence_the_estimate_is_the_start() -> None:
    network: EvidenceNetwork = Truthful(1.0, 2)  # type: ignore[assignment]
    start: EdgeAlignmentEstimator = Elsewhere()  # type: ignore[assignment]
    made = AlignmentEstimator(network, RANGE.bounds, [1, 1], LEARNING, start, start_inflation=2.0)
    batch = batch_of(2)
    state = made.align(batch._replace(edges=batch.edges * float("nan")), len(made.rounds))
    torch.testing.assert_close(state.pose, torch.linspace(-0.5, 0.5, 6).expand(2, 6))
    torch.testing.assert_close(state.covariance, 0.18 * torch.eye(6).expand(2, 6, 6))


def test_evidence_leads_away_from_the_start() -> None:
    network: EvidenceNetwork = Truthful(1.0, 8)  # type: ignore[assignment]
    start: EdgeAlignmentEstimator = Elsewhere()  # type: ignore[assignment]
    made = AlignmentEstimator(
        network, RANGE.bounds, [4, 2, 1], LEARNING, start, start_inflation=3.0
    )
    nn.init.zeros_(made.last.log_share)
    batch = batch_of(8)
    error = (made.pose(batch) - batch.target) / RANGE.bounds
    from_start = torch.linspace(-0.5, 0.5, 6) - batch.target / RANGE.bounds
    assert error.abs().mean() < 0.1 * from_start.abs().mean()


def test_the_starts_covariance_is_not_deflated() -> None:
    with pytest.raises(ConfigurationError, match=r"model\.start\.inflation=0.5"):
        AlignmentEstimator(learner().last.network, RANGE.bounds, [1], LEARNING, None, 0.5)


@pytest.mark.parametrize(
    "given",
    [
        ([0.2], [1.0, 0.7, 0.44], 1.0, 0.1),
        ([0.2, 0.1, 0.0], [1.0, 0.7, 0.44], 1.0, 0.1),
        ([0.2, 0.1, 0.5], [1.0, 0.7, 0.44], 1.0, 0.1),
        ([0.2, 0.1, 0.04], [2.0, 0.7, 0.44], 1.0, 0.1),
        ([0.2, 0.1, 0.04], [1.0, 0.7, 0.44], -1.0, 0.1),
    ],
)
def test_what_a_scale_is_trained_with_is_checked_before_the_first_step(
    given: tuple[list[float], list[float], float, float],
) -> None:
    with pytest.raises(ConfigurationError, match=r"model\.learning: .* expected 3 numbers each"):
        LearningSettings(*given)
