"""MC dropout and split conformal calibration at validation end, and before a test that needs it."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import lightning
from lightning import LightningModule, Trainer

from uncal.data.datamodule import CalibrationDataModule
from uncal.errors import ConfigurationError
from uncal.geometry import DOF_NAMES, DOF_SCALE, DOF_UNITS
from uncal.metrics.functional import interval_score, mpiw, picp
from uncal.models.inference import predict_split
from uncal.models.module import CalibrationModule
from uncal.uncertainty.quantile import miscoverage

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
        module, data = _ours(trainer, pl_module)
        self._fit(trainer, module, data)
        validation = predict_split(trainer, module, data, "validation", self.monitored)
        for level in self.levels:
            intervals = module.calibrator.predict(
                validation.mean,
                validation.std,
                level,
                groups=validation.groups(data.named("validation"), module.groups),
                bounds=validation.bounds,
            )
            bounds = (intervals.lower, intervals.upper)
            coverage = picp(*bounds, validation.target)
            width = mpiw(*bounds)
            score = interval_score(*bounds, validation.target, float(miscoverage(level)))
            for j, (name, unit) in enumerate(zip(DOF_NAMES, DOF_UNITS, strict=True)):
                module.log_dict(
                    {
                        f"PICP {level:.0%} (%)/{name}": coverage[j] * 100.0,
                        f"MPIW {level:.0%}/{name} ({unit})": width[j] * DOF_SCALE[j],
                        f"IS {level:.0%}/{name} ({unit})": score[j] * DOF_SCALE[j],
                    }
                )

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Fit unless the calibrator belongs to these weights, passes and rates already."""
        module, data = _ours(trainer, pl_module)
        if module.calibrator.identity == module.engine.identity():
            return
        if module.calibrator.is_fitted:
            log.warning("the calibrator belongs to other weights or passes: calibrating anew")
        self._fit(trainer, module, data)

    def _fit(
        self, trainer: Trainer, module: CalibrationModule, data: CalibrationDataModule
    ) -> None:
        split = "uncertainty_calibration"
        module.fit_calibrator(predict_split(trainer, module, data, split), data.named(split))


def _ours(
    trainer: Trainer, pl_module: LightningModule
) -> tuple[CalibrationModule, CalibrationDataModule]:
    data = getattr(trainer, "datamodule", None)
    if not isinstance(pl_module, CalibrationModule) or not isinstance(data, CalibrationDataModule):
        raise ConfigurationError(
            "UncertaintyCalibration needs a CalibrationModule and a CalibrationDataModule, "
            f"got {type(pl_module).__name__} and {type(data).__name__}"
        )
    return pl_module, data
