"""File formats: one module a format, which registers itself."""

from lidarsim.io import npz, pcd, ply, trajectories  # noqa: F401 - each registers itself
