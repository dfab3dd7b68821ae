"""Callbacks of Lightning, and one of Hydra."""
