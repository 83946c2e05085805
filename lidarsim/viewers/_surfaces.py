"""Surfaces of a scene as triangles in the world, for all viewers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, array, real
from lidarsim._base.vectors import CUBE
from lidarsim.world.scene import Scene, SceneObject
from lidarsim.world.shapes._tessellation import Triangles

ALONE = 10.0
"""Half the edge of the cube around the origin to which planes are clipped if there is nothing else, m."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """An object of a scene as triangles; objects of one shape share `vertices` and `faces`.

    Attributes
    ----------
    object_id : int
        Number of the object in the scene.
    item : SceneObject
        The object.
    vertices : ndarray of float64, shape (n, 3)
        Vertices in the coordinates of the shape before any transform, m.
    faces : ndarray of uint32, shape (m, 3)
        Triangles, counter-clockwise from outside in these coordinates.
    matrix : ndarray of float64, shape (4, 4)
        Transform from these coordinates to the world.
    """

    object_id: int
    item: SceneObject
    vertices: Floats
    faces: npt.NDArray[np.uint32]
    matrix: Floats

    def at(self, time: float) -> Surface:
        """Return the surface at its pose at a time, s, clamped to the span of its motion."""
        return replace(self, matrix=_placement(self.item, time))

    def points(self) -> Floats:
        """Return the vertices in the world, m: ndarray of float64, shape (n, 3)."""
        return transform(self.matrix, self.vertices)

    def outward(self) -> npt.NDArray[np.uint32]:
        """Return the faces counter-clockwise from outside in the world: ndarray of uint32, shape (m, 3)."""
        return self.faces[:, ::-1] if np.linalg.det(self.matrix[:3, :3]) < 0 else self.faces

    def is_flat(self, slope: float) -> bool:
        """Return whether the height of the surface is at most `slope` times its greater width."""
        x, y, z = map(float, np.ptp(extent_of(self.points()), axis=0))
        return z <= slope * max(x, y)

    @property
    def labels(self) -> npt.NDArray[np.uint32]:
        """The label of each face: ndarray of uint32, shape (m,)."""
        labels = np.atleast_1d(np.asarray(self.item.label, np.uint32))
        return np.repeat(labels, len(self.faces) // max(len(labels), 1))

    def parts(self, categories: npt.NDArray[np.integer[Any]]) -> Iterator[tuple[int, Surface]]:
        """Yield each category and the surface of its faces; `categories` has one per face, shape (m,)."""
        order = np.argsort(categories, kind="stable")
        values, starts = np.unique(categories[order], return_index=True)
        for value, chosen in zip(values.tolist(), np.split(order, starts[1:]), strict=True):
            kept, faces = np.unique(self.faces[chosen], return_inverse=True)
            yield value, replace(self, vertices=self.vertices[kept], faces=faces.reshape(-1, 3).astype(np.uint32))

    def refine(self, step: float) -> Surface:
        """Return the surface in the world, with triangles no higher than `step`, m, or 1/64 of its height."""
        import trimesh

        points, faces = self.points(), self.outward()
        step = max(step, float(np.ptp(points[:, 2])) / 64 if len(points) else step)
        while (tall := np.flatnonzero(np.ptp(points[faces, 2], axis=1) > step)).size:
            points, faces = trimesh.remesh.subdivide(points, faces, face_index=tall)  # type: ignore[no-untyped-call]
        return replace(self, vertices=points, faces=faces.astype(np.uint32), matrix=np.eye(4))


def surfaces(
    scene: Scene,
    *,
    chord_error: float | None = None,
    bounds: npt.ArrayLike | None = None,
    time: float = 0.0,
) -> list[Surface]:
    """Return the surfaces of the objects of a scene.

    Parameters
    ----------
    scene : Scene
        The scene.
    chord_error : float, optional
        Greatest distance of a triangle from its surface, m; by default 1/200 of the radius of each object.
    bounds : array_like, shape (2, 3), optional
        Least and greatest coordinates of other visible objects, m, to which planes also extend.
    time : float
        Time, s, for the poses of moving objects; clamped to the span of each motion.

    Returns
    -------
    list of Surface
        One per object, in their order. A plane ends at the faces of a box around all other objects and `bounds`,
        widened by a tenth of its size, and far enough to hold the point of the plane nearest to its middle.

    Raises
    ------
    TypeError, ValueError
        If the chord error is no positive number, or so small that a circle would have more than 2048 segments, or the
        bounds are not finite numbers of that shape.
    """
    if chord_error is not None:
        chord_error = real("chord_error", chord_error, above=0.0)
    extent = [] if bounds is None else [array("bounds", bounds, (2, 3))]
    shared: dict[tuple[int, float | None], Triangles] = {}
    found: dict[int, Surface] = {}

    def add(item: SceneObject, box: Floats) -> Surface:
        matrix = _placement(item, time)
        # The spectral norm bounds how much the transform stretches distances.
        error = None if chord_error is None else chord_error / float(np.linalg.norm(matrix[:3, :3], ord=2))
        inverse: Floats = np.asarray(np.linalg.inv(matrix), np.float64)
        key = id(item.shape), error
        triangles = shared.get(key) or item.shape._tessellate(error, transform(inverse, box))
        if item.shape.bounded:
            shared[key] = triangles
        found[item.id] = surface = Surface(item.id, item, *triangles, matrix)
        return surface

    items = scene.objects  # another thread may change the scene
    unbounded = [item for item in items if not item.shape.bounded]
    for item in items:
        if item.shape.bounded:
            surface = add(item, np.zeros((8, 3)))
            if unbounded and len(surface.vertices):
                extent.append(extent_of(surface.points()))
    ends = np.concatenate(extent or [np.full((1, 3), -ALONE), np.full((1, 3), ALONE)])
    low, high = ends.min(axis=0), ends.max(axis=0)
    thin = 1e-3 * float((high - low).max()) or ALONE  # a flat box has no inside
    low, high = np.where(high - low < thin, low - thin, low), np.where(high - low < thin, high + thin, high)
    for item in unbounded:
        add(item, low + (high - low) * (CUBE + 0.5))
    return [found[item.id] for item in items]


def extent_of(points: Floats) -> Floats:
    """Return the least and greatest coordinates of points, shape (n, 3): ndarray of float64, shape (2, 3)."""
    # Axis by axis, which NumPy does many times as fast as all at once.
    return np.array([(along.min(), along.max()) for along in points.T]).T


def merge_surfaces(parts: Sequence[Surface], origin: Floats) -> Triangles:
    """Merge several surfaces into one, relative to an origin in the world."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.outward() + np.uint32(start) for part, start in zip(parts, starts, strict=False)]
    return np.concatenate([part.points() for part in parts]) - origin, np.concatenate(faces)


def _placement(item: SceneObject, time: float) -> Floats:
    """Return the transform from the coordinates of an object's shape, before its own transform, to the world."""
    matrix = np.eye(4)
    for own in (item.shape.transform, item.transform):
        if own is not None:
            matrix = own @ matrix
    if item.motion is not None:
        matrix = item.motion._native.at(np.clip([time], *item.motion.span))[0] @ matrix
    return matrix


def transform(matrix: Floats, points: Floats) -> Floats:
    """Return points, shape (n, 3), in the coordinates to which a matrix of shape (4, 4) leads."""
    transformed: Floats = points @ matrix[:3, :3].T + matrix[:3, 3]
    return transformed
