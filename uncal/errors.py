"""Errors a user can act on: each names the file or key, what was expected and the remedy."""

from __future__ import annotations


class UncalError(Exception):
    """Base class; entry points print its message without a traceback."""


class RecordingError(UncalError):
    """A recording as a whole cannot be used (missing root, no frames, unreadable calibration)."""


class FrameError(UncalError):
    """One frame cannot be used; the run skips it, counts it and reports it."""


class ConfigurationError(UncalError):
    """A setting is out of its range or does not fit another setting."""


class DivergenceError(UncalError):
    """A training whose loss is no longer a finite number."""


class CalibrationMissing(RecordingError):
    """A calibration file is not there."""


class RotationError(RecordingError):
    """What a file gives for a rotation is none."""


class NothingPaired(RecordingError):
    """A recording of which no frame has both an image (or events) and a scan."""


class UncertaintyError(UncalError, ValueError):
    """These numbers, or this predictor, allow no valid interval."""


class NotCalibratedError(UncertaintyError, RuntimeError):
    """Intervals were asked for before the calibrator was fitted or loaded."""


class PredictorMismatchError(UncertaintyError):
    """The predictor is not the one whose scores the calibrator holds."""
