"""Benchmark scenes, generated from seeds, and their rays.

Three meshes represent typical lidar simulations: a city (a few large triangles beside finely meshed round objects),
terrain (a height field), and scans (closed surfaces of uneven triangles). The analytic scene has curved shapes and
boxes; casters that need triangles get its tessellations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from lidarsim.patterns import Spinning

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Triangles = tuple[Floats, Integers]

UTM = np.array([448_262.25, 5_411_932.125, 113.7])
"""A place in UTM coordinates, m."""


@dataclass(frozen=True)
class Spec:
    """A shape by the name of its class or constructor, its arguments and its transform.

    Attributes
    ----------
    kind : str
        Class or constructor, such as ``"Sphere"`` or ``"Plane.from_point"``.
    args : tuple
        Arguments of the constructor.
    transform : ndarray of float64, shape (4, 4), optional
        Affine transform of the shape.
    """

    kind: str
    args: tuple[Any, ...]
    transform: Floats | None = None

    def build(self) -> Any:
        """Return lidarsim's shape."""
        import lidarsim

        return attrgetter(self.kind)(lidarsim)(*self.args, transform=self.transform)


def rotations(count: int, seed: int) -> Floats:
    """Return random rotation matrices, (count, 3, 3)."""
    matrices: Floats = Rotation.random(count, rng=np.random.default_rng(seed)).as_matrix()
    return matrices


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays in firing order: origins and unit directions, (n, 3)."""

    name: str
    origins: Floats
    directions: Floats
    one_origin: bool

    def __len__(self) -> int:
        return len(self.directions)

    def __getitem__(self, rows: Any) -> Rays:
        return replace(self, origins=self.origins[rows].copy(), directions=self.directions[rows].copy())


@dataclass(frozen=True, eq=False)
class World:
    """A scene, the position of its sensor, and the box in which random rays start.

    A world of one mesh may be the tessellation of another world; `owner` then has the object of each triangle.
    """

    name: str
    shapes: tuple[Spec, ...]
    sensor: Floats
    low: Floats
    high: Floats
    owner: Integers | None = field(default=None, repr=False)

    @property
    def mesh(self) -> Triangles | None:
        """Vertices and faces if the world is one mesh, else None."""
        first = self.shapes[0]
        return first.args if first.kind == "TriangleMesh" and first.transform is None else None

    @property
    def triangles(self) -> int:
        """Number of triangles, 0 if the world is not a mesh."""
        return 0 if self.mesh is None else len(self.mesh[1])

    @property
    def far(self) -> bool:
        """Whether the world is far from the origin of coordinates."""
        return self.name.endswith(" at UTM")

    def tessellate(self, level: int) -> World:
        """Return this world as triangles: round shapes become icospheres of this level or prisms of similar edges."""
        vertices, faces, owner = _join(_tessellate(spec, level) for spec in self.shapes)
        return replace(self, shapes=(Spec("TriangleMesh", (vertices, faces)),), owner=owner)


def lidar(world: World, channels: int, columns: int, field_of_view: float) -> Rays:
    """Return one turn of a spinning lidar at rest, column by column."""
    pulses = spinning(channels, columns, field_of_view).pulses()
    directions = np.ascontiguousarray(pulses.directions)
    return Rays(f"{channels} × {columns}", np.tile(world.sensor, (len(directions), 1)), directions, one_origin=True)


def spinning(channels: int, columns: int, field_of_view: float) -> Spinning:
    """Return the pattern of `lidar`: channels equally spaced over a vertical field of view, rad, about the horizon."""
    return Spinning(np.linspace(-field_of_view / 2, field_of_view / 2, channels), columns=columns)


def random_rays(world: World, count: int) -> Rays:
    """Return rays with uniform directions and uniform origins in the world's box."""
    rng = np.random.default_rng((0, 7))
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Rays("random", rng.uniform(world.low, world.high, (count, 3)), directions, one_origin=False)


