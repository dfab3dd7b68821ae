"""loop, batch and shared on networks that the engine was not written for."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F
from transformers import ResNetConfig, ResNetModel, ViTConfig, ViTModel

from uncal.uncertainty import FixedMasks, MCDropout, UncertaintyError, insert_dropout


class ImageTransformer(nn.Module):
    """A ViT whose dropout is everywhere; its outputs are dataclasses."""

    def __init__(self) -> None:
        super().__init__()
        self.body = ViTModel(
            ViTConfig(
                hidden_size=16,
                num_hidden_layers=2,
                num_attention_heads=2,
                intermediate_size=32,
                image_size=16,
                patch_size=4,
                hidden_dropout_prob=0.2,
            ),
            add_pooling_layer=False,
        )
        self.head = nn.Linear(16, 6)

    def forward(self, image: Tensor) -> Tensor:
        return cast(Tensor, self.head(self.body(image).last_hidden_state[:, 0]))


class ResidualNetwork(nn.Module):
    """A frozen ResNet (BatchNorm, outputs in a dataclass) and dropout in the head alone."""

    def __init__(self) -> None:
        super().__init__()
        self.body = ResNetModel(
            ResNetConfig(embedding_size=8, hidden_sizes=[8, 16], depths=[1, 1], layer_type="basic")
        )
        self.head = nn.Sequential(nn.Dropout(0.3), nn.Linear(16, 8), nn.Dropout(0.1))
        self.calls = 0
        self.body.register_forward_pre_hook(self._count)

    def _count(self, *_: object) -> None:
        self.calls += 1

    def forward(self, image: Tensor) -> Tensor:
        return cast(Tensor, self.head(self.body(image).pooler_output.flatten(1)))


class UNet(nn.Module):
    """Skip connections around the dropout, operations in place, whole channels dropped."""

    def __init__(self) -> None:
        super().__init__()
        self.down = nn.Sequential(nn.Conv2d(3, 8, 3, padding=1), nn.ReLU(inplace=True))
        self.deep = nn.Sequential(
            nn.Conv2d(8, 8, 3, stride=2, padding=1), nn.ReLU(inplace=True), nn.Dropout2d(0.3)
        )
        self.side = nn.Conv2d(3, 4, 1)  # of the input, used behind the dropout
        self.up = nn.Conv2d(20, 8, 3, padding=1)
        self.norm = nn.BatchNorm2d(8)
        self.head = nn.Linear(8, 6)

    def forward(self, image: Tensor) -> Tensor:
        fine = self.down(image)
        coarse = F.interpolate(self.deep(fine), scale_factor=2.0)
        merged = torch.cat([fine, coarse, self.side(image)], 1)
        return cast(Tensor, self.head(F.relu(self.norm(self.up(merged))).mean((2, 3))))


class SequenceFirst(nn.Module):
    """torch's transformer with the batch as second dimension, two inputs, one of them whole."""

    def __init__(self) -> None:
        super().__init__()
        layer = nn.TransformerEncoderLayer(8, 2, dim_feedforward=16, dropout=0.2)
        self.embed = nn.Linear(3, 8)
        self.encoder = nn.TransformerEncoder(layer, 2, enable_nested_tensor=False)
        self.head = nn.Linear(8, 6)

    def forward(self, sequence: Tensor, scale: Tensor) -> Tensor:
        tokens = self.embed(sequence * scale).transpose(0, 1)
        return cast(Tensor, self.head(self.encoder(tokens).mean(0)))


class WithoutDropout(nn.Module):
    """Dropout put in after convolutions, an attention and a linear layer."""

    def __init__(self) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(3, 8, 4, stride=4)
        self.attention = nn.MultiheadAttention(8, 2, batch_first=True)
        self.hidden, self.head = nn.Linear(8, 16), nn.Linear(16, 6)
        insert_dropout(
            self, ["Conv2d", "MultiheadAttention", "Linear"], 0.2, exclude=["head", "*.out_proj"]
        )

    def forward(self, image: Tensor) -> Tensor:
        tokens = self.convolution(image).flatten(2).transpose(1, 2)
        attended, _ = self.attention(tokens, tokens, tokens)
        return cast(Tensor, self.head(F.relu(self.hidden(attended.mean(1)))))


def images(batch: int) -> tuple[Tensor, ...]:
    return (torch.randn(batch, 3, 16, 16),)


def sequences(batch: int) -> tuple[Tensor, ...]:
    return torch.randn(batch, 5, 3), torch.rand(5, 3)


NETWORKS: dict[str, tuple[Callable[[], nn.Module], Callable[[int], tuple[Tensor, ...]]]] = {
    "ViT": (ImageTransformer, images),
    "ResNet": (ResidualNetwork, images),
    "U-Net": (UNet, images),
    "sequence first": (SequenceFirst, sequences),
    "inserted": (WithoutDropout, images),
}


