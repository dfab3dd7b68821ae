"""Event cameras: the stream and the tensors made of it."""
