"""What a configuration may say: every key has a reader, every value its bounds, before any work."""
