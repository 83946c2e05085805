"""The shapes, one file each. A new shape is a new file and its name here."""

from lidarsim.world.shapes._shape import Hits, Shape
from lidarsim.world.shapes.box import Box
from lidarsim.world.shapes.capsule import Capsule
from lidarsim.world.shapes.cylinder import Cylinder
from lidarsim.world.shapes.disk import Disk
from lidarsim.world.shapes.disks import Disks
from lidarsim.world.shapes.ellipsoid import Ellipsoid
from lidarsim.world.shapes.plane import Plane
from lidarsim.world.shapes.polygon import Polygon
from lidarsim.world.shapes.sphere import Sphere
from lidarsim.world.shapes.spheres import Spheres
from lidarsim.world.shapes.triangle import Triangle
from lidarsim.world.shapes.triangle_mesh import TriangleMesh

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "Disk",
    "Disks",
    "Ellipsoid",
    "Hits",
    "Plane",
    "Polygon",
    "Shape",
    "Sphere",
    "Spheres",
    "Triangle",
    "TriangleMesh",
]
