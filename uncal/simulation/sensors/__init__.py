"""Simulated cameras and LiDARs, and how a rig mounts them."""
