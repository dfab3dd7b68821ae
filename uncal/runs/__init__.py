"""What the entry points share: from a configuration to a run's objects and results."""
