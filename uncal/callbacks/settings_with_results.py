"""Settings beside final metrics, for TensorBoard's HPARAMS tab."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import lightning
from lightning import LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger

from uncal.models.module import CalibrationModule

Scalar = str | int | float | bool


class SettingsWithResults(lightning.Callback):
    """Logs the run's settings with what came out, so that runs can be sorted and compared."""

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Log them once, after the report."""
        if stage != "test" or not trainer.is_global_zero:
            return
        if not isinstance(pl_module, CalibrationModule) or pl_module.run.results is None:
            return
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger):
                logger.log_hyperparams(
                    dict(flat(pl_module.recipe)),
                    {"result/mean ratio": float(pl_module.run.results.summary.mean_ratio)},
                )


def flat(settings: Mapping[str, object], path: str = "") -> Iterator[tuple[str, Scalar]]:
    """Settings by dotted key; what is neither text nor number as text.

    >>> dict(flat({"mcd": {"passes": 25, "layers": None}, "levels": [0.9, 0.95]}))
    {'mcd.passes': 25, 'mcd.layers': 'None', 'levels': '[0.9, 0.95]'}
    """
    for name, value in settings.items():
        key = f"{path}.{name}" if path else str(name)
        if isinstance(value, Mapping):
            yield from flat(value, key)
        else:
            yield key, value if isinstance(value, str | int | float | bool) else str(value)
