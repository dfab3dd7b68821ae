"""Figures of runs and multiruns, for the report, TensorBoard and papers."""
