from pathlib import Path
from unittest.mock import patch

import pytest
import torch
from torch import Tensor, nn

from uncal.data.network_input import NetworkInput
from uncal.decalibration import DecalibrationRange
from uncal.geometry import DOF_NAMES
from uncal.models.estimator import PoseEstimator
from uncal.models.heads import DisplacementHead, PoseHead, QuantileHead
from uncal.models.losses import displacement_loss, pose_loss, relative_error
from uncal.models.mobilevit import CorrelationMobileViT, MobileViT
from uncal.models.module import CalibrationModule
from uncal.models.prediction import SplitPrediction, frame_seed
from uncal.models.unical import UniCal
from uncal.recordings.frame import FrameId
from uncal.uncertainty import ConformalCalibrator, MCDropout
from uncal.uncertainty.pass_memory import PassMemory

RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)


def unical(backbone: str, head: str) -> UniCal:
    def make_backbone(channels: int) -> nn.Module:
        if backbone == "correlation":
            return CorrelationMobileViT(
                channels, 3, 1, [8, 16, 16], [16, 16, 24], [16, 24], [1, 1], 2.0, 0.25
            )
        return MobileViT(channels, [24, 24, 24], [8, 8, 8, 16, 16, 24, 32], 2.0, 16, 0.25, None)

    def make_head(channels: object) -> nn.Module:
        assert isinstance(channels, tuple)
        if head == "mlp":
            return PoseHead(channels, [16], 0.05)
        if head == "quantile":
            return QuantileHead(channels, [16], 0.05)
        return DisplacementHead(channels, 16, len(channels) - 2, 0.05)

    return UniCal(5, make_backbone, make_head)


def network_input(batch: int) -> NetworkInput:
    torch.manual_seed(0)
    inverse_depth = torch.rand(batch, 1, 64, 96) * 0.2
    K = torch.tensor([[90.0, 0.0, 48.0], [0.0, 90.0, 32.0], [0.0, 0.0, 1.0]]).expand(batch, 3, 3)
    T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    x = torch.cat([torch.randn(batch, 3, 64, 96), inverse_depth, torch.rand(batch, 1, 64, 96)], 1)
    frames = [FrameId("rig", "drive", i) for i in range(batch)]
    places = torch.arange(batch)
    T_init = T.expand(batch, 4, 4)
    return NetworkInput(x, inverse_depth, K, T_init, RANGE.draw(batch), places, frames)


def module(network: nn.Module, fixed_masks: bool = False) -> CalibrationModule:
    return CalibrationModule(
        network=network,
        decalibration=RANGE,
        optimizer=lambda parameters: torch.optim.AdamW(parameters, lr=3e-3),
        warmup_fraction=0.1,
        displacement_weight=0.5,
        ridge=0.1,
        quantile_levels=(0.05, 0.95),
        engine=lambda network, masks: MCDropout(network, 5, masks=masks),
        fixed_masks=fixed_masks,
        calibrator=ConformalCalibrator(DOF_NAMES, 1e-9),
        groups="rig",
        mask_seed=0,
    )


@pytest.mark.parametrize("backbone", ["correlation", "mobilevit"])
@pytest.mark.parametrize("head", ["geometric", "mlp", "quantile"])
def test_every_backbone_works_with_every_head(backbone: str, head: str) -> None:
    batch = network_input(3)
    subject = module(unical(backbone, head))
    loss, pose = subject.loss(batch)
    loss.backward()  # type: ignore[no-untyped-call]
    assert pose.shape == (3, 6)
    network = subject.estimator.network
    silent = [n for n, p in network.named_parameters() if p.grad is None]
    assert not silent
    prediction = subject.stochastic(batch, "test")
    # An untrained network's features can vanish beside the biases of its head.
    assert (prediction.std > 0).float().mean() > 0.8
    assert [strategy for strategy, _ in subject.engine.plan().values()] == ["shared"]
    bounds = SplitPrediction.of(prediction, batch).bounds
    assert (bounds is not None) == (head == "quantile")
    if bounds is not None:
        assert (bounds[0] < prediction.mean[:, :6]).all()
        assert (bounds[1] > prediction.mean[:, :6]).all()


def test_sharing_what_no_dropout_reaches_changes_nothing() -> None:
    batch = network_input(2)
    subject = module(unical("correlation", "geometric")).eval()
    looped = MCDropout(subject.estimator, 5, strategy="loop")
    seeds = [frame_seed(0, "test", frame) for frame in batch.frames]
    a, b = looped(*batch[:4], seed=seeds), subject.stochastic(batch, "test")
    torch.testing.assert_close(a.mean, b.mean, rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(a.std, b.std, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("fixed_masks", [False, True])
def test_a_frame_gets_the_same_interval_in_any_batch(fixed_masks: bool) -> None:
    batch = network_input(3)
    subject = module(unical("correlation", "geometric"), fixed_masks)
    together = subject.stochastic(batch, "test")
    x, inverse_depth, K, T_init, target, place, frames = batch
    alone = NetworkInput(
        x[2:], inverse_depth[2:], K[2:], T_init[2:], target[2:], place[2:], frames[2:]
    )
    one = subject.stochastic(alone, "test")
    torch.testing.assert_close(one.std[0], together.std[2], rtol=1e-3, atol=1e-6)
    other = subject.stochastic(batch, "validation")
    assert torch.equal(other.std, together.std) == fixed_masks
    assert ("masks.seed" in subject.state_dict()) == fixed_masks


def test_stochastic_passes_leave_the_module_as_it_was() -> None:
    batch = network_input(2)
    subject = module(unical("correlation", "geometric")).train()
    before = {key: value.clone() for key, value in subject.state_dict().items()}
    subject.stochastic(batch, "test")
    assert all(m.training for m in subject.estimator.modules())
    for key, value in subject.state_dict().items():
        assert torch.equal(value, before[key]), key


def test_a_few_steps_overfit_one_batch() -> None:
    batch = network_input(4)
    subject = module(unical("correlation", "geometric"))
    optimizer = subject.make_optimizer(subject.parameters())
    losses = []
    for _ in range(60):
        optimizer.zero_grad()
        loss, _ = subject.loss(batch)
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
    estimator = PoseEstimator(Constant((6,)), RANGE.bounds, 0.1)
    torch.testing.assert_close(estimator(*network_input(2)[:4]), 0.5 * RANGE.bounds.expand(2, 6))


def test_any_other_shape_is_refused() -> None:
    estimator = PoseEstimator(Constant((7,)), RANGE.bounds, 0.1)
    with pytest.raises(ValueError, match=r"\(2, 7\)"):
        estimator(*network_input(2)[:4])


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


def test_passes_that_are_known_are_not_run_again(tmp_path: Path) -> None:
    subject, batch = module(unical("correlation", "geometric")), network_input(3)
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
        assert found.passes == passes
        if passes == 5:
            torch.testing.assert_close(found.mean, whole.mean, rtol=1e-4, atol=1e-6)
            torch.testing.assert_close(found.std, whole.std, rtol=1e-3, atol=1e-6)
    assert runs == [2, 3]  # two, three more, and three of those five
