"""File formats: one module per format, which registers itself."""

from lidarsim.io import (  # noqa: F401 - each registers itself
    e57,
    kitti,
    las,
    meshes,
    npz,
    nuscenes,
    packets,
    pcd,
    ply,
    pts,
    ptx,
    raster,
    rosbag,
    scenes,
    semantickitti,
    text,
    trajectories,
    unread,
    waveforms,
)

__all__ = ["las", "packets", "rosbag", "semantickitti"]
