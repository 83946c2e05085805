"""File formats: one module a format, which registers itself."""

from lidarsim.io import npz, pcd, ply

__all__ = ["npz", "pcd", "ply"]
