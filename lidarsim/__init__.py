"""Exact and fast lidar simulation: scan patterns, analytic ray casting, datasheet noise, point clouds.

A `Scene` holds shapes, and a `Lidar` scans it. The `Scan` says what happened to each pulse; `Scan.point_cloud` returns
the points with their truth, a `PointCloud`, and `Scan.plot` shows them. `config.load` reads a configuration, such as
``"demo"``, `generate` makes a data set, and `compare` holds simulated points against real ones.

The guide, with one task a section, is ``examples/README.md`` in the repository; ``configs/README.md`` documents
configurations, recipes and the layouts of data sets, and ``lidarsim/io/README.md`` file formats.

SI units and radians. Right-handed frames; the sensor frame has x forward, y left, z up.
"""

from lidarsim import config, datasets, errors, io, materials, mujoco, patterns
from lidarsim import viewers as viewers  # registers views
from lidarsim._georeference import Georeference
from lidarsim.atmosphere import Atmosphere
from lidarsim.batch import ScanBatch, scan_many
from lidarsim.boxes import Boxes
from lidarsim.cells import Cells
from lidarsim.comparison import Comparison, compare
from lidarsim.datasets import generate
from lidarsim.gnss import Gnss, GnssFixes
from lidarsim.imu import Imu, ImuErrors, ImuSamples
from lidarsim.io import vendors  # noqa: F401 (registers its readers)
from lidarsim.laser_scan import LaserScan
from lidarsim.live import stream
from lidarsim.materials import Material, Texture
from lidarsim.measurement import Beam, Detection, Measurement
from lidarsim.occupancy_grid import OccupancyGrid, occupancy
from lidarsim.pointcloud import PointCloud, register_format
from lidarsim.rig import Rig, RigSensor
from lidarsim.rules import Rule
from lidarsim.scan import Scan, Source, Status
from lidarsim.scene import Scene, SceneObject, register_scene_reader
from lidarsim.sensor import Lidar, register_lidar_reader
from lidarsim.shapes import (
    Box,
    Capsule,
    Cylinder,
    Disk,
    Disks,
    Ellipsoid,
    Hits,
    Plane,
    Polygon,
    Shape,
    Sphere,
    Spheres,
    Triangle,
    TriangleMesh,
)
from lidarsim.trajectory import Trajectory, register_trajectory_format
from lidarsim.viewers import show
from lidarsim.waveforms import Waveforms

__all__ = [
    "Atmosphere",
    "Beam",
    "Box",
    "Boxes",
    "Capsule",
    "Cells",
    "Comparison",
    "Cylinder",
    "Detection",
    "Disk",
    "Disks",
    "Ellipsoid",
    "Georeference",
    "Gnss",
    "GnssFixes",
    "Hits",
    "Imu",
    "ImuErrors",
    "ImuSamples",
    "LaserScan",
    "Lidar",
    "Material",
    "Measurement",
    "OccupancyGrid",
    "Plane",
    "PointCloud",
    "Polygon",
    "Rig",
    "RigSensor",
    "Rule",
    "Scan",
    "ScanBatch",
    "Scene",
    "SceneObject",
    "Shape",
    "Source",
    "Sphere",
    "Spheres",
    "Status",
    "Texture",
    "Trajectory",
    "Triangle",
    "TriangleMesh",
    "Waveforms",
    "__version__",
    "compare",
    "config",
    "datasets",
    "errors",
    "generate",
    "io",
    "materials",
    "mujoco",
    "occupancy",
    "patterns",
    "register_format",
    "register_lidar_reader",
    "register_scene_reader",
    "register_trajectory_format",
    "scan_many",
    "show",
    "stream",
]

__version__ = "0.1.0"
