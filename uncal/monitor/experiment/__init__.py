"""Does the monitor work? Simulated drives in which the LiDAR moves, faults, and neither."""
