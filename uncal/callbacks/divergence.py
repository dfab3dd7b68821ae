"""Stops a training whose loss is no longer a finite number, at once."""

from __future__ import annotations

from collections.abc import Mapping

import lightning
import torch
from lightning import LightningModule, Trainer
from torch import Tensor

from uncal.errors import DivergenceError
from uncal.runs.checkpoint import last_checkpoint


class StopAtDivergence(lightning.Callback):
    """Ends a training at the first loss that is NaN or infinite.

    Everything after it would be thrown away, and the calibration would only count NaN at the end.
    """

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Tensor | Mapping[str, object] | None,
        *args: object,
        **kwargs: object,
    ) -> None:
        """Look at the loss of the step.

        Raises:
            DivergenceError: names step, learning rate and the last good checkpoint.
        """
        loss = outputs.get("loss") if isinstance(outputs, Mapping) else outputs
        if not isinstance(loss, Tensor) or bool(torch.isfinite(loss).all()):
            return
        raise diverged(trainer, f"the loss is {float(loss.detach().float().mean())}")


def diverged(trainer: Trainer, what: str) -> DivergenceError:
    """What to say of a training of which ``what`` is no longer a number."""
    groups = [group for optimizer in trainer.optimizers for group in optimizer.param_groups]
    rate = max((group["lr"] for group in groups), default=float("nan"))
    last = last_checkpoint(trainer)
    kept = (
        "No epoch had ended, so that there is no checkpoint."
        if last is None or not last.is_file()
        else f"The last good checkpoint is {last}."
    )
    return DivergenceError(
        f"the training diverges: {what} at step {trainer.global_step} (epoch "
        f"{trainer.current_epoch + 1} of {trainer.max_epochs}), learning rate {rate:.3g} there. "
        f"Lower model.optimization.optimizer.lr, or trainer.gradient_clip_val. {kept}"
    )
