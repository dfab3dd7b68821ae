from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from torch import Tensor, nn

from uncal.errors import ConfigurationError
from uncal.uncertainty import MCDropout, UncertaintyError
from uncal.uncertainty.dropout.replicated import iterate_tensors


class _Convolutional(nn.Module):
    """A small network with everything that must stay in evaluation mode."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(nn.Conv2d(2, 4, 3), nn.BatchNorm2d(4), nn.ReLU(), nn.Dropout(0.3))
        self.head = nn.Linear(4, 6)

    def forward(self, images: Tensor) -> Tensor:
        features: Tensor = self.body(images)
        output: Tensor = self.head(features.mean((2, 3)))
        return output


class _Recorder(nn.Module):
    """Remembers what it was called with."""

    def __init__(self, function: Callable[..., Tensor]) -> None:
        super().__init__()
        self.dropout = nn.Dropout(0.5)
        self.function = function
        self.calls: list[tuple[tuple[object, ...], dict[str, object]]] = []

    def forward(self, *args: object, **kwargs: object) -> Tensor:
        self.calls.append((args, kwargs))
        output: Tensor = self.dropout(self.function(*args, **kwargs))
        return output


class _Pair(NamedTuple):
    left: Tensor
    right: Tensor


def test_spread_of_a_linear_layer_after_dropout() -> None:
    # y = Σ w_j x_j b_j/(1-p), b_j ~ Bernoulli(1-p): mean Σ w_j x_j, variance Σ (w_j x_j)² p/(1-p).
    torch.manual_seed(0)
    p, passes = 0.25, 20_000
    linear = nn.Linear(10, 2, bias=False)
    x = torch.randn(3, 10)
    prediction = MCDropout(nn.Sequential(nn.Dropout(p), linear), passes)(x, seed=0)
    terms = x[:, None, :] * linear.weight.detach()[None]
    std = (terms.square().sum(-1) * p / (1 - p)).sqrt()
    # σ/√N is the standard error of the mean and more than that of σ; five of them.
    assert ((prediction.mean - terms.sum(-1)).abs() < 5 * std / passes**0.5).all()
    assert ((prediction.std - std).abs() < 5 * std / passes**0.5).all()


def test_mean_and_population_std_of_the_samples() -> None:
    prediction = MCDropout(_Convolutional(), passes=7, keep_samples=True)(torch.randn(4, 2, 8, 8))
    assert prediction.samples is not None
    assert prediction.samples.shape == (7, 4, 6)
    assert prediction.passes == 7
    mean = prediction.samples.sum(0) / 7
    torch.testing.assert_close(prediction.mean, mean)
    variance = (prediction.samples - mean).square().sum(0) / 7  # 1/N, not 1/(N-1)
    torch.testing.assert_close(prediction.std, variance.sqrt())


def test_every_row_has_a_mask_of_its_own() -> None:
    torch.manual_seed(0)
    x = torch.randn(1, 2, 8, 8).expand(3, -1, -1, -1)
    prediction = MCDropout(_Convolutional(), passes=5, keep_samples=True)(x)
    assert prediction.samples is not None
    rows = prediction.samples.reshape(15, 6).tolist()
    assert len({tuple(row) for row in rows}) == 15


@pytest.mark.parametrize("chunk", [None, 1, 2, 4, 7])
def test_samples_belong_to_their_input_rows(chunk: int | None) -> None:
    x = torch.tensor([[1.0], [10.0], [100.0]])
    samples = MCDropout(nn.Dropout(0.5), 8, chunk, keep_samples=True)(x, seed=3).samples
    assert samples is not None
    assert samples.shape == (8, 3, 1)
    assert ((samples == 0) | (samples == 2 * x)).all()
    assert (samples == 2 * x).any(0).all()


@pytest.mark.parametrize("training", [True, False])
def test_network_comes_back_as_it_was(training: bool) -> None:
    network = _Convolutional().train(training)
    state = {name: value.clone() for name, value in network.state_dict().items()}
    prediction = MCDropout(network, passes=3)(torch.randn(4, 2, 8, 8))
    assert (prediction.std > 0).any()
    assert all(module.training == training for module in network.modules())
    for name, value in network.state_dict().items():
        assert torch.equal(value, state[name]), name  # BatchNorm's statistics among them


def test_flags_come_back_after_an_exception() -> None:
    network = _Convolutional().train()
    with pytest.raises(RuntimeError):
        MCDropout(network, passes=3)(torch.randn(4, 5, 8, 8))
    assert all(module.training for module in network.modules())


def test_seed_makes_a_pure_function_and_leaves_the_global_state() -> None:
    engine = MCDropout(_Convolutional(), passes=5)
    x = torch.randn(4, 2, 8, 8)
    state = torch.get_rng_state()
    first = engine(x, seed=1)
    assert torch.equal(torch.get_rng_state(), state)
    torch.rand(17)
    again, other = engine(x, seed=1), engine(x, seed=2)
    assert torch.equal(first.mean, again.mean)
    assert torch.equal(first.std, again.std)
    assert not torch.equal(first.mean, other.mean)


def test_without_a_seed_draws_differ() -> None:
    engine = MCDropout(_Convolutional(), passes=5)
    x = torch.randn(4, 2, 8, 8)
    assert not torch.equal(engine(x).mean, engine(x).mean)


@pytest.mark.parametrize("chunk", [1, 3, 4, 10, 1000])
def test_chunks_have_the_same_distribution(chunk: int) -> None:
    torch.manual_seed(0)
    network, x = nn.Sequential(nn.Dropout(0.5), nn.Linear(20, 2)), torch.randn(4, 20)
    passes = 200
    whole, parts = (
        MCDropout(network, passes)(x, seed=0),
        MCDropout(network, passes, chunk)(x, seed=1),
    )
    assert parts.mean.shape == whole.mean.shape
    # Differences of two independent estimates, five standard errors.
    assert ((whole.mean - parts.mean).abs() < 5 * whole.std * (2 / passes) ** 0.5).all()
    assert ((whole.std - parts.std).abs() < 5 * whole.std * (1 / passes) ** 0.5).all()


@pytest.mark.parametrize(
    ("chunk", "rows"),
    [(None, [30]), (8, [6] * 5), (3, [3] * 10), (2, [2] * 10 + [2] * 5), (20, [18, 12])],
)
def test_chunks_bound_the_rows(chunk: int | None, rows: list[int]) -> None:
    network = _Recorder(lambda x: x)
    engine = MCDropout(network, passes=10, chunk=chunk, strategy="batch")
    engine(torch.ones(3, 1), seed=0)  # tries the strategy first
    network.calls.clear()
    engine(torch.ones(3, 1), seed=0)
    assert [len(args[0]) for args, _ in network.calls if isinstance(args[0], Tensor)] == rows


def test_everything_with_the_batch_dimension_is_replicated() -> None:
    network = _Recorder(lambda x, *_, **__: x)
    x, matrix, scalar = torch.ones(4, 2), torch.eye(3), torch.tensor(2.0)
    pair = _Pair(torch.zeros(4), torch.zeros(4, 1))
    MCDropout(network, passes=5, strategy="batch")(
        x, (x, [x, matrix]), pair=pair, nested={"x": x, "name": "a"}, scalar=scalar, flag=True
    )
    args, kwargs = network.calls[-1]
    shapes = [tuple(tensor.shape) for tensor in iterate_tensors(args)]
    assert shapes == [(20, 2), (20, 2), (20, 2), (3, 3)]
    assert isinstance(args[1], tuple)
    assert isinstance(args[1][1], list)
    assert isinstance(kwargs["pair"], _Pair)
    assert kwargs["pair"].right.shape == (20, 1)
    nested = kwargs["nested"]
    assert isinstance(nested, dict)
    assert len(nested["x"]) == 20
    assert nested["name"] == "a"
    assert kwargs["scalar"] is scalar
    assert kwargs["flag"] is True


def test_keyword_arguments_alone() -> None:
    prediction = MCDropout(_Recorder(lambda x: x), passes=5)(x=torch.ones(4, 2))
    assert prediction.mean.shape == (4, 2)


def test_channels_last_survives() -> None:
    network = _Recorder(lambda x: x.mean((2, 3)))
    x = torch.randn(4, 3, 8, 8).to(memory_format=torch.channels_last)
    MCDropout(network, passes=5, chunk=7, strategy="batch")(x)
    for args, _ in network.calls:
        assert isinstance(args[0], Tensor)
        assert args[0].is_contiguous(memory_format=torch.channels_last)


def test_inside_inference_mode_and_autocast() -> None:
    engine = MCDropout(_Convolutional(), passes=5)
    with torch.inference_mode():
        assert (engine(torch.randn(2, 2, 8, 8)).std > 0).any()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        prediction = engine(torch.randn(2, 2, 8, 8))
    assert prediction.mean.dtype == prediction.std.dtype == torch.float32


def test_results_can_be_used_outside_inference_mode() -> None:
    prediction = MCDropout(_Convolutional(), passes=5)(torch.randn(2, 2, 8, 8))
    assert not prediction.mean.is_inference()
    assert not prediction.mean.requires_grad


def test_transformer_layers_do_not_take_their_path_without_dropout() -> None:
    # In evaluation mode torch fuses this layer and skips the dropout modules inside.
    layer = nn.TransformerEncoderLayer(8, 2, dim_feedforward=16, dropout=0.2, batch_first=True)
    network = nn.Sequential(layer, nn.Flatten(), nn.Linear(24, 2)).eval()
    assert (MCDropout(network, passes=5)(torch.randn(4, 3, 8)).std > 0).all()
    assert torch.backends.mha.get_fastpath_enabled()


@pytest.mark.parametrize("layers", [[], [nn.Dropout(0.0), nn.Dropout2d(0.0)]])
def test_no_active_dropout(layers: list[nn.Module]) -> None:
    network = nn.Sequential(nn.Linear(2, 2), *layers)
    with pytest.raises(ConfigurationError, match=rf"{len(layers)} found, p = 0.*p > 0"):
        MCDropout(network, passes=5)(torch.randn(3, 2))


def test_dropout_that_never_reaches_the_output() -> None:
    class Blind(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.linear, self.unused = nn.Linear(64, 6), nn.Dropout(0.5)

        def forward(self, x: Tensor) -> Tensor:
            self.unused(x)
            output: Tensor = self.linear(x)
            return output

    with pytest.raises(UncertaintyError, match="σ = 0 for all 18 outputs over 5 passes"):
        MCDropout(Blind(), passes=5)(torch.randn(3, 64))


def test_settings_and_arguments() -> None:
    with pytest.raises(ConfigurationError, match="at least 2"):
        MCDropout(nn.Dropout(0.5), passes=1)
    with pytest.raises(ConfigurationError, match="chunk = 0"):
        MCDropout(nn.Dropout(0.5), passes=2, chunk=0)
    with pytest.raises(UncertaintyError, match="no tensor"):
        MCDropout(nn.Dropout(0.5), passes=2)("image")
    with pytest.raises(UncertaintyError, match=r"shape \(0, 3\)"):
        MCDropout(nn.Dropout(0.5), passes=2)(torch.ones(0, 3))


def test_outputs_that_are_no_rows() -> None:
    with pytest.raises(UncertaintyError, match=r"returned \(2,\) for 4 rows"):
        MCDropout(_Recorder(lambda x: x.mean(0)), passes=4)(torch.ones(3, 2))


def test_identity_follows_the_predictor() -> None:
    network = _Convolutional()
    identity = MCDropout(network, passes=25).identity()
    assert (identity.passes, identity.rates) == (25, (0.3,))
    assert MCDropout(network, passes=25, chunk=4).identity() == identity
