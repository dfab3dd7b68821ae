"""Multiruns of Hydra: what is planned, what the jobs left, and the summary of them all."""
