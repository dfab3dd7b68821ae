"""Settings beside final metrics, for TensorBoard's HPARAMS tab."""

from __future__ import annotations

import lightning
import pandas as pd
from lightning import LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger

from uncal.models.module import CalibrationModule


class SettingsWithResults(lightning.Callback):
    """Logs the run's settings with what came out, so that runs can be sorted and compared."""

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Log them once, after the report."""
        if stage != "test" or not trainer.is_global_zero:
            return
        if not isinstance(pl_module, CalibrationModule) or pl_module.run.mean_ratio is None:
            return
        recipe = pd.json_normalize([pl_module.recipe]).iloc[0]  # by dotted key
        settings = {str(key): value for key, value in recipe.items()}
        result = {"result/mean ratio": pl_module.run.mean_ratio}
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger):
                logger.log_hyperparams(settings, result)
