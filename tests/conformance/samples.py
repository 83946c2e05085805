"""Samples of the shapes, from which the conformance suite and the hard cases are generated.

A sample constructs its shape under a `Move`, so that the suite can shift, turn and scale it without rounding. Its
numbers are multiples of 1/64 within [-1.5, 1.5]. `exact.oracle` has a class of the same name to judge it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from exact.spec import Spec


@dataclass(frozen=True)
class Move:
    """p → scale · turn · p + shift; exact while the turn is of quarters and the rest are sums of powers of two."""

    turn: np.ndarray = field(default_factory=lambda: np.eye(3))
    scale: float = 1.0
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def point(self, p: Any) -> np.ndarray:
        return self.vector(p) + self.shift

    def vector(self, v: Any) -> np.ndarray:
        return np.asarray(v, dtype=float) @ self.turn.T * self.scale

    def direction(self, v: Any) -> np.ndarray:
        return np.asarray(v, dtype=float) @ self.turn.T

    def extents(self, v: Any) -> np.ndarray:
        return np.abs(self.vector(v))

    def length(self, x: float) -> float:
        return x * self.scale


@dataclass(frozen=True)
class Sample:
    """A shape under test. `inside` is a point inside it if it is closed."""

    name: str
    kind: str
    arguments: Callable[[Move], tuple[Any, ...]]
    inside: tuple[float, float, float] | None = None

    @property
    def shape(self) -> str:
        """Name of the class."""
        return self.kind.partition(".")[0]

    def spec(self, move: Move | None = None, transform: np.ndarray | None = None) -> Spec:
        return Spec(self.kind, self.arguments(move or Move()), transform)

    def build(self, move: Move | None = None, transform: np.ndarray | None = None) -> Any:
        return self.spec(move, transform).build()


# A turn whose entries are not dyadic: they are taken as they are.
TURN = np.array([[0.6, -0.8, 0.0], [0.48, 0.36, -0.8], [0.64, 0.48, 0.6]])

ARROW = [(-1, -1, -0.75), (1, -1, 0.25), (0.25, 0, 0.125), (1, 1, 0.75), (-1, 1, -0.25), (-0.5, 0, -0.25)]

# A double pyramid over a square, its apexes off the axis.
VERTICES = [(1, 0, 0.125), (0, 1, -0.125), (-1, 0, 0.125), (0, -1, -0.125), (0.125, 0.25, 1.25), (-0.25, 0.125, -1)]
FACES = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4), (1, 0, 5), (2, 1, 5), (3, 2, 5), (0, 3, 5)]

# Several leaves of spheres or disks on a lattice, so that many lines touch several; the last repeats the first.
PLACES = [(x / 2, y / 2, (x + 2 * y) / 8) for x in (-2, -1, 0, 1, 2) for y in (-2, -1, 0, 1, 2)] + [(-1, -1, -0.75)]
NORMALS = [(1, i % 5 - 2, 3 - i % 4) for i in range(25)] + [(1, -2, 3)]
WIDTHS = [(2 + i % 3) / 8 for i in range(25)] + [0.25]

SAMPLES = [
    Sample(
        "plane",
        "Plane",
        lambda m: (m.direction((1, 2, 3)), m.length(0.5) + float(m.direction((1, 2, 3)) @ m.shift)),
    ),
    Sample("plane-of-a-point", "Plane.from_point", lambda m: (m.point((0.25, 0.5, -0.125)), m.direction((3, -1, 2)))),
    Sample(
        "plane-of-three-points",
        "Plane.from_points",
        lambda m: (m.point((0, 0, 0.25)), m.point((1, 0, 0.5)), m.point((0, 1, -0.25))),
    ),
    Sample("sphere", "Sphere", lambda m: (m.point((0.25, -0.125, 0.5)), m.length(1.0)), (0.5, 0, 0.25)),
    Sample(
        "ellipsoid",
        "Ellipsoid",
        lambda m: (m.point((0.25, -0.125, 0.25)), m.length(1.0) * np.array((1.25, 0.5, 0.75)), m.turn @ TURN),
        (0.25, 0, 0.25),
    ),
    Sample("box", "Box", lambda m: (m.extents((1.5, 1.0, 0.75)), m.point((0.125, 0.25, -0.125))), (0.25, 0.25, -0.25)),
    Sample(
        "cylinder",
        "Cylinder",
        lambda m: (m.point((0, 0.25, -1)), m.point((0.25, 0, 1)), m.length(0.75)),
        (0.25, 0.25, 0.5),
    ),
    Sample(
        "open-cylinder",
        "Cylinder",
        lambda m: (m.point((-1, 0.25, 0)), m.point((1, 0, 0.25)), m.length(0.75), False),
    ),
    Sample(
        "capsule",
        "Capsule",
        lambda m: (m.point((0.125, 0.25, -0.75)), m.point((0.25, -0.125, 0.5)), m.length(0.625)),
        (0.25, 0.125, 0.25),
    ),
    Sample("disk", "Disk", lambda m: (m.point((0.125, -0.25, 0.25)), m.direction((1, -2, 3)), m.length(1.25))),
    Sample("spheres", "Spheres", lambda m: (m.point(PLACES), m.length(1.0) * np.array(WIDTHS))),
    Sample("disks", "Disks", lambda m: (m.point(PLACES), m.direction(NORMALS), m.length(1.0) * np.array(WIDTHS))),
    Sample(
        "triangle",
        "Triangle",
        lambda m: (m.point((1.25, 0.125, 0.25)), m.point((-0.75, 1, 0.125)), m.point((-0.5, -1, 0.5))),
    ),
    Sample("polygon", "Polygon", lambda m: (m.point(ARROW),)),
    Sample("mesh", "TriangleMesh", lambda m: (m.point(VERTICES), np.array(FACES)), (0.125, 0.125, 0.25)),
]
