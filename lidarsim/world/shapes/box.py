"""Box."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Floats, Transform, Vector, freeze
from lidarsim._base.vectors import CUBE, matvec
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles

# Two triangles a face, over corners in the order of numpy.ndindex(2, 2, 2).
_FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5)),
        *((0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)),
        *((0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ],
    np.uint32,
)


class Box(Shape):
    """The surface of a box with edges along x, y, z and corners ``center ± size/2``.

    Parameters
    ----------
    size : array_like, shape (3,)
        Lengths of the edges, m, each > 0.
    center : array_like, shape (3,)
        Centre, m.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the box; a rotation turns it.

    Raises
    ------
    ValueError
        If a number is not finite, a size is not positive, or the transform cannot be inverted.

    Notes
    -----
    The line is inside the box between the latest entry into the three slabs and the earliest exit from them, compared
    exactly. If both are the same point, at an edge or a corner, the line touches the box and hits it there. A line
    within a face meets the surface where it enters and leaves that face.

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Box((2, 2, 2), (4, 0, 0)).roots([[0, 0, 0]], [[1, 0, 0]])
    array([[3., 5.]])
    """

    __slots__ = ()
    __match_args__ = ("size", "center")

    configuration: ClassVar = {"size_m": Vector, "center_m": Vector}

    @explain_arguments
    def __init__(
        self, size: npt.ArrayLike, center: npt.ArrayLike = (0.0, 0.0, 0.0), *, transform: Transform | None = None
    ) -> None:
        self._set("Box", {"size": size, "center": center}, {}, transform)

    @property
    def size(self) -> Floats:
        """Lengths of the edges before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["size"])

    @property
    def center(self) -> Floats:
        """The centre before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["center"])

    def _reach(self, directions: Floats, /) -> Floats:
        reach: Floats = matvec(directions, self.center) + matvec(np.abs(directions), self.size) / 2
        return reach

    def _tessellate(self, _chord_error: float | None, _box: Floats, /) -> Triangles:
        return self.center + self.size * CUBE, _FACES
