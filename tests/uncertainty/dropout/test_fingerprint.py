from __future__ import annotations

import copy

import pytest
import torch
from torch import nn

from uncal.uncertainty import PredictorIdentity, fingerprint


def _network() -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(nn.Conv2d(1, 2, 3), nn.BatchNorm2d(2), nn.Dropout(0.25))


def test_equal_for_equal_weights_only() -> None:
    network = _network()
    twin = copy.deepcopy(network)
    assert fingerprint(network) == fingerprint(twin)
    assert len(fingerprint(network)) == 64
    with torch.no_grad():
        next(twin.parameters()).view(-1)[0] += 1e-6
    assert fingerprint(network) != fingerprint(twin)


def test_running_statistics_count() -> None:
    network = _network()
    before = fingerprint(network)
    network.train()(torch.randn(4, 1, 8, 8))
    assert fingerprint(network) != before


def test_swapped_weights_differ() -> None:
    first, second = nn.Linear(1, 1, bias=False), nn.Linear(1, 1, bias=False)
    assert fingerprint(nn.Sequential(first, second)) != fingerprint(nn.Sequential(second, first))


def test_memory_format_and_mode_do_not_count() -> None:
    network = _network()
    before = fingerprint(network)
    convolution = network.get_parameter("0.weight")
    convolution.data = convolution.data.to(memory_format=torch.channels_last)
    assert fingerprint(network.eval()) == before


@pytest.mark.slow  # importing the compiler takes ten seconds
def test_compiled_network_is_the_same() -> None:
    network = _network()
    compiled = torch.compile(network)
    assert isinstance(compiled, nn.Module)
    assert fingerprint(compiled) == fingerprint(network)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_another_number_type_differs(dtype: torch.dtype) -> None:
    assert fingerprint(_network().to(dtype)) != fingerprint(_network())


def test_identity_differences() -> None:
    network = _network()
    then = PredictorIdentity.of(network, passes=25)
    assert then.rates == (0.25,)
    assert then.differences(PredictorIdentity.of(network, passes=25)) == []
    assert then.differences(PredictorIdentity.of(network, passes=10)) == ["passes: 25 then, 10 now"]
    network.append(nn.Dropout(0.1))
    assert then.differences(PredictorIdentity.of(network, passes=25)) == [
        "dropout layers: 1 then, 2 now"
    ]


def test_identity_names_the_layers_that_are_on_and_the_masks() -> None:
    network = _network()
    random = PredictorIdentity.of(network, 25, rates={"2": 0.25})
    assert random == PredictorIdentity.of(network, 25)
    assert random.masks == ""
    assert PredictorIdentity.of(network, 25, rates={}).rates == ()
    fixed = PredictorIdentity.of(network, 25, masks="3f2a9c11d2e4b5f6")
    assert random.differences(fixed) == ["masks: random then, fixed (3f2a9c11d2e4…) now"]
    other = PredictorIdentity.of(network, 25, masks="00" * 8)
    assert fixed.differences(other) == [
        "masks: fixed (3f2a9c11d2e4…) then, fixed (000000000000…) now"
    ]
    assert fixed.differences(fixed) == []
