"""Intervals of modules that know nothing of uncal, against the exact law of their coverage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import lightning
import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.utils.data import DataLoader, TensorDataset

from uncal.callbacks.conformal_calibration import ConformalCalibration
from uncal.errors import ConfigurationError
from uncal.uncertainty import PredictorMismatchError, UncertaintyError, coverage_band

M, N = 400, 1000


class Foreign(lightning.LightningModule):
    """What every module of the tests has in common with any other."""

    def training_step(self, batch: list[Tensor], batch_idx: int) -> Tensor:
        x, y = batch
        return F.mse_loss(self(x), y)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.Adam(self.parameters(), 1e-2)


class Aleatoric(Foreign):
    """Mean and σ from one head, as the routines of torch-uncertainty have it."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Flatten(), nn.Linear(12, 16), nn.ReLU(), nn.Linear(16, 4))

    def forward(self, x: Tensor) -> torch.distributions.Normal:
        mean, raw = self.net(x).chunk(2, -1)
        return torch.distributions.Normal(mean, F.softplus(raw) + 1e-3)

    def training_step(self, batch: list[Tensor], batch_idx: int) -> Tensor:
        x, y = batch
        likelihood: Tensor = self(x).log_prob(y)
        return -likelihood.mean()

    def predict_step(self, batch: list[Tensor], batch_idx: int) -> torch.distributions.Normal:
        found: torch.distributions.Normal = self(batch[0])
        return found


class ResNet(Foreign):
    """One residual block with dropout; no torchvision."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Conv1d(3, 8, 1)
        self.block = nn.Sequential(nn.Conv1d(8, 8, 3, padding=1), nn.BatchNorm1d(8), nn.ReLU())
        self.head = nn.Sequential(nn.Flatten(), nn.Dropout(0.2), nn.Linear(32, 2))

    def forward(self, x: Tensor) -> Tensor:
        x = self.stem(x)
        out: Tensor = self.head(F.relu(x + self.block(x)))
        return out


class Transformer(Foreign):
    def __init__(self) -> None:
        super().__init__()
        self.embed = nn.Linear(4, 16)
        self.body = nn.TransformerEncoderLayer(16, 2, 32, batch_first=True, dropout=0.1)
        self.head = nn.Linear(16, 2)

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.head(self.body(self.embed(x)).mean(1))
        return out


def data(n: int, seed: int) -> TensorDataset:
    """Noise whose size depends on the input, so that σ has something to say."""
    draws = torch.Generator().manual_seed(seed)
    x = torch.randn(n, 3, 4, generator=draws)
    noise = torch.randn(n, 2, generator=draws) * (0.2 + x[:, :1, 0].abs())
    return TensorDataset(x, x[:, :2, 1] + noise)


def trained(module: Foreign, callback: ConformalCalibration, root: Path) -> lightning.Trainer:
    torch.manual_seed(0)
    trainer = lightning.Trainer(
        max_epochs=2,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        default_root_dir=root,
        callbacks=[callback],
    )
    trainer.fit(module, DataLoader(data(200, 1), batch_size=50))
    return trainer


@pytest.mark.parametrize(
    ("kind", "settings", "score"),
    [
        (Aleatoric, {}, "conformal"),
        (Aleatoric, {"forward": "predict_step"}, "conformal"),
        (ResNet, {}, "absolute"),
        (ResNet, {"passes": 10}, "conformal"),
        (Transformer, {}, "absolute"),
        (Transformer, {"passes": 10}, "conformal"),
    ],
)
def test_covers_as_the_law_says(
    kind: type[Foreign], settings: dict[str, Any], score: str, tmp_path: Path
) -> None:
    module = kind()
    callback = ConformalCalibration(DataLoader(data(M, 2), batch_size=100), **settings)
    trained(module, callback, tmp_path)
    assert callback.calibrator is not None
    assert callback.calibrator.kind == score
    x, y = data(N, 3).tensors
    for level in (0.8, 0.9):
        found = callback.predict(module, (x, y), level)
        covered = ((found.lower <= y) & (y <= found.upper)).float().mean(0)
        low, high = coverage_band(N, M, round(1 - level, 2), 0.9999)
        assert ((low <= covered) & (covered <= high)).all(), (level, covered)


def test_other_weights_are_refused(tmp_path: Path) -> None:
    module = ResNet()
    callback = ConformalCalibration(DataLoader(data(50, 2), batch_size=25))
    with pytest.raises(UncertaintyError, match="not calibrated"):
        callback.predict(module, data(5, 3).tensors, 0.9)
    callback.calibrate(module)
    nn.init.zeros_(module.stem.weight)
    with pytest.raises(PredictorMismatchError, match="weights"):
        callback.predict(module, data(5, 3).tensors, 0.9)


def test_state_comes_back(tmp_path: Path) -> None:
    module = Aleatoric()
    callback = ConformalCalibration(DataLoader(data(50, 2), batch_size=25))
    callback.calibrate(module)
    again = ConformalCalibration([])
    again.load_state_dict(callback.state_dict())
    batch = data(5, 3).tensors
    expected = callback.predict(module, batch, 0.9)
    assert torch.equal(again.predict(module, batch, 0.9).lower, expected.lower)


def test_wrong_keys_are_named() -> None:
    callback = ConformalCalibration([{"x": torch.zeros(2, 3, 4)}], target="y", input="x")
    with pytest.raises(ConfigurationError, match="target='y'"):
        callback.calibrate(ResNet())
    with pytest.raises(UncertaintyError, match="empty"):
        ConformalCalibration([]).calibrate(ResNet())
    with pytest.raises(ConfigurationError, match="passes"):
        ConformalCalibration([], forward="predict_step", passes=5)
