"""Exact and fast lidar simulation."""
