"""A training whose loss is not finite ends at that step, with what to do about it."""

from __future__ import annotations

import warnings
from pathlib import Path

import lightning
import pytest
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from torch import Tensor
from torch.utils.data import DataLoader, TensorDataset

from uncal.callbacks.divergence import StopAtDivergence
from uncal.errors import DivergenceError


class Line(lightning.LightningModule):
    """A weight whose loss is NaN from a step on."""

    def __init__(self, bad_from: int, rate: float) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.ones(1))
        self.bad_from = bad_from
        self.rate = rate
        self.steps = 0

    def training_step(self, batch: list[Tensor], batch_idx: int) -> Tensor | None:
        self.steps += 1
        loss = (self.weight * batch[0]).pow(2).mean()
        if self.steps == 1:
            return None  # a batch without a readable frame
        return loss * float("nan") if self.steps >= self.bad_from else loss

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), lr=self.rate)


def trained(folder: Path, bad_from: int, rate: float = 0.25) -> Line:
    last = ModelCheckpoint(folder, filename="last", every_n_epochs=1, save_on_train_epoch_end=True)
    module = Line(bad_from, rate)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        trainer = lightning.Trainer(
            max_epochs=3,
            accelerator="cpu",
            logger=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            callbacks=[StopAtDivergence(), last],
        )
        trainer.fit(module, DataLoader(TensorDataset(torch.ones(4, 1)), batch_size=1))
    return module


def test_it_stops_at_the_first_bad_step_and_names_the_last_good_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(DivergenceError) as stopped:
        trained(tmp_path, bad_from=6)
    said = str(stopped.value)
    assert "loss is nan" in said
    assert "epoch 2 of 3" in said
    assert "learning rate 0.25" in said
    assert f"last good checkpoint is {tmp_path / 'last.ckpt'}" in said
    assert torch.load(tmp_path / "last.ckpt", weights_only=True)["epoch"] == 0


def test_without_a_finished_epoch_there_is_no_checkpoint_to_name(tmp_path: Path) -> None:
    with pytest.raises(DivergenceError, match="No epoch had ended"):
        trained(tmp_path, bad_from=2)


def test_a_healthy_training_goes_on_to_its_end(tmp_path: Path) -> None:
    assert trained(tmp_path, bad_from=1000).steps == 12
