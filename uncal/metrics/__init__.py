"""Metrics of prediction intervals: pure functions and torchmetrics around them."""

from uncal.metrics.functional import interval_score, mpiw, picp
from uncal.metrics.intervals import MPIW, PICP, IntervalScore

__all__ = ["MPIW", "PICP", "IntervalScore", "interval_score", "mpiw", "picp"]
