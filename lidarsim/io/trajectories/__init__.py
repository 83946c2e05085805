"""Formats of trajectories: one module per format, which registers itself."""

from lidarsim.io.trajectories import csv, kitti, nuscenes, tum  # noqa: F401 - each registers itself
