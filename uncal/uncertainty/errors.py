"""What can go wrong between a network's samples and an interval."""

from __future__ import annotations

from uncal.errors import UncalError


class UncertaintyError(UncalError, ValueError):
    """These numbers, or this predictor, allow no valid interval."""


class NotCalibratedError(UncertaintyError, RuntimeError):
    """Intervals were asked for before the calibrator was fitted or loaded."""


class PredictorMismatchError(UncertaintyError):
    """The predictor is not the one whose scores the calibrator holds."""
