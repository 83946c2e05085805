"""The shapes, one file each. A new shape is a new file and its name here."""

from lidarsim.shapes._shape import Hits, Shape
from lidarsim.shapes.box import Box
from lidarsim.shapes.capsule import Capsule
from lidarsim.shapes.cylinder import Cylinder
from lidarsim.shapes.disk import Disk
from lidarsim.shapes.disks import Disks
from lidarsim.shapes.ellipsoid import Ellipsoid
from lidarsim.shapes.plane import Plane
from lidarsim.shapes.polygon import Polygon
from lidarsim.shapes.sphere import Sphere
from lidarsim.shapes.spheres import Spheres
from lidarsim.shapes.triangle import Triangle
from lidarsim.shapes.triangle_mesh import TriangleMesh

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
