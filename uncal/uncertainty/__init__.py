"""Error bars for any regression network: MC dropout, conformal calibration, exact coverage laws."""

from uncal.uncertainty.conformal import (
    ConformalCalibrator,
    Intervals,
    conformal_quantile,
    conformal_rank,
    miscoverage,
    samples_needed,
)
from uncal.uncertainty.coverage_law import coverage_band, coverage_law
from uncal.uncertainty.dropout import dropout_rates
from uncal.uncertainty.errors import (
    NotCalibratedError,
    PredictorMismatchError,
    UncertaintyError,
)
from uncal.uncertainty.fingerprint import PredictorIdentity, fingerprint
from uncal.uncertainty.mc_dropout import MCDropout, Prediction

__all__ = [
    "ConformalCalibrator",
    "Intervals",
    "MCDropout",
    "NotCalibratedError",
    "Prediction",
    "PredictorIdentity",
    "PredictorMismatchError",
    "UncertaintyError",
    "conformal_quantile",
    "conformal_rank",
    "coverage_band",
    "coverage_law",
    "dropout_rates",
    "fingerprint",
    "miscoverage",
    "samples_needed",
]
