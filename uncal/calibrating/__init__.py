"""Calibration on a user's own recordings: with a trusted extrinsic, and without one."""
