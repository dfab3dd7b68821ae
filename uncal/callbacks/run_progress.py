"""One progress bar for the whole run, with the time that remains; lines in a log."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

import lightning
from lightning import LightningModule, Trainer

from uncal.system.progress import progress_bar

if TYPE_CHECKING:
    from tqdm import tqdm


class RunProgress(lightning.Callback):
    """Counts training steps over all epochs, then test batches; validation is part of the rate."""

    def __init__(self) -> None:
        self._bar: tqdm[NoReturn] | None = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Open the bar; a resumed run starts where it stopped."""
        total, done = int(trainer.estimated_stepping_batches), trainer.global_step
        self._bar = progress_bar("training", total, done=done)

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Open the bar of the test split."""
        self._bar = progress_bar("MC dropout, test", int(sum(trainer.num_test_batches)), done=0)

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, *args: object, **kwargs: object
    ) -> None:
        """Advance by one step and show epoch and loss."""
        metrics = trainer.progress_bar_metrics
        shown = {name: f"{float(value):.3f}" for name, value in metrics.items()}
        self._advance(epoch=f"{trainer.current_epoch + 1}/{trainer.max_epochs}", **shown)

    def on_test_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, *args: object, **kwargs: object
    ) -> None:
        """Advance by one batch."""
        self._advance()

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Close the bar."""
        self._close()

    on_test_end = on_train_end

    def on_exception(
        self, trainer: Trainer, pl_module: LightningModule, exception: BaseException
    ) -> None:
        """Leave the terminal in order."""
        self._close()

    def _advance(self, **shown: str) -> None:
        if self._bar is not None:
            self._bar.set_postfix(shown, refresh=False)
            self._bar.update()

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None
