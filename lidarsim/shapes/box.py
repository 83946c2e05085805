"""Box."""

from __future__ import annotations

from typing import ClassVar

import numpy.typing as npt

from lidarsim import _native
from lidarsim._validation import Floats, Transform, Vector, array, positive
from lidarsim.shapes._shape import Shape


class Box(Shape):
    """The surface of a box with edges along x, y, z and corners ``center ± size/2``.

    Parameters
    ----------
    size : array_like, shape (3,)
        Lengths of the edges, m, each > 0.
    center : array_like, shape (3,)
        m.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map that the box goes through; a rotation turns it.

    Raises
    ------
    ValueError
        If a number is not finite, a size is not positive, or the transform cannot be inverted.

    Notes
    -----
    The line's part inside is what three slabs leave of it: it begins at the latest entry and ends at the earliest
    exit, compared exactly. Where both are the same point, at an edge or a corner, the box is touched, and hit there.
    A line within a face meets the surface where it enters and leaves that face.

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Box((2, 2, 2), (4, 0, 0)).roots([[0, 0, 0]], [[1, 0, 0]])
    array([[3., 5.]])
    """

    __slots__ = __match_args__ = ("size", "center")

    configuration: ClassVar = {"size_m": Vector, "center_m": Vector}

    size: Floats
    center: Floats

    def __init__(
        self, size: npt.ArrayLike, center: npt.ArrayLike = (0.0, 0.0, 0.0), *, transform: Transform | None = None
    ) -> None:
        sides, middle = positive("size", array("size", size, (3,))), array("center", center, (3,))
        native = _native.Shape("Box", [*sides.tolist(), *middle.tolist()])
        super().__init__(native, transform, size=sides, center=middle)
