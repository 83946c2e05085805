"""Base of the shapes: transforms, casting, and hits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from lidarsim import _native as core
from lidarsim._base.pickling import Pickled, Value
from lidarsim._base.shown import extent, quantity, short
from lidarsim._base.validation import Floats, Transform, placement, rays, real, t_range, vector
from lidarsim._base.vectors import product
from lidarsim.world.shapes._tessellation import Triangles


@dataclass(frozen=True, slots=True, eq=False)
class Hits(Pickled):
    """First hits of rays at a shape or a scene, one entry per ray; or all hits, one row per ray.

    Attributes
    ----------
    t : ndarray of float64, shape (n,)
        Ray parameter of the hit, in units of the length of the direction: the exact value, correctly rounded.
        Infinite for a miss.
    object_id : ndarray of int32, shape (n,)
        Object in the scene, -1 for a miss; 0 where a single shape was cast at.
    primitive_id : ndarray of int32, shape (n,)
        Triangle of a mesh, or which of many spheres or disks; 0 for other shapes.
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

    def __repr__(self) -> str:
        """Return the numbers of rays and hits, and the span of t."""
        return f"Hits({quantity(len(self), 'ray')}, {int(self.hit.sum()):,} hit, t {extent(self.t)})"


class Shape(Value):
    """A surface that rays can be cast at. Shapes are immutable; use one of the subclasses.

    The arguments of a constructor are attributes of the same names; arrays are read-only copies.

    Parameters
    ----------
    native : lidarsim._native.Shape
        The shape in the core.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the shape; its entries are taken as exact.
    """

    __slots__ = ("_native",)

    __match_args__: ClassVar[tuple[str, ...]] = ()
    """Arguments of the constructor, which define the shape up to its transform."""

    configuration: ClassVar[Mapping[str, object]] = {}
    """Keys of configurations: arguments of the constructor with their units, and the types of the values."""

    bounded: ClassVar[bool] = True
    """Whether the surface is bounded."""

    _positive: ClassVar[frozenset[str]] = frozenset()
    """Arguments of the constructor that are numbers > 0."""

    _native: core.Shape

    def __init__(self, native: core.Shape, transform: Transform | None = None) -> None:
        _set_native(self, native)
        if transform is not None:
            _set_native(self, self._image(transform))

    def _set(
        self, name: str, vectors: dict[str, npt.ArrayLike], numbers: dict[str, float], transform: Transform | None
    ) -> None:
        """Create the native shape of this name from the constructor's arguments: vectors and numbers."""
        native = core.Shape.plain(name, vectors, numbers)
        if native is None:
            checked = {argument: tuple(vector(argument, value)) for argument, value in vectors.items()}
            checked |= {
                argument: (real(argument, value, above=0.0 if argument in self._positive else -math.inf),)
                for argument, value in numbers.items()
            }
            native = core.Shape(name, checked)
        Shape.__init__(self, native, transform)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable: cannot set {name!r}")

    @property
    def transform(self) -> Floats | None:
        """Affine map applied to the shape: read-only ndarray of float64, shape (4, 4), or None."""
        return self._native.transform()

    @property
    def _arguments(self) -> dict[str, tuple[float, ...]]:
        """The numbers of each argument by which the core knows the shape, if it is not a mesh."""
        return self._native.arguments()

    def _image(self, transform: Transform) -> core.Shape:
        """Return the native shape under one more transform."""
        return self._native.transformed(placement(transform))

    def _reach(self, directions: Floats, /) -> Floats:
        """Return how far the surface reaches in some directions, before any transform.

        Parameters
        ----------
        directions : ndarray of float64, shape (k, 3)
            Directions of any length.

        Returns
        -------
        ndarray of float64, shape (k,)
            The greatest dot product of each direction with a point of the surface: its support function.
        """
        raise NotImplementedError

    def _extent(self, affine: Floats) -> Floats:
        """Return the bounds, (2, 3), of the surface under an affine map of shape (3, 4), after its own transform."""
        if self.transform is not None:
            affine = product(affine, self.transform)
        linear, shift = affine[:, :3], affine[:, 3]
        back, ahead = self._reach(np.concatenate([-linear, linear])).reshape(2, 3)
        return np.array([shift - back, shift + ahead])

    def _tessellate(self, chord_error: float | None, box: Floats, /) -> Triangles:
        """Return triangles that represent the surface in views, before any transform.

        Parameters
        ----------
        chord_error : float, optional
            Greatest distance of a triangle from the surface; by default a fixed share of the shape's radius.
        box : ndarray, shape (8, 3)
            Corners of the visible part of space, in the order of `numpy.ndindex(2, 2, 2)`. An unbounded surface is cut
            off there.

        Returns
        -------
        Triangles
            Vertices on the surface, and faces.
        """
        raise NotImplementedError

    def roots(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Find all intersections of lines with the surface.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            Lines ``origin + t * direction``. A direction may have any length but zero.

        Returns
        -------
        ndarray of float64, shape (n, k)
            Every t, of either sign, at which the line meets the surface, correctly rounded: ascending, distinct up to
            rounding, padded with NaN. A line that touches the surface at a point has one t there. k is the greatest
            number of roots that the shape can have; for a mesh or many spheres or disks, the greatest number that these
            lines have.

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
            One entry per ray.

        Raises
        ------
        ValueError
            If a shape is wrong, a number is not finite, a direction is zero, or the range is not one.
        """
        return Hits(*core.Scene.of_shape(self._native).cast(*rays(origins, directions), *t_range(t_min, t_max), None))

    @property
    def bounds(self) -> Floats:
        """Low and high corner of a bounding box, m: ndarray of float64, shape (2, 3).

        The box is tight for a shape without a transform of its own. It is infinite for an unbounded surface and NaN for
        a mesh without triangles.
        """
        return self._native.bounds()

    def _contents(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in (*self.__match_args__, "transform")}

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        return cls(**contents)

    def __repr__(self) -> str:
        """Return the arguments of the constructor."""
        shown = [f"{name}={short(getattr(self, name))}" for name in self.__match_args__]
        return f"{type(self).__name__}({', '.join(shown)}{'' if self.transform is None else ', transform=…'})"


_set_native = Shape.__dict__["_native"].__set__  # what `Shape.__setattr__` refuses
