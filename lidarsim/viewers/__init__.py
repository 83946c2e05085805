"""Views of a point cloud: one module a library, which registers its conversion."""

from lidarsim.viewers import open3d, pyvista

__all__ = ["open3d", "pyvista"]
