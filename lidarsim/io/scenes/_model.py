"""What the readers of scene files return: nodes with meshes, in the file's own units and axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, short
from lidarsim.errors import FileFormatError
from lidarsim.io._records import Expansion
from lidarsim.io.scenes._animation import Bend, Figure
from lidarsim.materials import Interpolation, Wrap

Indices = npt.NDArray[np.int64]
Axis = Literal["x", "y", "z"]
Key = tuple[int, int]
"""Number of a node, and which of the copies that it places."""

MOST_DEPTH = 1000
"""Greatest depth of nodes, so that their paths stay short."""
MOST_LETTERS = 1000
"""Greatest length of a name, for the same reason."""
OBJECT = 1 << 10
"""Memory that a node takes, and each part that it places, bytes: a few bytes of a file can place a mesh many times."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A texture whose image is read only if it is asked for."""

    read: Callable[[], bytes]
    """Return the bytes of the image file."""
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    """What is beyond the image along u and v: "repeat", "mirror" or "clamp"."""
    interpolation: Interpolation = "linear"
    """What is between the centres of pixels."""


class Paint(NamedTuple):
    """The base colours of a part: the product of all that is given."""

    color: Floats
    """Linear red, green and blue, shape (3,)."""
    colors: Floats | None = None
    """Linear colours of the vertices, shape (n, 3)."""
    picture: Picture | None = None
    uv: Floats | None = None
    """Places in the image from its upper left corner, in widths and heights, of the corners of all faces, (k, 2)."""


def white() -> Paint:
    """Return the paint of a part that has no colours."""
    return Paint(np.ones(3))


@dataclass(frozen=True, eq=False)
class Part:
    """Faces of one material; nodes that place the same part share it."""

    vertices: Floats
    """Shape (n, 3)."""
    corners: Indices
    """Vertices of the faces, one face after the other, shape (k,)."""
    sizes: Indices
    """Corners of each face, shape (m,)."""
    material: str = ""
    """Name of the material."""
    paint: Callable[[], Paint] = white
    """Return the colours, for which further files may be read."""
    bend: Bend | None = None
    """How the vertices follow a skin and morph targets."""


class Names(NamedTuple):
    """The name of a node, and those of the nodes above it, which all nodes below them share."""

    name: str
    above: Names | None = None

    @property
    def path(self) -> str:
        """The names from the top node to this one, separated by slashes."""
        names: list[str] = []
        now: Names | None = self
        while now is not None:
            names.append(now.name)
            now = now.above
        return "/".join(reversed(names))


@dataclass(frozen=True, eq=False)
class Node:
    """A node that places parts."""

    names: Names
    transform: Floats
    """To the scene, shape (4, 4)."""
    parts: tuple[Part, ...]
    key: Key
    parent: Key
    top: Key
    copy: Floats = field(default_factory=lambda: np.eye(4))
    """Where it has the parts, in the coordinates of a node that animations may move."""


@dataclass
class SceneFile:
    """A scene file, in the order of the file."""

    nodes: list[Node] = field(default_factory=list)
    up: Axis = "z"
    unit: float = 1.0
    """Unit of length, m."""
    left_out: list[str] = field(default_factory=list)
    """What was left out, and why."""
    figure: Figure | None = None
    """The nodes that animations move."""
    expansion: Expansion | None = None
    """What has been made of the file; None if it cannot place a part twice."""

    def add(self, node: Node) -> None:
        """Append a node, after checking that it lies within the range of float64."""
        if not np.isfinite(node.transform).all():
            name = short(ascii(node.names.name))
            raise FileFormatError(f"node {name}: expected a place within the range of float64")
        if self.expansion is not None:
            self.expansion.take(OBJECT * len(node.parts))
        self.nodes.append(node)


def affine(matrix: Floats, where: str) -> Floats:
    """Return a matrix of a file, shape (4, 4), whose last row is (0, 0, 0, 1).

    Programs compute in float32 and write what comes out. So each number of the row is taken as a float32, and the last
    one may be off by one step of float32 above 1, 2⁻²³.
    """
    with np.errstate(over="ignore"):
        *zeros, one = matrix[3].astype(np.float32).tolist()
    if any(zeros) or not abs(one - 1.0) <= 2.0**-23:
        raise FileFormatError(f"{where}: expected (0, 0, 0, 1) as the last row, got {matrix[3].tolist()}")
    return np.vstack((matrix[:3], (0.0, 0.0, 0.0, 1.0)))


def mean_of_corners(corners: Indices, values: Floats) -> Floats:
    """Return for each vertex the mean of the values, (n, k), that its corners have, shape (vertices, k).

    `corners` are the vertices of the corners, (n,), each at least once.
    """
    counts = np.bincount(corners)
    total = np.zeros((len(counts), values.shape[1]))
    np.add.at(total, corners, values)
    mean: Floats = total / counts[:, None]
    return mean
