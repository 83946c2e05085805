"""What all shapes have in common: placing, casting, and the hits that come of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from lidarsim import _native as core
from lidarsim._validation import Floats, Transform, affine, rays, t_range
from lidarsim.shapes._tessellation import Triangles


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Where rays first meet a shape or a scene, an entry a ray.

    Attributes
    ----------
    t : ndarray of float64, shape (n,)
        Ray parameter of the hit, in units of the length of the direction: the exact value, correctly rounded.
        Infinite for a miss.
    object_id : ndarray of int32, shape (n,)
        Object in the scene, -1 for a miss; 0 where a single shape was cast at.
    primitive_id : ndarray of int32, shape (n,)
        Triangle of a mesh; 0 for all else.
    normal : ndarray of float64, shape (n, 3)
        Unit normal at the hit, outward as the shape defines it, whichever side was hit; zero for a miss.
    """

    t: npt.NDArray[np.float64]
    object_id: npt.NDArray[np.int32]
    primitive_id: npt.NDArray[np.int32]
    normal: npt.NDArray[np.float64]

    @property
    def hit(self) -> npt.NDArray[np.bool_]:
        """Whether each ray hit anything: ndarray of bool, shape (n,)."""
        return self.object_id >= 0

    def __len__(self) -> int:
        return len(self.t)


class Shape:
    """A surface that rays can be cast at. Immutable; use one of the subclasses.

    Parameters
    ----------
    native : lidarsim._native.Shape
        The shape in the core.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map that the shape goes through; its entries are taken as exact.
    numbers : sequence of float
        What the shape is made of, as the core was given it, for those that tessellate it.
    """

    __slots__ = ("_matrix", "_native", "_numbers", "_scene")

    configuration: ClassVar[Mapping[str, Any]] = {}
    """Keys of configurations: arguments of the constructor with their units, and types of their values."""

    bounded: ClassVar[bool] = True
    """Whether the surface ends somewhere."""

    _matrix: Floats | None
    _native: core.Shape
    _numbers: Sequence[float]
    _scene: core.Scene

    def __init__(self, native: core.Shape, transform: Transform | None = None, numbers: Sequence[float] = ()) -> None:
        matrix = None if transform is None else affine("transform", transform)
        if matrix is not None:
            native = native.transformed(matrix.tolist())
        object.__setattr__(self, "_matrix", matrix)
        object.__setattr__(self, "_native", native)
        object.__setattr__(self, "_numbers", numbers)
        object.__setattr__(self, "_scene", core.Scene([native]))

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable: cannot set {name!r}")

    @classmethod
    def _of(cls, native: core.Shape, transform: Transform | None, numbers: Sequence[float] = ()) -> Self:
        """Make an instance of `cls` around a native shape, past its own constructor."""
        shape = cls.__new__(cls)
        Shape.__init__(shape, native, transform, numbers)
        return shape

    def _tessellated(self, chord_error: float | None, box: Floats) -> Triangles:
        """Return triangles that stand for the surface where it is looked at, before any transform.

        Parameters
        ----------
        chord_error : float, optional
            Greatest distance of a triangle from the surface; by default a fixed share of the shape's radius.
        box : ndarray, shape (8, 3)
            Corners of the part of space that is looked at, in the order of `numpy.ndindex(2, 2, 2)`. The surface ends
            there if it is not bounded.

        Returns
        -------
        Triangles
            Their vertices are on the surface.
        """
        raise NotImplementedError

    def roots(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Find every place where lines meet the surface.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            Lines ``origin + t * direction``. A direction may have any length but zero.

        Returns
        -------
        ndarray of float64, shape (n, k)
            Every t, of either sign, at which the line meets the surface, correctly rounded: ascending, distinct but for
            rounding, padded with NaN. A line that touches the surface in one point has one t there. k is the most that
            the shape can have, or that the lines given do have for a mesh.

        Raises
        ------
        ValueError
            If a shape is wrong, a number is not finite, or a direction is zero.
        """
        return self._native.roots(*rays(origins, directions))

    def cast(
        self, origins: npt.ArrayLike, directions: npt.ArrayLike, *, t_min: float = 0.0, t_max: float = math.inf
    ) -> Hits:
        """Find the first hit of each ray.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            Rays ``origin + t * direction``. A direction may have any length but zero.
        t_min, t_max : float
            Range of t, in units of the length of the direction; 0 <= t_min <= t_max. Both ends belong to it.

        Returns
        -------
        Hits
            One entry a ray.

        Raises
        ------
        ValueError
            If a shape is wrong, a number is not finite, a direction is zero, or the range is not one.
        """
        return Hits(*self._scene.cast(*rays(origins, directions), *t_range(t_min, t_max), None))
