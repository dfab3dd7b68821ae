from __future__ import annotations

import pytest
import torch
from torch import nn

from uncal.uncertainty.dropout import dropout_layers, dropout_rates, only_dropout_active


def _network() -> nn.Sequential:
    inner = nn.Sequential(nn.BatchNorm1d(3), nn.AlphaDropout(0.1), nn.Dropout(0.0))
    return nn.Sequential(nn.Linear(3, 3), nn.Dropout1d(0.2), inner)


def test_found_by_type_anywhere() -> None:
    assert dropout_rates(_network()) == {"1": 0.2, "2.1": 0.1, "2.2": 0.0}
    assert dropout_rates(nn.Linear(1, 1)) == {}


def test_exactly_dropout_is_active_and_flags_come_back() -> None:
    network = _network().train()
    network.get_submodule("2").eval()
    network.get_submodule("2.1").train()
    flags = {name: module.training for name, module in network.named_modules()}
    with only_dropout_active(network):
        active = {name for name, module in network.named_modules() if module.training}
        assert active == set(dropout_layers(network))
    assert {name: module.training for name, module in network.named_modules()} == flags


def test_flags_come_back_after_an_exception() -> None:
    network = _network().eval()
    message = "out of memory"
    with pytest.raises(RuntimeError, match=message), only_dropout_active(network):
        raise RuntimeError(message)
    assert not any(module.training for module in network.modules())
    assert torch.backends.mha.get_fastpath_enabled()
