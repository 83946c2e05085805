"""Plane."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._validation import Floats, Transform, array, nonzero_vectors, real
from lidarsim.shapes._shape import Shape
from lidarsim.shapes._tessellation import Triangles


class Plane(Shape):
    """The plane of all points p with ``normal · p = distance``.

    The normal is kept as it is given: so `distance` is a distance from the origin of coordinates if the normal is of
    unit length, and |normal| times that if not.

    Parameters
    ----------
    normal : array_like, shape (3,)
        Normal of any length but zero; it points outward.
    distance : float
        m, times the length of the normal.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map that the plane goes through.

    Raises
    ------
    ValueError
        If a number is not finite, the normal is zero, or the transform cannot be inverted.

    Notes
    -----
    ``t = (distance − normal · origin) / (normal · direction)``; a ray with ``normal · direction = 0``, exactly, is a
    miss, also within the plane. Far from the origin of coordinates prefer :meth:`from_point`, which keeps the plane's
    point: t = n·(p − o)/(n·d).

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Plane((0, 0, 1), -2.0).cast([[0, 0, 0]], [[1, 0, -1]]).t
    array([2.])
    """

    __slots__ = ()

    bounded: ClassVar = False

    def __init__(self, normal: npt.ArrayLike, distance: float, *, transform: Transform | None = None) -> None:
        numbers = [*_normal(normal), real("distance", distance)]
        super().__init__(_native.Shape("Plane", numbers), transform, numbers)

    @classmethod
    def from_point(cls, point: npt.ArrayLike, normal: npt.ArrayLike, *, transform: Transform | None = None) -> Self:
        """Make the plane of all points p with ``normal · (p − point) = 0``.

        Parameters
        ----------
        point, normal : array_like, shape (3,)
            A point of the plane, m, and a normal of any length but zero.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map that the plane goes through.

        Returns
        -------
        Plane
            It keeps both as they are given.

        Raises
        ------
        ValueError
            If a number is not finite, the normal is zero, or the transform cannot be inverted.
        """
        numbers = [*array("point", point, (3,)), *_normal(normal)]
        return cls._of(_native.Shape("Plane", numbers), transform, numbers)

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
            Affine map that the plane goes through.

        Returns
        -------
        Plane
            It keeps the points; its normal is never rounded.

        Raises
        ------
        ValueError
            If a number is not finite, the points are on one line, or the transform cannot be inverted.
        """
        points = [x for name, value in (("a", a), ("b", b), ("c", c)) for x in array(name, value, (3,))]
        return cls._of(_native.Shape("Plane", points), transform, points)

    def _tessellated(self, chord_error: float | None, box: Floats) -> Triangles:  # noqa: ARG002
        normal, point = self._normal_and_point()
        # The box is widened by a tenth, and so far that it holds the point of the plane that is nearest to its middle.
        middle, edges = box.mean(axis=0), 1.1 * (box[[4, 2, 1]] - box[0])
        nearest = np.linalg.solve(edges.T, normal * (normal @ (point - middle)))
        edges *= np.maximum(1.0, 2.2 * np.abs(nearest))[:, None]
        corners = middle + (np.array(list(np.ndindex(2, 2, 2))) - 0.5) @ edges
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

    def _normal_and_point(self) -> tuple[Floats, Floats]:
        """Return the unit normal and a point, both rounded: for looking at the plane, not for casting at it."""
        numbers = np.asarray(self._numbers)
        if len(numbers) == 9:
            a, b, c = numbers.reshape(3, 3)
            point, normal = a, np.cross(b - a, c - a)
        elif len(numbers) == 6:
            point, normal = numbers[:3], numbers[3:]
        else:
            normal = numbers[:3]
            point = normal * (numbers[3] / (normal @ normal))
        return normal / np.linalg.norm(normal), point


def _normal(value: npt.ArrayLike) -> list[float]:
    normal: list[float] = nonzero_vectors("normal", array("normal", value, (3,))).tolist()
    return normal