def made(name: str, batch: int) -> tuple[nn.Module, tuple[Tensor, ...]]:
    torch.manual_seed(0)
    network, inputs = NETWORKS[name]
    return network(), inputs(batch)


def samples(engine: MCDropout, inputs: tuple[Tensor, ...], seed: int = 3) -> Tensor:
    engine.keep_samples = True
    result = engine(*inputs, seed=seed).samples
    assert result is not None
    return result


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("batch", [1, 3])
def test_all_strategies_and_chunks_give_the_same_samples(
    name: str, fixed: bool, batch: int
) -> None:
    network, inputs = made(name, batch)
    masks = FixedMasks(5) if fixed else None
    loop = samples(MCDropout(network, 6, strategy="loop", masks=masks), inputs)
    assert (loop.std(0) > 0).all()
    for strategy in ("batch", "shared"):
        for chunk in (None, 1, 4, "auto"):
            engine = MCDropout(network, 6, chunk, strategy=strategy, masks=masks)
            torch.testing.assert_close(samples(engine, inputs), loop, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", NETWORKS)
def test_auto_shares(name: str) -> None:
    network, inputs = made(name, 2)
    engine = MCDropout(network, 5)
    engine(*inputs)
    assert [strategy for strategy, _ in engine.plan().values()] == ["shared"]


@pytest.mark.parametrize("name", NETWORKS)
def test_the_network_comes_back_as_it_was(name: str) -> None:
    network, inputs = made(name, 2)
    network.train()
    state = {key: value.clone() for key, value in network.state_dict().items()}
    forwards = [module.__dict__.get("forward") for module in network.modules()]
    MCDropout(network, 4)(*inputs)
    assert all(module.training for module in network.modules())
    assert forwards == [module.__dict__.get("forward") for module in network.modules()]
    for key, value in network.state_dict().items():
        assert torch.equal(value, state[key]), key


def test_what_lies_before_the_first_dropout_runs_once() -> None:
    network, inputs = made("ResNet", 2)
    assert isinstance(network, ResidualNetwork)
    rows: list[int] = []
    network.body.embedder.register_forward_hook(lambda _, args, __: rows.append(len(args[0])))
    engine = MCDropout(network, 25, strategy="shared")
    engine(*inputs)
    rows.clear()
    engine(*inputs)
    assert rows == [2]


def test_one_pass_is_what_torch_itself_computes_with_that_mask() -> None:
    # 1 where kept: the mask read off a dropout layer is applied by hand.
    torch.manual_seed(0)
    network = nn.Sequential(nn.Linear(4, 8), nn.Dropout(0.5), nn.Linear(8, 2))
    x = torch.randn(1, 4)
    engine = MCDropout(network, 3, masks=FixedMasks(0), keep_samples=True)
    result = engine(x).samples
    masks = FixedMasks(0).of("1", 0, 3, 8, 0.5)
    assert set(masks.flatten().tolist()) == {0.0, 2.0}
    expected = network[2](network[0](x) * masks)
    assert result is not None
    torch.testing.assert_close(result[:, 0], expected)


def test_row_seeds_make_a_row_independent_of_its_batch() -> None:
    network, (x,) = made("U-Net", 4)
    engine = MCDropout(network, 5)
    together = engine(x, seed=[10, 11, 12, 13])
    for i in range(4):
        alone = engine(x[i : i + 1], seed=[10 + i])
        torch.testing.assert_close(alone.std[0], together.std[i], rtol=1e-4, atol=1e-6)
    with pytest.raises(UncertaintyError, match="2 seeds for a batch of 4"):
        engine(x, seed=[1, 2])


def test_fixed_masks_make_one_deterministic_function() -> None:
    network, (x,) = made("ViT", 5)
    engine = MCDropout(network, 5, masks=FixedMasks(1))
    together = engine(x)
    torch.rand(7)
    reordered = engine(x.flip(0), seed=99)
    torch.testing.assert_close(reordered.std.flip(0), together.std, rtol=1e-4, atol=1e-6)
    alone = engine(x[2:3])
    torch.testing.assert_close(alone.mean[0], together.mean[2], rtol=1e-4, atol=1e-6)
    other = MCDropout(network, 5, masks=FixedMasks(2))(x)
    assert not torch.allclose(other.std, together.std)


def test_the_first_passes_of_many_are_a_prediction_of_fewer() -> None:
    network, (x,) = made("U-Net", 3)
    many = MCDropout(network, 50, masks=FixedMasks(0), keep_samples=True)(x)
    for passes in (5, 10, 25):
        few = MCDropout(network, passes, masks=FixedMasks(0))(x)
        torch.testing.assert_close(many.first(passes).std, few.std, rtol=1e-4, atol=1e-6)
        assert many.first(passes).passes == passes
    with pytest.raises(UncertaintyError, match="1 of 50 passes"):
        many.first(1)
    with pytest.raises(UncertaintyError, match="keep_samples"):
        MCDropout(network, 5)(x).first(3)


class Mixing(nn.Module):
    """Rows influence each other: no way of batching the passes can be right."""

    def __init__(self) -> None:
        super().__init__()
        self.linear, self.dropout = nn.Linear(4, 2), nn.Dropout(0.5)

    def forward(self, x: Tensor) -> Tensor:
        y = self.linear(self.dropout(x))
        return cast(Tensor, y - y.mean(0))


def test_a_network_that_mixes_rows_is_looped() -> None:
    torch.manual_seed(0)
    engine = MCDropout(Mixing(), 5)
    engine(torch.randn(3, 4))
    assert [strategy for strategy, _ in engine.plan().values()] == ["loop"]
    for strategy in ("shared", "batch"):
        with pytest.raises(UncertaintyError, match=f"strategy {strategy} does not fit Mixing"):
            MCDropout(Mixing(), 5, strategy=strategy)(torch.randn(3, 4))
    with pytest.raises(UncertaintyError, match="Rows seem to influence each other"):
        MCDropout(Mixing(), 5, masks=FixedMasks(0))(torch.randn(3, 4))


class FoldedTheOtherWay(nn.Module):
    """Folds patches outside the batch: rows of a replicated prefix would be mixed up."""

    def __init__(self) -> None:
        super().__init__()
        self.prefix, self.dropout, self.head = nn.Linear(4, 8), nn.Dropout(0.5), nn.Linear(8, 2)

    def forward(self, x: Tensor) -> Tensor:
        batch, patches, _ = x.shape
        tokens = self.prefix(x.transpose(0, 1).reshape(patches * batch, -1))
        tokens = self.dropout(tokens)
        return cast(Tensor, self.head(tokens.view(patches, batch, -1).sum(0)))


def test_a_prefix_that_cannot_be_replicated_is_noticed() -> None:
    torch.manual_seed(0)
    engine = MCDropout(FoldedTheOtherWay(), 6)
    engine(torch.randn(3, 5, 4))
    assert [strategy for strategy, _ in engine.plan().values()] == ["loop"]


class OwnRandomness(nn.Module):
    """A dropout of somebody's own making, found by name."""

    def __init__(self) -> None:
        super().__init__()
        self.p = 0.5

    def forward(self, x: Tensor) -> Tensor:
        return x * (torch.rand_like(x) > self.p) if self.training else x


def test_layers_of_an_unknown_kind_use_torchs_random_numbers() -> None:
    torch.manual_seed(0)
    network = nn.Sequential(nn.Linear(4, 8), OwnRandomness(), nn.AlphaDropout(0.2), nn.Linear(8, 2))
    engine = MCDropout(network, 8, select=["1", "AlphaDropout"])
    x = torch.randn(3, 4)
    state = torch.get_rng_state()
    first, again = engine(x, seed=4), engine(x, seed=4)
    assert torch.equal(torch.get_rng_state(), state)
    assert (first.std > 0).all()
    assert torch.equal(first.std, again.std)
    assert [strategy for strategy, _ in engine.plan().values()] == ["batch"]
    with pytest.raises(UncertaintyError, match="AlphaDropout: fixed masks need layers"):
        MCDropout(network, 8, masks=FixedMasks(0))(x)


def test_fixed_masks_take_one_size_of_input() -> None:
    network = nn.Sequential(nn.Conv2d(1, 2, 1), nn.Dropout(0.5), nn.Flatten(), nn.LazyLinear(2))
    network(torch.randn(1, 1, 4, 4))
    engine = MCDropout(network[:3], 4, masks=FixedMasks(0))
    engine(torch.randn(2, 1, 4, 4))
    with pytest.raises(UncertaintyError, match="drawn for 32 elements a row, now 50"):
        engine(torch.randn(2, 1, 5, 5))


def test_a_compiled_network_is_run_uncompiled() -> None:
    network, inputs = made("U-Net", 2)
    compiled = cast(nn.Module, torch.compile(network))
    expected = samples(MCDropout(network, 4), inputs)
    torch.testing.assert_close(samples(MCDropout(compiled, 4), inputs), expected)


def test_identity_tells_masks_and_layers_apart() -> None:
    network, _ = made("ResNet", 2)
    engine = MCDropout(network, 5)
    fixed = MCDropout(network, 5, masks=FixedMasks(0))
    some = MCDropout(network, 5, select=["head.0"])
    assert engine.identity() == MCDropout(network, 5, strategy="loop").identity()
    assert "masks: random then" in engine.identity().differences(fixed.identity())[0]
    assert some.identity().rates == (0.3,)
    assert engine.identity(passes=3).passes == 3