def downward(count: int) -> Rays:
    """Return rays from a point at a height of 40 m to points of a disc of radius 14 m at the origin, row by row."""
    rng = np.random.default_rng((0, 11))
    radius, angle = rng.uniform(0, 14.0, count), rng.uniform(0, 2 * np.pi, count)
    targets = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)])
    targets = targets[np.lexsort((targets[:, 0], np.round(targets[:, 1])))]
    origin = np.array([4.0, -7.0, 40.0])
    directions = (targets - origin) / np.linalg.norm(targets - origin, axis=1, keepdims=True)
    return Rays("downward", np.tile(origin, (count, 1)), directions, one_origin=True)


def coincident(triangles: int = 130_000) -> dict[str, tuple[list[Spec], list[Spec]]]:
    """Return scenes for `downward` rays by name: without and with a second surface that coincides with the first."""
    turn = np.eye(4)
    turn[:3] = np.column_stack([Rotation.from_rotvec((0.5, -0.7, 1.1)).as_matrix(), (1.0, 2.0, 3.0)])
    lowered = np.eye(4)
    lowered[2, 3] = -0.125
    vertices, faces = terrain(triangles).shapes[0].args
    flat = np.array([0.2, 0.2, 0.0])
    hills, field = Spec("TriangleMesh", (0.2 * vertices, faces)), Spec("TriangleMesh", (flat * vertices, faces))
    ground, box = Spec("Plane", (np.array([0.0, 0.0, 1.0]), 0.0)), (np.array([30.0, 20.0, 10.0]), np.zeros(3))
    top = Spec("Box", (np.array([60.0, 60.0, 1.0]), np.array([0.0, 0.0, -0.5])))
    slab = Spec("Box", (np.array([60.0, 60.0, 0.25]), np.zeros(3)), lowered)
    ellipsoid = Spec("Ellipsoid", (np.zeros(3), np.array([30.0, 20.0, 10.0]), turn[:3, :3]))
    cylinder = Spec("Cylinder", (np.array([-10.0, -5.0, -8.0]), np.array([12.0, 3.0, 4.0]), 9.0))
    twice = {
        "a plane": ground,
        "an ellipsoid": ellipsoid,
        "a cylinder": cylinder,
        "a turned box": Spec("Box", box, turn),
        "a mesh": hills,
        "a turned mesh": replace(hills, transform=turn),
    }
    return {f"{name}, twice": ([spec], [spec, spec]) for name, spec in twice.items()} | {
        "a mesh, each triangle twice": (
            [hills],
            [Spec("TriangleMesh", (0.2 * vertices, np.concatenate([faces, faces])))],
        ),
        "a plane and the top of a box": ([ground], [ground, top]),
        "a plane and the top of a box put there": ([ground], [ground, slab]),
        "a flat height field in a plane": ([field], [field, ground]),
    }


def city(triangles: int = 740_000, offset: npt.ArrayLike = (0.0, 0.0, 0.0)) -> World:
    """Return streets of boxes and poles, and 36 finely meshed spheres with nearly all triangles."""
    rng = np.random.default_rng(1)
    level = max(0, round(math.log(triangles / (36 * 20), 4)))
    sphere, faces = _icosphere(level)
    parts = [_quad(300.0, 0.0)]
    for x in range(-112, 113, 32):
        for y in range(-112, 113, 32):
            size = np.array([*rng.uniform(12, 20, 2), rng.uniform(6, 30)])
            parts.append(_tessellate(Spec("Box", (size, np.array([x, y, size[2] / 2]))), 0))
            foot = np.array([x + 11.5, y + 11.5, 0.0])
            top = foot + np.array([0.0, 0.0, 8.0])
            parts.append(_tessellate(Spec("Cylinder", (foot, top, 0.1)), 2))
    for k in range(36):
        radius = rng.uniform(1.0, 2.5)
        street, along = 32 * rng.integers(-1, 2) + rng.uniform(-3, 3), rng.uniform(6, 60) * rng.choice([-1, 1])
        center = np.array([*([street, along] if k % 2 else [along, street]), radius])
        parts.append((center + radius * sphere, faces))
    return _mesh_world("city", _join(parts)[:2], [(0, 0, 2), (-120, -120, 0.5), (120, 120, 30)], offset)


