from __future__ import annotations

import csv
from pathlib import Path
from typing import cast

import pandas as pd
import torch
from torch import Tensor, nn
from transformers import MobileViTConfig
from transformers.models.mobilevit.modeling_mobilevit import MobileViTLayer

from uncal.benchmarking.latency import DETERMINISTIC, measure_latency, placements
from uncal.benchmarking.tables import write_latency, write_trade


class TwoStages(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        config = MobileViTConfig(hidden_dropout_prob=0.2)
        self.first = MobileViTLayer(config, 4, 4, stride=1, hidden_size=8, num_stages=1)
        self.second = MobileViTLayer(config, 4, 4, stride=2, hidden_size=8, num_stages=1)
        self.head = nn.Sequential(nn.Dropout(0.1), nn.Linear(4, 6))

    def forward(self, x: Tensor) -> Tensor:
        features = self.second(self.first(x))
        return cast(Tensor, self.head(features.mean((2, 3))))


def test_placements_go_from_all_layers_to_the_head() -> None:
    found = placements(TwoStages())
    assert list(found) == ["from the first stage on", "from the last stage on", "head only"]
    first, last, head = found.values()
    assert head == ["head.0"]
    assert set(head) < set(last) < set(first)
    assert all(name.startswith(("second.", "head.")) for name in last)
    plain = nn.Sequential(nn.Dropout(0.1), nn.Linear(2, 2))
    assert placements(plain) == {"all layers": ["0"]}


def test_rows_have_times_ratios_and_the_floor(tmp_path: Path) -> None:
    torch.manual_seed(0)
    rows = measure_latency("tiny", TwoStages(), (torch.randn(2, 4, 16, 16),), 5, 2, compiled=False)
    assert rows["contestant"][0] == DETERMINISTIC
    assert rows["ratio"][0] == rows["operations"][0] == 1.0
    operations = rows.set_index(["dropout", "contestant"])["operations"]
    assert operations["from the first stage on", "loop"] == 5.0
    assert operations["from the first stage on", "batch"] == 5.0
    shared = [operations[where, "shared"] for where in placements(TwoStages())]
    assert 5.0 > shared[0] > shared[1] > shared[2] > 1.0
    assert rows["ratio"].between(rows["ratio_low"], rows["ratio_high"]).all()
    assert (rows["milliseconds"] > 0).all()
    text = write_latency(tmp_path, rows, 5, 2, "somewhere")
    assert text == (tmp_path / "latency.md").read_text(encoding="utf-8")
    with (tmp_path / "latency.csv").open(encoding="utf-8") as file:
        assert [row["contestant"] for row in csv.DictReader(file)] == list(rows["contestant"])


def test_the_trade_is_written_and_drawn(tmp_path: Path) -> None:
    names = "level milliseconds ratio is_translation is_rotation mpiw_translation mpiw_rotation "
    names += "picp picp_low picp_high mae_translation mae_rotation"
    numbers = (90.0, 12.0, 3.0, 20.0, 0.9, 15.0, 0.7, 90.5, 88.0, 93.0, 4.0, 0.2)
    own = dict(zip(names.split(), numbers, strict=True))
    places = ("from the first stage on", "head only")
    rows = pd.DataFrame([{"dropout": where, **own} for where in places])
    text = write_trade(tmp_path, rows, "simulated", "best.ckpt", "somewhere")
    assert "simulated" in text
    assert "| head only | 90% |" in text
    assert (tmp_path / "trade.png").stat().st_size > 5000
