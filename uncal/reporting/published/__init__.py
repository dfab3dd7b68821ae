"""Numbers that others have published, each with its source, to stand beside a run's."""
