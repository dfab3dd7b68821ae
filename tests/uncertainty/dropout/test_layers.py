from __future__ import annotations

import pytest
import torch
from torch import nn

from uncal.errors import ConfigurationError
from uncal.uncertainty.dropout.layers import (
    dropout_layers,
    dropout_rates,
    insert_dropout,
    only_active,
)


def test_layers_of_every_kind_are_found_at_any_depth() -> None:
    network = nn.Sequential(
        nn.Dropout(0.1),
        nn.Sequential(nn.Linear(2, 2), nn.Dropout2d(0.2)),
        nn.ModuleDict({"a": nn.AlphaDropout(0.3), "b": nn.ReLU()}),
    )
    assert dropout_rates(network) == {"0": 0.1, "1.1": 0.2, "2.a": 0.3}


def test_selection_by_name_pattern_and_type() -> None:
    network = nn.ModuleDict(
        {
            "backbone": nn.Sequential(nn.Dropout(0.1), nn.Dropout2d(0.2)),
            "head": nn.Sequential(nn.Linear(2, 2), nn.Dropout(0.3)),
        }
    )
    assert list(dropout_layers(network, ["head.*"])) == ["head.1"]
    assert list(dropout_layers(network, ["Dropout2d", "head.1"])) == ["backbone.1", "head.1"]
    with pytest.raises(ConfigurationError, match=r"'neck\.\*'.*backbone.0 \(Dropout\)"):
        dropout_layers(network, ["neck.*"])


def test_only_the_given_layers_are_active_and_flags_come_back() -> None:
    network = nn.Sequential(nn.BatchNorm1d(2), nn.Dropout(0.5), nn.Dropout(0.5))
    network[2].eval()
    with only_active(network, [network[1]]):
        assert [module.training for module in network] == [False, True, False]
        assert not torch.backends.mha.get_fastpath_enabled()
    assert [module.training for module in network] == [True, True, False]
    assert torch.backends.mha.get_fastpath_enabled()


def test_inserted_dropout_keeps_names_of_the_state_and_acts_in_training_only() -> None:
    torch.manual_seed(0)
    network = nn.Sequential(nn.Linear(4, 50), nn.ReLU(), nn.Linear(50, 2))
    keys, x = list(network.state_dict()), torch.randn(3, 4)
    before = network.eval()(x)
    names = insert_dropout(network, ["Linear"], 0.5, exclude=["2"])
    assert names == ["0.inserted_dropout"]
    assert list(network.state_dict()) == keys
    assert dropout_rates(network) == {"0.inserted_dropout": 0.5}
    assert torch.equal(network.eval()(x), before)
    assert not torch.equal(network.train()(x), before)


def test_inserted_after_an_attention_the_first_output_is_dropped() -> None:
    network = nn.MultiheadAttention(8, 2, batch_first=True)
    wrapped = nn.ModuleDict({"attention": network})
    insert_dropout(wrapped, ["attention"], 0.5)
    x = torch.randn(2, 3, 8)
    out, weights = wrapped["attention"].train()(x, x, x)
    assert (out == 0).any()
    assert (weights > 0).all()


def test_wrong_insertions() -> None:
    network = nn.Sequential(nn.Linear(4, 4), nn.LSTM(4, 4))
    with pytest.raises(ConfigurationError, match=r"p = 1\.0"):
        insert_dropout(network, ["Linear"], 1.0)
    with pytest.raises(ConfigurationError, match=r"'Conv2d'.*LSTM, Linear"):
        insert_dropout(network, ["Conv2d"], 0.1)
    insert_dropout(network, ["Linear"], 0.1)
    with pytest.raises(ConfigurationError, match="0 is followed by an inserted"):
        insert_dropout(network, ["0"], 0.1)
