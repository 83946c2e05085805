"""Exact and fast lidar simulation: scan patterns, analytic ray casting, datasheet noise, point clouds.

A `Scene` holds shapes, and a `Lidar` scans it. The `Scan` says what happened to each pulse; `Scan.point_cloud` returns
the points with their truth, a `PointCloud`, and `Scan.plot` shows them. `config.load` reads a configuration, such as
``"demo"``, `generate` makes a data set, `compare` holds simulated points against real ones, and `fit` fits a sensor to
real ones.

Pages by task are in ``examples/`` of the repository. ``configs/README.md`` documents configurations, recipes and the
layouts of data sets, and ``lidarsim/io/README.md`` file formats.

SI units and radians. Right-handed frames; the sensor frame has x forward, y left, z up.
"""

from importlib import import_module
from typing import TYPE_CHECKING

try:
    import lidarsim._native as _core
except ImportError as error:
    raise ImportError(
        f"lidarsim has no compiled core for this Python in {__path__[0]} ({error}): "
        "run `pip install --editable .` in the clone, or leave the clone to use an installed lidarsim"
    ) from None

__version__ = "0.1.0"

if _core.__version__ != __version__:
    raise ImportError(
        f"lidarsim {__version__} in {__path__[0]} has the compiled core of {_core.__version__}: "
        "run `pip install --editable .` in the clone, or reinstall lidarsim"
    )

from lidarsim import config, datasets, errors, io, materials, mujoco, patterns, worlds
from lidarsim import viewers as viewers  # registers views
from lidarsim._base.names import instead
from lidarsim.datasets import generate
from lidarsim.io import vendors  # noqa: F401 (registers its readers)
from lidarsim.lidar import Lidar, register_lidar_reader
from lidarsim.materials import Material, Texture
from lidarsim.motion.formats import register_trajectory_format
from lidarsim.motion.georeference import Georeference
from lidarsim.motion.trajectory import Trajectory
from lidarsim.rig import Rig, RigSensor
from lidarsim.scan.batch import ScanBatch, scan_many
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.cells import Cells
from lidarsim.scan.formats import register_format
from lidarsim.scan.laser_scan import LaserScan
from lidarsim.scan.occupancy_grid import OccupancyGrid, occupancy
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Scan, Source, Status
from lidarsim.scan.waveforms import Waveforms
from lidarsim.sensor.gnss import Gnss, GnssFixes
from lidarsim.sensor.imu import Imu, ImuErrors, ImuSamples
from lidarsim.sensor.measurement import Beam, Detection, Measurement, Response
from lidarsim.viewers import show
from lidarsim.world.atmosphere import Atmosphere
from lidarsim.world.rules import Rule
from lidarsim.world.scene import Scene, SceneObject, register_scene_reader
from lidarsim.world.shapes import (
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

if TYPE_CHECKING:
    from lidarsim.comparison import Comparison, compare, fit
    from lidarsim.live import stream

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
    "Response",
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
    "fit",
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
    "worlds",
]


if not TYPE_CHECKING:  # type checkers know all names
    _RARE = {"Comparison": "comparison", "compare": "comparison", "fit": "comparison", "stream": "live"}
    """Modules by name, imported for the name when it is first used."""

    def __getattr__(name: str) -> object:
        """Return a name that few scripts use; raise an error that says where a name is that the package lacks."""
        if name in _RARE:
            return globals().setdefault(name, getattr(import_module(f"lidarsim.{_RARE[name]}"), name))
        place = next((module.__name__ for module in (patterns, materials, datasets, io) if hasattr(module, name)), "")
        hint = instead("lidarsim", name, [] if place else __all__) or (place and f"it is {place}.{name}")
        problem = f"module 'lidarsim' has no attribute {name!r}"
        raise AttributeError(f"{problem}; {hint}" if hint and not name.startswith("_") else problem)

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
