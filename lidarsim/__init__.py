"""Exact and fast lidar simulation: scan patterns, analytic ray casting, datasheet noise, point clouds.

SI units and radians. Right-handed frames; the sensor frame has x forward, y left, z up.
"""

from lidarsim import errors, patterns
from lidarsim.materials import Material
from lidarsim.scene import Scene, SceneObject
from lidarsim.shapes import (
    Box,
    Cylinder,
    Ellipsoid,
    Hits,
    Plane,
    Polygon,
    Shape,
    Sphere,
    Triangle,
    TriangleMesh,
)

__all__ = [
    "Box",
    "Cylinder",
    "Ellipsoid",
    "Hits",
    "Material",
    "Plane",
    "Polygon",
    "Scene",
    "SceneObject",
    "Shape",
    "Sphere",
    "Triangle",
    "TriangleMesh",
    "errors",
    "patterns",
]
