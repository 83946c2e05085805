"""Triangles that represent curved surfaces in views. Rays are never cast at them."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.errors import ArgumentValueError

Triangles: TypeAlias = tuple[Floats, npt.NDArray[np.uint32]]
"""Vertices, shape (n, 3), and faces, shape (m, 3), counter-clockwise seen from outside."""

_DEFAULT = 1 / 200  # chord error, of the radius
COARSE = 0.08
"""Chord error, of the radius, of shapes that hold many: a circle has eight segments."""

_MOST = 2048  # segments of a circle: a sphere of them has four million triangles


def segments(radius: float, chord_error: float | None) -> int:
    """Return the number of segments of a circle whose chords keep within an error of it.

    A chord over the angle 2π/n is at most r (1 − cos(π/n)) away from its arc.

    Parameters
    ----------
    radius : float
        Radius of the circle.
    chord_error : float, optional
        Greatest distance of a chord from its arc; by default a 200th of the radius.

    Returns
    -------
    int
        An even number, at least 8.

    Raises
    ------
    ValueError
        If there would be more than 2048 segments.
    """
    share = _DEFAULT if chord_error is None else min(chord_error / radius, 1.0)
    count = math.ceil(math.pi / (2.0 * math.asin(math.sqrt(share / 2.0)))) if share > 0.0 else math.inf
    if count > _MOST:
        least = 2.0 * math.sin(math.pi / (2 * _MOST)) ** 2
        raise ArgumentValueError(
            "chord_error", f"at least {least:.2g} of the radius of each object", f"{share:.2g} of one"
        )
    return max(8, 2 * math.ceil(count / 2))


def frames(axes: Floats) -> Floats:
    """Return axes, shape (n, 3), and two directions across each as unit vectors, right-handed: (n, 3, 3).

    The rows of each are x, y and the axis.
    """
    z = axes / np.abs(axes).max(axis=1, keepdims=True)  # whose squares neither overflow nor underflow
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z), axis=1)])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=1)


def circle(radius: float, chord_error: float | None) -> Floats:
    """Return points of a circle around the z axis whose chords keep within an error of it, shape (n, 3)."""
    count = segments(radius, chord_error)
    angle = np.arange(count) * (2 * np.pi / count)
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=-1)


def unit_sphere(chord_error: float | None) -> Triangles:
    """Return a triangulation of the unit sphere that keeps within an error of it; its vertices are on the sphere.

    The plane through four neighbours on a grid of steps 2α in longitude and latitude is at least cos²α away from the
    centre, so its error is sin²α <= 2 (1 − cos α): that of a circle of the same steps with half the error.

    Parameters
    ----------
    chord_error : float, optional
        Greatest distance from the sphere; by default a 200th.

    Returns
    -------
    Triangles
        Vertices in rings from the south pole to the north pole, and faces.
    """
    count = _steps(chord_error)
    return _globe(count, np.arange(1, count // 2) * (2 * np.pi / count) - np.pi / 2)


def unit_capsule(chord_error: float | None) -> tuple[Floats, npt.NDArray[np.uint32], npt.NDArray[np.bool_]]:
    """Return a triangulation of the unit sphere, cut along the equator by a side without height.

    Parameters
    ----------
    chord_error : float, optional
        As of `unit_sphere`, which the side keeps, too.

    Returns
    -------
    vertices, faces : ndarray
        As of `unit_sphere`.
    is_north : ndarray of bool, shape (n,)
        Which vertices belong to the northern half; moved along z, they draw the side out.
    """
    count = 4 * math.ceil(_steps(chord_error) / 4)
    south = np.arange(1, count // 4 + 1) * (2 * np.pi / count) - np.pi / 2
    vertices, faces = _globe(count, np.concatenate([south, -south[::-1]]))
    is_north = np.arange(len(vertices)) >= len(south) * count
    is_north[-2] = False  # the south pole
    return vertices, faces, is_north


def _steps(chord_error: float | None) -> int:
    """Return how many steps of longitude a unit sphere takes."""
    return segments(1.0, (_DEFAULT if chord_error is None else chord_error) / 2)


def _globe(count: int, latitudes: npt.NDArray[np.floating[Any]]) -> Triangles:
    """Return rings of vertices of the unit sphere at ascending latitudes, both poles after them, and the faces."""
    longitude = np.arange(count) * (2 * np.pi / count)
    latitude = latitudes[:, None]
    x, y, z = np.broadcast_arrays(
        np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)
    )
    rings = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    south, north = len(rings), len(rings) + 1
    index = np.arange(len(rings)).reshape(-1, count)
    after = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], after[:-1], after[1:], index[1:]
    faces = np.concatenate(
        [
            np.stack([np.full(count, south), after[0], index[0]], axis=-1),
            np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3),
            np.stack([np.full(count, north), index[-1], after[-1]], axis=-1),
        ]
    )
    return np.concatenate([rings, [(0.0, 0.0, -1.0), (0.0, 0.0, 1.0)]]), faces.astype(np.uint32)
