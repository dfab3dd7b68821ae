from pathlib import Path
from typing import cast
from unittest.mock import patch

import lightning
import pytest
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from uncal.data.network_input import NetworkInput
from uncal.edges.sweep import COLUMNS, KIND, KINDS
from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES
from uncal.geometry.decalibration import DecalibrationRange
from uncal.models.alignment import AlignmentEstimator, LearningSettings
from uncal.models.answer import Estimator
from uncal.models.estimator import PoseEstimator
from uncal.models.evidence import EvidenceNetwork
from uncal.models.heads import DisplacementHead, PoseHead, QuantileHead
from uncal.models.losses import displacement_loss, pose_loss, relative_error
from uncal.models.mobilevit import MobileViT
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import SPREADS, SplitPrediction, frame_seed, pass_names
from uncal.models.unical import UniCal
from uncal.recordings.frame import FrameId
from uncal.uncertainty import ConformalCalibrator, MCDropout
from uncal.uncertainty.dropout.pass_memory import PassMemory

RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)


def unical(head: str) -> UniCal:
    def make_backbone(channels: int) -> nn.Module:
        return MobileViT(channels, [24, 24, 24], [8, 8, 8, 16, 16, 24, 32], 2.0, 16, 0.25, None)

    def make_head(channels: object) -> nn.Module:
        assert isinstance(channels, tuple)
        if head == "mlp":
            return PoseHead(channels, [16], 0.05)
        if head == "quantile":
            return QuantileHead(channels, [16], 0.05)
        return DisplacementHead(channels, 16, len(channels) - 2, 0.05)

    return UniCal(5, make_backbone, make_head)


def alignment() -> AlignmentEstimator:
    network = EvidenceNetwork(
        in_channels=5,
        camera_channels=3,
        image_edges="mean",
        window=7,
        widths=[8, 12, 16],
        features=4,
        reach=[4, 4, 4],
        channel_dropout=0.25,
        evidence_dropout=0.05,
    )
    learning = LearningSettings([0.2, 0.1, 0.04], [1.0, 0.7, 0.44], 1.0, 0.1)
    return AlignmentEstimator(network, RANGE.bounds, [4, 2, 1], learning)


def estimator(kind: str) -> nn.Module:
    """The edges' estimator, or one around a network with a head of that name."""
    return alignment() if kind == "edges" else around(unical(kind))


def around(network: nn.Module) -> PoseEstimator:
    return PoseEstimator(
        network, RANGE.bounds, ridge=0.1, displacement_weight=0.5, quantile_levels=(0.05, 0.95)
    )


def network_input(batch: int) -> NetworkInput:
    torch.manual_seed(0)
    inverse_depth = torch.rand(batch, 1, 64, 96) * 0.2
    K = torch.tensor([[90.0, 0.0, 48.0], [0.0, 90.0, 32.0], [0.0, 0.0, 1.0]]).expand(batch, 3, 3)
    T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    x = torch.cat([torch.randn(batch, 3, 64, 96), inverse_depth, torch.rand(batch, 1, 64, 96)], 1)
    edges = torch.rand(batch, 40, len(COLUMNS))
    direction = torch.cat([torch.ones(batch, 40, 1), edges[..., 1:3] * 0.8 - 0.4], -1)
    edges[..., :3] = direction * (4.0 + 20.0 * edges[..., :1])
    edges[..., KIND] = torch.arange(40) % len(KINDS)
    edges[:, 35:] = torch.nan
    return NetworkInput(
        x=x,
        inverse_depth=inverse_depth,
        K=K,
        T_init=T.expand(batch, 4, 4),
        target=RANGE.draw(batch),
        unit_index=torch.arange(batch),
        frames=[FrameId("rig", "drive", i) for i in range(batch)],
        unit=torch.arange(batch),
        edges=edges,
    )


def module(estimator: nn.Module, fixed_masks: bool = False) -> CalibrationModule:
    return CalibrationModule(
        estimator=estimator,
        optimizer=lambda parameters: torch.optim.AdamW(parameters, lr=3e-3),
        warmup_fraction=0.1,
        engine=lambda network, masks: MCDropout(network, 5, masks=masks),
        spread="dropout",
        fixed_masks=fixed_masks,
        calibrator=ConformalCalibrator(DOF_NAMES, 1e-9),
        groups="rig",
        mask_seed=0,
    )


def inside(subject: CalibrationModule) -> Estimator:
    return cast(Estimator, subject.estimator)


