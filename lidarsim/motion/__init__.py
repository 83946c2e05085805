"""Poses over time, and where the world is on the Earth."""
