"""Error bars for any regression network: MC dropout, conformal calibration, exact coverage laws."""

from uncal.uncertainty.absolute import AbsoluteCalibrator
from uncal.uncertainty.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal import (
    ConformalCalibrator,
    Intervals,
    conformal_quantile,
    conformal_rank,
    miscoverage,
    samples_needed,
)
from uncal.uncertainty.coverage_law import coverage_band, coverage_law
from uncal.uncertainty.cqr import QuantileCalibrator
from uncal.uncertainty.dropout import dropout_layers, dropout_rates, insert_dropout
from uncal.uncertainty.errors import (
    NotCalibratedError,
    PredictorMismatchError,
    UncertaintyError,
)
from uncal.uncertainty.fingerprint import PredictorIdentity, fingerprint
from uncal.uncertainty.gaussian import GaussianIntervals
from uncal.uncertainty.hierarchical import HierarchicalCalibrator
from uncal.uncertainty.masks import FixedMasks
from uncal.uncertainty.mc_dropout import MCDropout, Prediction
from uncal.uncertainty.mondrian import MondrianCalibrator

__all__ = [
    "AbsoluteCalibrator",
    "ConformalCalibrator",
    "FixedMasks",
    "GaussianIntervals",
    "HierarchicalCalibrator",
    "IntervalCalibrator",
    "Intervals",
    "MCDropout",
    "MondrianCalibrator",
    "NotCalibratedError",
    "Prediction",
    "PredictorIdentity",
    "PredictorMismatchError",
    "QuantileCalibrator",
    "UncertaintyError",
    "conformal_quantile",
    "conformal_rank",
    "coverage_band",
    "coverage_law",
    "dropout_layers",
    "dropout_rates",
    "fingerprint",
    "insert_dropout",
    "miscoverage",
    "samples_needed",
]
