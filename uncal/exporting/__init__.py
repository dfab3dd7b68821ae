"""A trained network with its masks, rounds and quantiles as one graph."""
