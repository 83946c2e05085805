"""What `PointCloud.load` says of files that it does not read: what converts them, or what reads them."""

from __future__ import annotations

from lidarsim.io import rosbag, scenes
from lidarsim.scan.formats import is_point_cloud, register_unread

PCAP = "d4c3b2a1", "a1b2c3d4", "4d3cb2a1", "a1b23c4d", "0a0d0d0a"
"""First bytes of captures in either byte order, with times in µs or ns, and of pcapng."""

SCENES = {".lwo", ".sdf", ".tif", ".tiff", ".urdf", ".world", ".xacro", *scenes.MODULES} - {".json"}
COMPRESSED = ".7z", ".bz2", ".gz", ".xz", ".zip", ".zst", ".zstd"

register_unread(".bag", rosbag.ROS_1_HINT, rosbag.ROS_1)
for _suffix in (".pcap", ".pcapng"):
    register_unread(
        _suffix,
        "recorded packets are not read; convert them to a ROS 2 bag, LAS or PCD with software of the sensor, such as"
        " ouster-cli, velodyne_decoder or HesaiLidar_SDK_2.0",
        *map(bytes.fromhex, PCAP),
    )
for _suffix in COMPRESSED:
    register_unread(_suffix, "compressed files are not read, but for bags by lidarsim.io.rosbag.read; decompress it")
for _suffix in (".vtk", ".vtp", ".vtu"):
    register_unread(_suffix, "VTK files are read by PyVista: PointCloud.from_pyvista(pyvista.read(path))")
for _suffix in sorted(SCENES):
    if not is_point_cloud(f"file{_suffix}"):
        register_unread(
            _suffix, "it is of a scene, not of points: lidarsim.Scene.from_file reads scenes, to be scanned"
        )
register_unread(".npy", "an array does not name its columns: PointCloud(numpy.load(path)[:, :3])")
register_unread(".fls", "scans of FARO are not read; convert them to E57 with FARO SCENE")
register_unread(".rcp", "projects of ReCap are not read; convert them to E57 with ReCap")
register_unread(".rcs", "scans of ReCap are not read; convert them to E57 with ReCap")