@pytest.mark.parametrize("kind", ["edges", "geometric", "mlp", "quantile"])
def test_every_network_trains_and_is_uncertain(kind: str) -> None:
    batch = network_input(3)
    subject = module(estimator(kind))
    inside(subject).loss(batch).backward()  # type: ignore[no-untyped-call]
    assert subject(batch).shape == (3, 6)
    network = inside(subject).repeated.get_submodule("network")
    silent = [n for n, p in network.named_parameters() if p.grad is None]
    assert not silent
    prediction = subject.stochastic(batch, "test")
    # An untrained network's features can vanish beside the biases of its head.
    assert (prediction.std > 0).float().mean() > 0.8
    assert [strategy for strategy, _ in subject.engine.plan().values()] == ["shared"]
    bounds = prediction.bounds
    assert (bounds is not None) == (kind == "quantile")
    if bounds is not None:
        assert (bounds[0] < prediction.mean).all()
        assert (bounds[1] > prediction.mean).all()


@pytest.mark.parametrize("kind", ["edges", "geometric"])
def test_sharing_what_no_dropout_reaches_changes_nothing(kind: str) -> None:
    batch = network_input(2)
    subject = module(estimator(kind)).eval()
    question = inside(subject).question(batch)
    looped = MCDropout(inside(subject).repeated, 5, strategy="loop", keep_samples=True)
    seeds = [frame_seed(0, "test", frame) for frame in batch.frames]
    samples = looped(*question.arguments, seed=seeds).samples
    assert samples is not None
    a = inside(subject).answer(samples, batch, question).samples
    b = subject.stochastic(batch, "test")
    torch.testing.assert_close(a.mean(0), b.mean, rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(a.std(0, correction=0), b.std, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("kind", ["edges", "geometric"])
@pytest.mark.parametrize("fixed_masks", [False, True])
def test_a_frame_gets_the_same_interval_in_any_batch(kind: str, fixed_masks: bool) -> None:
    batch = network_input(3)
    subject = module(estimator(kind), fixed_masks)
    together = subject.stochastic(batch, "test")
    alone = batch._replace(
        x=batch.x[2:],
        inverse_depth=batch.inverse_depth[2:],
        K=batch.K[2:],
        T_init=batch.T_init[2:],
        target=batch.target[2:],
        unit_index=batch.unit_index[2:],
        frames=batch.frames[2:],
        unit=torch.zeros(1).long(),
        edges=batch.edges[2:],
    )
    one = subject.stochastic(alone, "test")
    torch.testing.assert_close(one.std[0], together.std[2], rtol=1e-3, atol=1e-6)
    other = subject.stochastic(batch, "validation")
    assert torch.equal(other.std, together.std) == fixed_masks
    assert ("masks.seed" in subject.state_dict()) == fixed_masks


@pytest.mark.parametrize("kind", ["edges", "geometric"])
def test_stochastic_passes_leave_the_module_as_it_was(kind: str) -> None:
    batch = network_input(2)
    subject = module(estimator(kind)).train()
    before = {key: value.clone() for key, value in subject.state_dict().items()}
    training = subject.stochastic(batch, "test")
    assert all(m.training for m in subject.estimator.modules())
    for key, value in subject.state_dict().items():
        assert torch.equal(value, before[key]), key
    evaluated = subject.eval().stochastic(batch, "test")
    assert torch.equal(training.mean, evaluated.mean)


def test_prediction_by_a_trainer_is_stochastic_and_the_same_as_in_a_test(tmp_path: Path) -> None:
    """A trainer puts a network into evaluation mode, in which plain dropout is silent: σ = 0."""
    subject, batch = module(alignment()), network_input(2)
    trainer = lightning.Trainer(
        accelerator="cpu",
        logger=False,
        enable_progress_bar=False,
        default_root_dir=str(tmp_path),
    )
    with patch.object(subject, "transfer_batch_to_device", lambda batch, *_: batch):
        loader: DataLoader[object] = DataLoader([batch], batch_size=None)  # type: ignore[arg-type]
        predicted = trainer.predict(subject, loader)
    assert predicted is not None
    (found,) = cast("list[SplitPrediction]", predicted)
    assert (found.std > 0).all()
    assert torch.equal(found.std, subject.stochastic(batch, "test").std)


def test_a_few_steps_overfit_one_batch() -> None:
    batch = network_input(4)
    subject = module(estimator("geometric"))
    optimizer = subject.make_optimizer(subject.parameters())
    losses = []
    for _ in range(60):
        optimizer.zero_grad()
        loss = inside(subject).loss(batch)
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        losses.append(loss.item())
    assert min(losses[-10:]) < 0.6 * losses[0]


class Constant(nn.Module):
    def __init__(self, shape: tuple[int, ...]) -> None:
        super().__init__()
        self.shape = shape

    def forward(self, x: Tensor) -> Tensor:
        return torch.full((x.shape[0], *self.shape), 0.5)


def test_six_numbers_are_in_units_of_the_range() -> None:
    subject = around(Constant((6,)))
    torch.testing.assert_close(subject(*network_input(2)[:4]), 0.5 * RANGE.bounds.expand(2, 6))


def test_any_other_shape_is_refused() -> None:
    subject = around(Constant((7,)))
    with pytest.raises(ValueError, match=r"\(2, 7\)"):
        subject(*network_input(2)[:4])


def test_mask_seeds_differ_by_run_split_and_frame() -> None:
    frames = [FrameId("rig", "drive", i) for i in range(2)]
    seeds = {frame_seed(s, split, f) for s in (0, 1) for split in ("test", "train") for f in frames}
    assert len(seeds) == 8
    assert frame_seed(0, "test", frames[1]) == frame_seed(0, "test", FrameId("rig", "drive", 1))


def test_losses_by_hand() -> None:
    bounds = torch.tensor([0.1] * 6)
    estimate = torch.tensor([[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]])
    # One DoF off by one range: |1| - 0.2/2 = 0.9, over six DoF.
    assert pose_loss(estimate, torch.zeros(1, 6), bounds).item() == pytest.approx(0.15)
    flow = torch.tensor([[[1.0, 0.0], [50.0, 0.0], [7.0, 7.0]]])
    seen = torch.tensor([[1.0, 1.0, 0.0]])
    assert displacement_loss(flow, torch.zeros(1, 3, 2), seen).item() == pytest.approx(21 / 4)
    ratio = relative_error(torch.full((4, 6), 0.5), torch.ones(4, 6))
    assert ratio.tolist() == [0.5] * 6


@pytest.mark.parametrize("kind", ["edges", "geometric"])
def test_passes_that_are_known_are_not_run_again(kind: str, tmp_path: Path) -> None:
    subject, batch = module(estimator(kind)), network_input(3)
    subject.eval()
    whole = subject.stochastic(batch, "test")
    runs: list[int] = []
    for passes in (2, 5, 3):
        subject.engine.passes = passes
        memory = PassMemory(tmp_path, passes)
        subject.remember(memory)
        with patch.object(subject.engine, "_sampler", wraps=subject.engine._sampler) as sampler:
            found = subject.stochastic(batch, "test")
        runs += [passes - call.args[2] for call in sampler.call_args_list]
        memory.save()
        known = memory.recall("test", [str(frame) for frame in batch.frames])
        assert known is not None
        assert len(known) == passes
        if passes == 5:
            torch.testing.assert_close(found.mean, whole.mean, rtol=1e-4, atol=1e-6)
            torch.testing.assert_close(found.std, whole.std, rtol=1e-3, atol=1e-6)
    assert runs == [2, 3]  # two, three more, and three of those five


def test_passes_of_a_window_are_not_those_of_its_frames(tmp_path: Path) -> None:
    subject, batch = module(alignment()).eval(), network_input(3)
    units = torch.tensor([0, 0, 1])
    window = batch._replace(unit=units, unit_index=torch.arange(2), target=batch.target[:2])
    expected = subject.stochastic(window, "test")
    memory = PassMemory(tmp_path, 5)
    subject.remember(memory)
    subject.stochastic(batch, "test")
    found = subject.stochastic(window, "test")
    torch.testing.assert_close(found.mean, expected.mean, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(found.std, expected.std, rtol=1e-3, atol=1e-6)
    # The third frame is alone both times.
    assert memory.computed == {"test": 3 + 3}
    assert len(set(pass_names(batch)) & set(pass_names(window))) == 1
    again = subject.stochastic(window, "test")
    assert memory.recalled == {"test": 3}
    assert torch.equal(again.mean, found.mean)


@pytest.mark.parametrize("spread", SPREADS)
def test_each_spread_is_positive_and_only_a_solver_knows_its_own(spread: str) -> None:
    batch = network_input(3)
    subject, blind = module(alignment()).eval(), module(estimator("mlp")).eval()
    parts = {}
    for each in SPREADS:
        subject.spread = each
        parts[each] = subject.stochastic(batch, "test")
    found = parts[spread]
    assert found.covariance.shape == (3, 6, 6)
    assert (found.std > 0).all()
    torch.testing.assert_close(found.covariance.diagonal(dim1=1, dim2=2), found.std**2)
    total = parts["dropout"].std ** 2 + parts["solver"].std ** 2
    torch.testing.assert_close(parts["total"].std ** 2, total)
    blind.spread = spread
    if spread == "dropout":
        assert (blind.stochastic(batch, "test").std > 0).any()
    else:
        with pytest.raises(ConfigurationError, match="model/backbone=edges"):
            blind.stochastic(batch, "test")


def test_a_network_without_normal_equations_refuses_windows() -> None:
    batch = network_input(3)
    window = batch._replace(unit=torch.zeros(3).long(), unit_index=torch.arange(1))
    with pytest.raises(ConfigurationError, match=r"window\.frames"):
        module(estimator("mlp"))(window)
