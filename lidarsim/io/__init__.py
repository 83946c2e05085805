"""File formats: one module a format, which registers itself."""

from lidarsim.io import kitti, las, npz, nuscenes, pcd, ply, semantickitti, text  # noqa: F401 - each registers itself

__all__ = ["las", "semantickitti"]
