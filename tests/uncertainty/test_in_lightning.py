"""The engine inside Lightning's loops, which switch everything to evaluation mode."""

from __future__ import annotations

import lightning
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, TensorDataset

from uncal.uncertainty import ConformalCalibrator, MCDropout


class Regression(lightning.LightningModule):
    """Somebody's module around somebody's network."""

    def __init__(self) -> None:
        super().__init__()
        self.network = nn.Sequential(
            nn.Linear(4, 32), nn.BatchNorm1d(32), nn.ReLU(), nn.Dropout(0.3), nn.Linear(32, 2)
        )
        self.engine = MCDropout(self.network, passes=8)
        self.calibrator = ConformalCalibrator()
        self.stds: dict[str, list[Tensor]] = {"validation": [], "test": []}

    def training_step(self, batch: list[Tensor], batch_idx: int) -> Tensor:
        loss: Tensor = (self.network(batch[0]) - batch[1]).square().mean()
        return loss

    def validation_step(self, batch: list[Tensor], batch_idx: int) -> None:
        seen = self.engine(batch[0], seed=batch_idx)
        self.stds["validation"].append(seen.std)
        self.calibrator.fit(seen.mean, seen.std, batch[1], identity=self.engine.identity())

    def test_step(self, batch: list[Tensor], batch_idx: int) -> None:
        self.stds["test"].append(self.engine(batch[0]).std)

    def predict_step(self, batch: list[Tensor], batch_idx: int) -> Tensor:
        seen = self.engine(batch[0], seed=0)
        return self.calibrator.predict(seen.mean, seen.std, 0.8).lower

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), lr=1e-3)


def test_validation_test_and_predict_are_stochastic_and_training_goes_on(tmp_path: object) -> None:
    torch.manual_seed(0)
    data = DataLoader(TensorDataset(torch.randn(40, 4), torch.randn(40, 2)), batch_size=20)
    module = Regression()
    trainer = lightning.Trainer(
        max_epochs=2,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        default_root_dir=str(tmp_path),
    )
    trainer.fit(module, data, data)
    statistics = module.network[1].running_mean.clone()  # type: ignore[operator]
    trainer.test(module, data, verbose=False)
    lower = trainer.predict(module, data)
    assert all((std > 0).all() for stds in module.stds.values() for std in stds)
    assert torch.equal(module.network[1].running_mean, statistics)  # type: ignore[arg-type]
    assert lower is not None
    assert all(torch.isfinite(rows).all() for rows in lower)  # type: ignore[arg-type]
    module.calibrator.check_matches(module.engine.identity())
    fresh = Regression()
    fresh.load_state_dict(module.state_dict())
    fresh.calibrator.check_matches(fresh.engine.identity())
