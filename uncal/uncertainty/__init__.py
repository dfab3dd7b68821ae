"""Error bars for any regression network: MC dropout, conformal calibration, exact coverage laws."""

from uncal.errors import (
    NotCalibratedError,
    PredictorMismatchError,
    UncertaintyError,
)
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator
from uncal.uncertainty.conformal.groups import HierarchicalCalibrator, MondrianCalibrator
from uncal.uncertainty.conformal.intervals import Intervals
from uncal.uncertainty.conformal.quantile import (
    conformal_quantile,
    conformal_rank,
    coverage_band,
    coverage_law,
    miscoverage,
    samples_needed,
)
from uncal.uncertainty.conformal.split_conformal import (
    AbsoluteCalibrator,
    ConformalCalibrator,
    GaussianIntervals,
    QuantileCalibrator,
)
from uncal.uncertainty.dropout.fingerprint import PredictorIdentity, fingerprint
from uncal.uncertainty.dropout.layers import dropout_layers, dropout_rates, insert_dropout
from uncal.uncertainty.dropout.masks import FixedMasks
from uncal.uncertainty.dropout.mc_dropout import MCDropout
from uncal.uncertainty.dropout.prediction import Prediction

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
