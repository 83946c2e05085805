"""Assets: instances of a class that are made of parts, and the meshes that parts are made of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.shown import quantity
from lidarsim._base.validation import Floats, Transform, affine, short_repr
from lidarsim._base.vectors import product, transforms
from lidarsim.errors import ArgumentTypeError
from lidarsim.materials import Material
from lidarsim.motion.trajectory import Trajectory
from lidarsim.world.scene import Label, Scene
from lidarsim.world.shapes import Shape, TriangleMesh

__all__ = [
    "Asset",
    "Part",
    "Piece",
    "Walker",
    "along",
    "box",
    "bridge",
    "check_generator",
    "draw",
    "extrude",
    "lathe",
    "loft",
    "merge",
    "move",
    "translation",
    "tube",
]

Faces = npt.NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class Part:
    """A part of an asset, in its axes.

    Attributes
    ----------
    name : str
        Its name, such as "wheel 1".
    shape : Shape
        Its shape.
    label : int or ndarray of uint32, shape (m,)
        Its class, by the numbers of SemanticKITTI, or that of each face or disk.
    material : Material
        How its surface returns light.
    transform : ndarray of float64, shape (4, 4), or None
        Affine map from the shape to the axes of the asset: wheels share one shape.
    """

    name: str
    shape: Shape
    label: Label
    material: Material
    transform: Floats | None = None

    @property
    def bounds(self) -> Floats:
        """Low and high corner of a box around the part, m: ndarray of float64, shape (2, 3)."""
        return self.shape.bounds if self.transform is None else self.shape._extent(self.transform[:3])


@dataclass(frozen=True)
class Walker:
    """Someone whose limbs are parts of an asset.

    Attributes
    ----------
    first : int
        Index of the first limb among the parts.
    height : float
        Height of the person, m.
    left : float
        y of the hips, m.
    """

    first: int
    height: float
    left: float = 0.0


@dataclass(frozen=True, eq=False)
class Asset:
    """An instance of a class, such as a car, in its own axes: x forward, y left, z up, the ground at z = 0.

    Attributes
    ----------
    parts : tuple of Part
        Its parts. A part whose name begins with "wheel" turns about the y axis through the middle of its bounds.
    walkers : tuple of Walker
        The people among the parts who may walk.
    """

    parts: tuple[Part, ...]
    walkers: tuple[Walker, ...] = ()

    @property
    def bounds(self) -> Floats:
        """Low and high corner of a box around all parts, m: ndarray of float64, shape (2, 3)."""
        boxes = np.array([part.bounds for part in self.parts])
        return np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])

    def add_to(
        self,
        scene: Scene,
        *,
        name: str = "",
        transform: Transform | None = None,
        motion: Trajectory | None = None,
        instance: int | None = None,
        label: int | None = None,
    ) -> list[int]:
        """Add the asset to a scene as one instance.

        Parameters
        ----------
        scene : Scene
            The scene. Assets that are added many times share their shapes there.
        name : str
            Name before those of the parts, as in "car/wheel 1".
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map from the axes of the asset to the world.
        motion : Trajectory, optional
            Rigid motion over time, applied after `transform`.
        instance : int, optional
            Number of the instance. Default: the id of the first part + 1.
        label : int, optional
            Class of all parts. Default: their own.

        Returns
        -------
        list of int
            The ids of the parts.

        Raises
        ------
        TypeError, ValueError
            As in `Scene.add`, or if `scene` is no Scene.
        """
        if not isinstance(scene, Scene):
            raise ArgumentTypeError("scene", "a Scene", short_repr(scene))
        ids: list[int] = []
        outer = None if transform is None else affine("transform", transform)
        for part in self.parts:
            inner = part.transform
            ids.append(
                scene.add(
                    part.shape,
                    name=f"{name}/{part.name}".strip("/"),
                    label=part.label if label is None else label,
                    instance=instance if instance is not None or not ids else ids[0] + 1,
                    material=part.material,
                    transform=outer if inner is None else inner if outer is None else product(outer, inner),
                    motion=motion,
                )
            )
        return ids

    def __repr__(self) -> str:
        """Return the size, and the number of parts."""
        size = " × ".join(f"{length:.2f}" for length in np.diff(self.bounds, axis=0)[0])
        return f"Asset({quantity(len(self.parts), 'part')}, {size} m)"


@dataclass(frozen=True, eq=False)
class Piece:
    """A closed surface, or one of several that close each other, of triangles of one class and one material."""

    vertices: Floats
    faces: Faces
    label: int = 0
    material: Material = field(default_factory=Material)

    def of(self, faces: npt.NDArray[Any], material: Material, label: int | None = None) -> Piece:
        """Return some of the faces as a piece of another material."""
        return replace(self, faces=self.faces[faces], material=material, label=self.label if label is None else label)


def merge(name: str, pieces: Iterable[Piece]) -> Iterator[Part]:
    """Yield a mesh for each kind of material, with the label and the reflectivity of each face.

    Materials are of a kind if they differ in nothing but reflectivity.
    """
    kinds: dict[tuple[Any, ...], list[Piece]] = {}
    for piece in pieces:
        if not len(piece.faces):
            continue
        material = piece.material
        kind = {key: value for key, value in material._contents().items() if key not in {"reflectivity", "per"}}
        kinds.setdefault(tuple(kind.items()), []).append(piece)
    for key, group in kinds.items():
        counts = [len(piece.faces) for piece in group]
        starts = np.cumsum([0, *(len(piece.vertices) for piece in group)])
        mesh = TriangleMesh(
            np.concatenate([piece.vertices for piece in group]),
            np.concatenate([piece.faces + np.uint32(start) for piece, start in zip(group, starts, strict=False)]),
        )
        labels = np.repeat(np.array([piece.label for piece in group], np.uint32), counts)
        bright = np.repeat([piece.material.reflectivity for piece in group], counts)
        same = bright.min() == bright.max()
        material = Material(**dict(key), reflectivity=bright[0] if same else bright, per="object" if same else "face")
        suffix = " glass" if material.transmission else ""
        yield Part(f"{name}{suffix}", mesh, labels if labels.min() < labels.max() else int(labels[0]), material)


def check_generator(rng: object) -> None:
    """Check that something is a generator of random numbers."""
    if not isinstance(rng, np.random.Generator):
        raise ArgumentTypeError(
            "rng", "a numpy.random.Generator", short_repr(rng), "np.random.default_rng(0) makes one"
        )


def draw(rng: np.random.Generator, span: Sequence[float]) -> float:
    """Return a number between two."""
    return float(rng.uniform(span[0], span[1]))


def move(vertices: Floats, to: npt.ArrayLike, yaw: float = 0.0) -> Floats:
    """Return vertices turned about the z axis, then moved."""
    c, s = np.cos(yaw), np.sin(yaw)
    turned: Floats = product(vertices, np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])) + np.asarray(to)
    return turned


def translation(x: float, y: float, z: float) -> Floats:
    """Return the affine map, (4, 4), that moves by a vector."""
    return transforms(np.eye(3), (x, y, z))


def bridge(rings: Floats) -> Faces:
    """Return the faces between rings of n vertices each, shape (k, n, 3), of which each is joined to the next.

    They face outward where the rings run counter-clockwise, seen from the last ring towards the first. The faces from
    vertex j to j + 1 of ring i are number 2 (i n + j) and the one after it.
    """
    return _bridges(*rings.shape[:2])[: 2 * (len(rings) - 1) * rings.shape[1]]


@lru_cache
def _bridges(k: int, n: int) -> Faces:
    """Return the faces between k rings of n vertices and, after them, of caps on both ends; see `loft`."""
    i, j = np.meshgrid(np.arange(k - 1), np.arange(n), indexing="ij")
    a, b = i * n + j, i * n + (j + 1) % n
    c, d = b + n, a + n
    sides = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    edge = np.arange(n)
    first = np.stack([(edge + 1) % n, edge, np.full(n, k * n)], axis=1)
    last = np.stack([edge, (edge + 1) % n, np.full(n, n + 1)], axis=1) + (k - 1) * n
    faces = np.concatenate([sides, first, last]).astype(np.uint32)
    faces.setflags(write=False)
    return faces


def loft(rings: Floats, label: int = 0, material: Material | None = None) -> Piece:
    """Return a closed surface through rings of n vertices, shape (k, n, 3), as in `bridge`, with caps on both ends.

    The faces of the caps follow those of `bridge`; they meet in the middle of the ring.
    """
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(axis=1)])
    return Piece(vertices, _bridges(*rings.shape[:2]), label, material or Material())


def box(size: npt.ArrayLike, middle: npt.ArrayLike, label: int = 0, material: Material | None = None) -> Piece:
    """Return a box."""
    half, centre = np.asarray(size, float) / 2, np.asarray(middle, float)
    return loft(CUBE * half + centre, label, material)


CUBE = np.array([[(-1.0, -1.0, z), (1.0, -1.0, z), (1.0, 1.0, z), (-1.0, 1.0, z)] for z in (-1.0, 1.0)])
"""Rings of a cube from -1 to 1."""


def extrude(outline: Floats, low: float, high: float, label: int = 0, material: Material | None = None) -> Piece:
    """Return a prism over an outline, shape (n, 2), counter-clockwise, convex or not."""
    import mapbox_earcut

    n = len(outline)
    lid = mapbox_earcut.triangulate_float64(outline, np.array([n], np.uint32)).reshape(-1, 3)
    a, b, c = (outline[lid[:, i]] for i in range(3))
    left = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) > (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    lid = np.where(left[:, None], lid, lid[:, ::-1])
    rings = np.array([np.column_stack([outline, np.full(n, z)]) for z in (low, high)])
    faces = np.concatenate([bridge(rings), lid[:, ::-1], lid + n]).astype(np.uint32)
    return Piece(rings.reshape(-1, 3), faces, label, material or Material())


def tube(
    points: npt.ArrayLike, radii: npt.ArrayLike, sides: int = 8, label: int = 0, material: Material | None = None
) -> Piece:
    """Return a closed tube along points, shape (k, 3), with a radius at each."""
    # For a few points, NumPy's gradient, norm and cross take several times as long.
    path = np.asarray(points, float)
    ahead = np.concatenate([path[1:2] - path[:1], (path[2:] - path[:-2]) / 2.0, path[-1:] - path[-2:-1]])
    ahead /= np.sqrt((ahead * ahead).sum(axis=1, keepdims=True))
    axis = int(np.argmin(np.abs(ahead[0])))
    u = -ahead[:, axis : axis + 1] * ahead
    u[:, axis] += 1.0
    u /= np.sqrt((u * u).sum(axis=1, keepdims=True))
    v = ahead[:, TURN] * u[:, BACK] - ahead[:, BACK] * u[:, TURN]
    cosine, sine = _circle(sides)
    radius = np.reshape(radii, (-1, 1, 1))
    rings = path[:, None] + radius * (cosine * u[:, None] + sine * v[:, None])
    return loft(rings, label, material)


TURN, BACK = [1, 2, 0], [2, 0, 1]
"""Cyclic successor of each axis, and the one after it."""


@lru_cache
def _circle(sides: int) -> tuple[Floats, Floats]:
    """Return cosine and sine, each of shape (sides, 1), of the corners of a regular polygon."""
    angle = (2 * np.pi * np.arange(sides) / sides)[:, None]
    return np.cos(angle), np.sin(angle)


def lathe(
    profile: Sequence[tuple[float, float]], sides: int = 12, label: int = 0, material: Material | None = None
) -> Piece:
    """Return a solid of revolution about the z axis, of a profile of radii > 0 and heights, upwards."""
    circle = np.column_stack(_circle(sides))
    rings = np.array([np.column_stack([radius * circle, np.full(sides, z)]) for radius, z in profile])
    return loft(rings, label, material)


def along(axis: str, vertices: Floats) -> Floats:
    """Return vertices with the z axis turned to another: to "x" or "y", by a cyclic change of the axes."""
    return vertices[:, {"x": BACK, "y": TURN}[axis]]
