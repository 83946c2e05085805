"""The base of shapes that hold many primitives, such as spheres, and the arrays of their numbers."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, array, freeze, nonzero_vectors, one_or_each
from lidarsim.errors import ArgumentValueError
from lidarsim.world.shapes._shape import Shape


class Primitives(Shape):
    """Base of the shapes that hold many primitives, one in each row of an array."""

    __slots__ = ()

    _width: ClassVar[int]
    """Numbers of a row."""

    @property
    def centers(self) -> Floats:
        """The centres before any transform, m: read-only ndarray of float64, shape (n, 3), a copy."""
        return freeze(self._rows[:, :3])

    @property
    def radii(self) -> Floats:
        """The radii before any transform, m: read-only ndarray of float64, shape (n,), a copy."""
        return freeze(self._rows[:, 3])

    @property
    def _rows(self) -> Floats:
        return self._native.rows().reshape(-1, self._width)

    def __len__(self) -> int:
        return self._native.primitives()

    def __repr__(self) -> str:
        """Return the number of shapes."""
        kind = type(self).__name__
        return f"{kind}({len(self):,} {kind.lower()}{'' if self.transform is None else ', transform=…'})"


def rows(centers: npt.ArrayLike, radii: npt.ArrayLike, normals: npt.ArrayLike | None = None) -> Floats:
    """Return a row per shape as the core takes it: centre, radius and, where given, normal.

    Raises
    ------
    ValueError
        If a number is not finite, the numbers of shapes differ, a radius is not positive, or a normal is zero.
    """
    columns = array("centers", centers, ("n", 3))
    count = len(columns)
    result: Floats = np.empty((count, 4 if normals is None else 7))
    result[:, :3] = columns
    result[:, 3] = widths(radii, count)
    if normals is not None:
        result[:, 4:] = nonzero_vectors("normals", array("normals", normals, (count, 3)))
    return result


def widths(radii: npt.ArrayLike, count: int) -> Floats:
    """Return radii, one for all or one each, after checking that they are > 0: shape (count,)."""
    values = one_or_each("radii", radii, count)
    if not (values > 0.0).all():
        i = int(np.argmin(values > 0.0))
        name = f"radii[{i}]" if values.ndim else "radii"
        raise ArgumentValueError("radii", "numbers > 0", f"{name} = {values.flat[i]}")
    return np.broadcast_to(values, count)


def repeat(vertices: Floats, faces: npt.NDArray[np.uint32], count: int) -> npt.NDArray[np.uint32]:
    """Return the faces of `count` copies of a triangulation whose vertices follow one another."""
    starts = np.arange(count, dtype=np.uint32)[:, None, None] * np.uint32(len(vertices))
    return (faces[None] + starts).reshape(-1, 3)
