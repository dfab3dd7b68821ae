import lightning
import pytest
import torch
from torch import Tensor
from torch.utils.data import DataLoader, TensorDataset

from uncal.callbacks.run_progress import RunProgress


class Line(lightning.LightningModule):
    def __init__(self) -> None:
        super().__init__()
        self.layer = torch.nn.Linear(1, 1)

    def training_step(self, batch: list[Tensor], batch_idx: int) -> Tensor:
        loss = self.layer(batch[0]).square().mean()
        self.log("loss/train", loss, prog_bar=True)
        return torch.as_tensor(loss)

    def test_step(self, batch: list[Tensor], batch_idx: int) -> None:
        self.log("loss/test", self.layer(batch[0]).mean())

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), lr=0.1)


def test_one_bar_counts_the_steps_of_all_epochs_then_the_test(
    capsys: pytest.CaptureFixture[str],
) -> None:
    loader = DataLoader(TensorDataset(torch.ones(6, 1)), batch_size=2)
    trainer = lightning.Trainer(
        max_epochs=2,
        accelerator="cpu",
        callbacks=[RunProgress()],
        enable_progress_bar=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        logger=False,
    )
    module = Line()
    trainer.fit(module, loader)
    trainer.test(module, loader, verbose=False)
    shown = capsys.readouterr().err
    assert "training: 6/6" in shown
    assert "epoch=2/2" in shown
    assert "loss/train=" in shown
    assert "MC dropout, test: 3/3" in shown
    assert "\r" not in shown  # standard error is no terminal here