def terrain(triangles: int = 1_000_000, offset: npt.ArrayLike = (0.0, 0.0, 0.0)) -> World:
    """Return a fractal height field, 700 m wide, with the sensor on a mast of 20 m.

    It is a sum of random heights on lattices, each twice as fine and 0.55 times as high as the previous one. More
    triangles add finer lattices to the same terrain.
    """
    n = round(math.sqrt(triangles / 2)) + 1
    rng = np.random.default_rng(2)
    s = np.linspace(0.0, 1.0, n)
    z = np.zeros((n, n))
    for octave in range(2, math.ceil(math.log2(n)) + 1):
        nodes = np.arange(2**octave + 1)
        hats = np.maximum(0.0, 1.0 - np.abs(s[:, None] * 2**octave - nodes))
        z += hats @ rng.normal(scale=40.0 * 0.55**octave, size=(len(nodes), len(nodes))) @ hats.T
    z -= z[n // 2, n // 2]
    x, y = np.meshgrid(700 * s - 350, 700 * s - 350)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return _mesh_world("terrain", (vertices, faces), [(0, 0, 20), (-350, -350, z.min()), (350, 350, z.max())], offset)


def scans(triangles: int = 718_000, offset: npt.ArrayLike = (0.0, 0.0, 0.0)) -> World:
    """Return ten closed bumpy bodies in a hall, with triangles as uneven as those of real scans."""
    rng = np.random.default_rng(3)
    points, faces = _uneven_ball(triangles // 10, rng)
    hall = Spec("Box", (np.array([40.0, 30.0, 8.0]), np.array([0.0, 0.0, 4.0])))
    parts = [_tessellate(hall, 0)]
    for k in range(10):
        frequency = rng.normal(size=(40, 3)) * np.geomspace(1, 30, 40)[:, None]
        bumps = np.sin(points @ frequency.T + rng.uniform(0, 2 * np.pi, 40)) @ (
            0.25 / np.linalg.norm(frequency, axis=1)
        )
        body = points * (1 + 0.6 * bumps + rng.normal(scale=5e-4, size=len(points)))[:, None] * rng.uniform(1.2, 1.8, 3)
        angle = 2 * np.pi * k / 10
        place = np.array([(5 + 4 * (k % 3)) * np.cos(angle), (5 + 3 * (k % 3)) * np.sin(angle), 0.1 - body[:, 2].min()])
        parts.append((body + place, faces))
    return _mesh_world("scans", _join(parts)[:2], [(0, 0, 1.5), (-19, -14, 0.5), (19, 14, 7.5)], offset)


def instances(triangles: int = 64_618) -> World:
    """Return 50 copies of one closed body, which overlap like the trees of a forest."""
    mesh, draw = body(triangles), np.random.default_rng(6)
    places = np.tile(np.eye(4), (50, 1, 1))
    places[:, :3, :3] = rotations(50, 6)
    places[:, :3, 3] = draw.uniform((-12, -12, -1), (12, 12, 2), (50, 3))
    shapes = tuple(Spec("TriangleMesh", mesh, place) for place in places)
    return World("instances", shapes, np.array([0.0, 0.0, 1.0]), np.full(3, -12.0), np.full(3, 12.0))


def merge(world: World) -> World:
    """Merge a world of placed meshes into one mesh; the owner of a triangle is its object."""
    parts = [(*spec.args, np.eye(4) if spec.transform is None else spec.transform) for spec in world.shapes]
    vertices, faces, owner = _join((v @ place[:3, :3].T + place[:3, 3], f) for v, f, place in parts)
    return replace(world, shapes=(Spec("TriangleMesh", (vertices, faces.astype(np.uint32))),), owner=owner)


def body(triangles: int) -> Triangles:
    """Return one closed body with triangles as uneven as those of `scans`."""
    rng = np.random.default_rng(5)
    points, faces = _uneven_ball(triangles, rng)
    return points * (1.5 + 0.3 * np.sin(9 * points[:, [1]]) * np.cos(7 * points[:, [2]])), faces


def _uneven_ball(triangles: int, rng: np.random.Generator) -> Triangles:
    """Return points of uneven density on the unit sphere, and the faces of their convex hull, oriented outward."""
    from scipy.spatial import ConvexHull

    points = rng.normal(size=(triangles // 2, 3))  # a closed mesh has about two triangles per vertex
    dense = rng.normal(size=(5, 3))
    points += dense[rng.integers(0, 5, len(points))] * rng.uniform(0, 1.2, (len(points), 1))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(points)
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    return points, np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int64)


def analytic(shapes: int = 400, offset: npt.ArrayLike = (0.0, 0.0, 0.0), seed: int = 4) -> World:
    """Return equally many spheres, boxes, cylinders and ellipsoids, 0.3 m to 2 m in radius, over a plane."""
    rng = np.random.default_rng(seed)
    shift = np.asarray(offset, dtype=np.float64)
    specs = [Spec("Plane.from_point", (shift.copy(), np.array([0.0, 0.0, 1.0])))]
    for k in range(shapes):
        distance, angle = np.sqrt(rng.uniform(6**2, 60**2)), rng.uniform(0, 2 * np.pi)
        height = rng.uniform(0.3, 3 + 0.3 * distance)
        center = shift + np.array([distance * np.cos(angle), distance * np.sin(angle), height])
        radii = rng.uniform(0.3, 2.0, 3)
        turn = Rotation.random(rng=rng)
        specs.append(
            (
                Spec("Sphere", (center, float(radii[0]))),
                Spec("Box", (2 * radii, center)),
                Spec("Cylinder", (center, center + 2 * radii[1] * turn.as_matrix()[2], float(radii[0] / 2))),
                Spec("Ellipsoid", (center, radii, turn.as_matrix())),
            )[k % 4]
        )
    sensor, low, high = shift + np.array([(0.0, 0.0, 2.0), (-60.0, -60.0, 0.1), (60.0, 60.0, 20.0)])
    return World(_place("analytic", shift), tuple(specs), sensor, low, high)


def _mesh_world(name: str, mesh: Triangles, places: Any, offset: npt.ArrayLike) -> World:
    """Return a world of one mesh, moved by `offset`; `places`: sensor and corners of the box for random rays."""
    shift = np.asarray(offset, dtype=np.float64)
    vertices, faces = mesh
    spec = Spec("TriangleMesh", (vertices + shift, faces.astype(np.uint32)))
    sensor, low, high = shift + np.array(places, dtype=np.float64)
    return World(_place(name, shift), (spec,), sensor, low, high)


def _place(name: str, shift: Floats) -> str:
    return f"{name} at UTM" if shift.any() else name


def _join(parts: Iterable[Triangles]) -> tuple[Floats, Integers, Integers]:
    """Merge meshes into one: vertices, faces, and the part of each face."""
    vertices, faces = zip(*parts, strict=True)
    starts = np.cumsum([0, *(len(v) for v in vertices[:-1])])
    owner = np.repeat(np.arange(len(faces)), [len(f) for f in faces])
    return np.concatenate(vertices), np.concatenate([f + s for f, s in zip(faces, starts, strict=True)]), owner


def _quad(half: float, z: float) -> Triangles:
    corners = half * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return np.column_stack([corners, np.full(4, z)]), np.array([(0, 1, 2), (0, 2, 3)])


def _icosphere(level: int) -> Triangles:
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=level)
    return np.array(sphere.vertices), np.array(sphere.faces)


def _tessellate(spec: Spec, level: int) -> Triangles:
    import trimesh

    match spec.kind, spec.args:
        case "Sphere", (center, radius):
            vertices, faces = _icosphere(level)
            return center + radius * vertices, faces
        case "Ellipsoid", (center, radii, rotation):
            vertices, faces = _icosphere(level)
            return center + (vertices * radii) @ rotation.T, faces
        case "Box", (size, center):
            box = trimesh.creation.box(extents=size)
            return center + box.vertices, np.array(box.faces)
        case "Cylinder", (start, end, radius):
            prism = trimesh.creation.cylinder(radius, sections=6 * 2**level, segment=[np.zeros(3), end - start])
            return start + prism.vertices, np.array(prism.faces)
    point, _ = spec.args  # the ground; no ray of the lidars passes its edge
    vertices, faces = _quad(4000.0, 0.0)
    return point + vertices, faces
