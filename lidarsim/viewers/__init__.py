"""Viewers of clouds, scans and scenes: one module per library, and `show` for all of them."""

from lidarsim.viewers import cells, html, open3d, pyvista
from lidarsim.viewers._show import show

__all__ = ["cells", "html", "open3d", "pyvista", "show"]
