"""Error bars you can trust on online camera-LiDAR calibration."""

__version__ = "0.1.0"
