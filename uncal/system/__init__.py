"""Disk, locks, memory and progress bars."""
