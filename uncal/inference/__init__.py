"""Stochastic passes over a whole split, the image-blind control, and their settings."""
