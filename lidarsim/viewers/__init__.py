"""Views of clouds, scans and scenes: one module a library, and one function that shows things in any of them."""

from lidarsim.viewers import html, open3d, pyvista
from lidarsim.viewers._show import show

__all__ = ["html", "open3d", "pyvista", "show"]
