"""Metrics of prediction intervals: pure functions and torchmetrics around them."""

from uncal.metrics.conditional import (
    BinnedCoverage,
    coverage_by_bin,
    quantile_edges,
)
from uncal.metrics.functional import CalibrationError, calibration_error, interval_score, mpiw, picp
from uncal.metrics.intervals import MPIW, PICP, IntervalScore
from uncal.metrics.joint import (
    log_volume,
    mean_log_volume,
    relative_size,
)

__all__ = [
    "MPIW",
    "PICP",
    "BinnedCoverage",
    "CalibrationError",
    "IntervalScore",
    "calibration_error",
    "coverage_by_bin",
    "interval_score",
    "log_volume",
    "mean_log_volume",
    "mpiw",
    "picp",
    "quantile_edges",
    "relative_size",
]
