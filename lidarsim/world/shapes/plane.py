"""Plane."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Floats, Transform
from lidarsim._base.vectors import CUBE
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles


class Plane(Shape):
    """The plane of all points p with ``normal · p = distance``.

    The normal is kept as given, so `distance` is the distance from the origin times the length of the normal.

    Parameters
    ----------
    normal : array_like, shape (3,)
        Outward normal, of any length but zero.
    distance : float
        m, times the length of the normal.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the plane.

    Raises
    ------
    ValueError
        If a number is not finite, the normal is zero, or the transform cannot be inverted.

    Notes
    -----
    ``t = (distance − normal · origin) / (normal · direction)``; a ray with exactly ``normal · direction = 0``
    misses, even within the plane. Far from the origin of coordinates prefer :meth:`from_point`, which keeps the point
    of the plane: t = n·(p − o)/(n·d).

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Plane((0, 0, 1), -2.0).cast([[0, 0, 0]], [[1, 0, -1]]).t
    array([2.])
    """

    __slots__ = ()
    __match_args__ = ("normal", "distance")

    bounded: ClassVar = False

    @explain_arguments
    def __init__(self, normal: npt.ArrayLike, distance: float, *, transform: Transform | None = None) -> None:
        self._set("Plane", {"normal": normal}, {"distance": distance}, transform)

    @classmethod
    def from_point(cls, point: npt.ArrayLike, normal: npt.ArrayLike, *, transform: Transform | None = None) -> Self:
        """Make the plane of all points p with ``normal · (p − point) = 0``.

        Parameters
        ----------
        point, normal : array_like, shape (3,)
            A point of the plane, m, and a normal of any length but zero.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the plane.

        Returns
        -------
        Plane
            The plane; it keeps both arguments as given.

        Raises
        ------
        ValueError
            If a number is not finite, the normal is zero, or the transform cannot be inverted.
        """
        plane = cls.__new__(cls)
        plane._set("Plane", {"point": point, "normal": normal}, {}, transform)
        return plane

    @classmethod
    def from_points(
        cls, a: npt.ArrayLike, b: npt.ArrayLike, c: npt.ArrayLike, *, transform: Transform | None = None
    ) -> Self:
        """Make the plane through three points, with the normal ``(b − a) × (c − a)``.

        Parameters
        ----------
        a, b, c : array_like, shape (3,)
            Points that are not on one line, m.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to the plane.

        Returns
        -------
        Plane
            The plane; it keeps the points, and its normal is never rounded.

        Raises
        ------
        ValueError
            If a number is not finite, the points are on one line, or the transform cannot be inverted.
        """
        plane = cls.__new__(cls)
        plane._set("Plane", {"a": a, "b": b, "c": c}, {}, transform)
        return plane

    @property
    def point(self) -> Floats:
        """A point of the plane before any transform, m: ndarray of float64, shape (3,).

        The first point that the plane was made from, or else the point nearest to the origin, rounded.
        """
        arguments = self._arguments
        if "distance" not in arguments:
            return np.array(arguments["point" if "point" in arguments else "a"])
        unit = math.hypot(*arguments["normal"])
        point: Floats = self.normal / unit * (self.distance / unit)
        return point

    @property
    def normal(self) -> Floats:
        """The normal before any transform, of any length: ndarray of float64, shape (3,).

        The normal as given; rounded if the plane was made from three points.
        """
        arguments = {name: np.array(numbers) for name, numbers in self._arguments.items()}
        if "normal" in arguments:
            return arguments["normal"]
        return np.cross(arguments["b"] - arguments["a"], arguments["c"] - arguments["a"])

    @property
    def distance(self) -> float:
        """``normal · point``: m, times the length of the normal. Rounded if the plane was made from points."""
        arguments = self._arguments
        return arguments["distance"][0] if "distance" in arguments else float(self.normal @ self.point)

    def _contents(self) -> dict[str, Any]:
        # One after the other, as pickles of this format have them; their number tells the form.
        numbers = tuple(number for numbers in self._arguments.values() for number in numbers)
        return {"numbers": numbers, "transform": self.transform}

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        plane = cls.__new__(cls)
        numbers = contents["numbers"]
        names = {4: ("normal", "distance"), 6: ("point", "normal"), 9: ("a", "b", "c")}[len(numbers)]
        arguments = {name: numbers[3 * i : 3 * i + 3] for i, name in enumerate(names)}
        Shape.__init__(plane, _native.Shape("Plane", arguments), contents["transform"])
        return plane

    def _reach(self, directions: Floats, /) -> Floats:
        return np.full(len(directions), np.inf)

    def _tessellate(self, _chord_error: float | None, box: Floats, /) -> Triangles:
        normal, point = self.normal / np.linalg.norm(self.normal), self.point
        # The box is widened by a tenth, and so far that it holds the point of the plane that is nearest to its middle.
        middle, edges = box.mean(axis=0), 1.1 * (box[[4, 2, 1]] - box[0])
        nearest = np.linalg.solve(edges.T, normal * (normal @ (point - middle)))
        edges *= np.maximum(1.0, 2.2 * np.abs(nearest))[:, None]
        corners = middle + CUBE @ edges
        heights = (corners - point) @ normal
        # An edge of the box joins corners that differ in one bit of their index.
        i, j = np.array([(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]).T
        cut = (heights[i] < 0) != (heights[j] < 0)
        share = (heights[i] / (heights[i] - heights[j] + ~cut))[cut, None]
        outline = corners[i][cut] + share * (corners[j] - corners[i])[cut]
        across = outline[0] - outline.mean(axis=0)
        around = (outline - outline.mean(axis=0)) @ np.stack([across, np.cross(normal, across)], axis=-1)
        outline = outline[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]
        fan = np.arange(1, len(outline) - 1)
        return outline, np.stack([np.zeros_like(fan), fan, fan + 1], axis=-1).astype(np.uint32)
