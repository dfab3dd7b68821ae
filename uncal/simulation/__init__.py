"""Simulated recordings, written in the layouts of the real ones."""
