"""Readers of recordings on disk; each turns a folder into frames."""
