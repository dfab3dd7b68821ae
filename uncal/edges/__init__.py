"""Edges of a LiDAR sweep, where they really are, and what an image has there."""
