"""Which frames train, validate, calibrate the uncertainty and test."""
