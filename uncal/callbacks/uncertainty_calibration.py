"""MC dropout and split conformal calibration at validation end, and before a test that needs it."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import lightning
from lightning import LightningModule, Trainer
from torch import Tensor
from torchmetrics import MetricCollection

from uncal.data.datamodule import CalibrationDataModule
from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.inference.split_passes import predict_split
from uncal.metrics import MPIW, PICP, IntervalScore
from uncal.models.module import CalibrationModule
from uncal.models.split_prediction import SplitPrediction
from uncal.recordings.frame import FrameId
from uncal.uncertainty.conformal.quantile import miscoverage

log = logging.getLogger(__name__)


class UncertaintyCalibration(lightning.Callback):
    """Fits the module's conformal calibrator on the uncertainty calibration split.

    At the end of every validation the scores of the uncertainty calibration split replace those of
    the validation before, so that each checkpoint carries the calibrator of its own weights; the
    intervals they give on the validation split go to the logger. Before a test, a calibrator that
    was fitted with other weights, or none, is fitted anew.

    Args:
        levels: coverage levels to log.
        monitored: most validation frames to log the intervals of; null for all.
    """

    def __init__(self, levels: Sequence[float], monitored: int | None = None) -> None:
        self.levels = list(levels)
        self.monitored = monitored

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Fit, then log PICP, MPIW and IS of the validation split per DoF and level."""
        if trainer.sanity_checking:
            return
        module, data = ours(trainer, pl_module, "uncertainty")
        self._fit(trainer, module, data)
        validation = predict_split(trainer, module, data, "validation", self.monitored)
        frames = data.named("validation")
        for level in self.levels:
            module.log_dict(interval_metrics(module, validation, frames, level))

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Fit unless the calibrator belongs to these weights, passes and rates already."""
        module, data = ours(trainer, pl_module, "uncertainty")
        if module.calibrator.identity == module.engine.identity():
            return
        if module.calibrator.is_fitted:
            log.warning("the calibrator belongs to other weights or passes: calibrating anew")
        self._fit(trainer, module, data)

    def on_test_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Log PICP, MPIW and IS of the test split per DoF and level."""
        module, data = ours(trainer, pl_module, "uncertainty")
        tested = module.run.tested
        if tested is None:
            return
        for level in self.levels:
            metrics = interval_metrics(module, tested, data.named("test"), level)
            values = {f"test {name}": value.item() for name, value in metrics.items()}
            for logger in trainer.loggers:
                logger.log_metrics(values, trainer.global_step)

    def _fit(
        self, trainer: Trainer, module: CalibrationModule, data: CalibrationDataModule
    ) -> None:
        split = "uncertainty_calibration"
        module.fit_calibrator(predict_split(trainer, module, data, split), data.named(split))


def interval_metrics(
    module: CalibrationModule, predicted: SplitPrediction, frames: Sequence[FrameId], level: float
) -> dict[str, Tensor]:
    """PICP, MPIW and IS of a split's intervals per DoF: tag → value in percent, cm or degrees."""
    intervals = module.intervals(predicted, frames, level)
    metrics = MetricCollection(
        {"PICP": PICP(6), "MPIW": MPIW(6), "IS": IntervalScore(6, float(miscoverage(level)))}
    )
    metrics.update(intervals.lower, intervals.upper, predicted.target)
    found = metrics.compute()
    tags = {
        f"{metric} {level:.0%}/{name} ({unit})": found[metric][j] * scale
        for metric in ("MPIW", "IS")
        for j, (name, unit, scale) in enumerate(zip(DOF_NAMES, DOF_UNITS, DOF_SCALE, strict=True))
    }
    coverage = zip(DOF_NAMES, found["PICP"] * 100.0, strict=True)
    return tags | {f"PICP {level:.0%} (%)/{name}": share for name, share in coverage}


def ours(
    trainer: Trainer, pl_module: LightningModule, callback: str
) -> tuple[CalibrationModule, CalibrationDataModule]:
    """The module and the data of a trainer, which a callback needs to be this project's.

    Raises:
        ConfigurationError: they are others; names the key under ``callbacks`` to drop.
    """
    data = getattr(trainer, "datamodule", None)
    if not isinstance(pl_module, CalibrationModule) or not isinstance(data, CalibrationDataModule):
        raise ConfigurationError(
            f"callbacks.{callback} needs a CalibrationModule and a CalibrationDataModule, got "
            f"{type(pl_module).__name__} and {type(data).__name__}: drop callbacks.{callback}"
        )
    return pl_module, data
