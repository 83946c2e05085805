"""Plane."""

from __future__ import annotations

from typing import Self

import numpy.typing as npt

from lidarsim import _native
from lidarsim._validation import Transform, array, nonzero_vectors, real
from lidarsim.shapes._shape import Shape


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

    def __init__(self, normal: npt.ArrayLike, distance: float, *, transform: Transform | None = None) -> None:
        native = _native.Shape("Plane", [*_normal(normal), real("distance", distance)])
        super().__init__(native, transform)

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
        native = _native.Shape("Plane", [*array("point", point, (3,)), *_normal(normal)])
        return cls._of(native, transform)

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
        return cls._of(_native.Shape("Plane", points), transform)


def _normal(value: npt.ArrayLike) -> list[float]:
    normal: list[float] = nonzero_vectors("normal", array("normal", value, (3,))).tolist()
    return normal
