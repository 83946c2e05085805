"""STL files (``.stl``), binary or text: each triangle has its own three vertices; normals are skipped.

Format: 3D Systems, StereoLithography Interface Specification (http://paulbourke.net/dataformats/stl).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io.meshes._lines import Lines, floats, lines_of
from lidarsim.world.shapes.triangle_mesh import MeshFile, register_mesh_reader

HEAD = 84
FACET = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])


def read(path: Path) -> MeshFile:
    """Read a file: as text if it begins like text and is not exactly as long as a binary file."""
    data = path.read_bytes()
    count = int.from_bytes(data[HEAD - 4 : HEAD], "little")
    text = re.match(rb"(?:\xef\xbb\xbf)?\s*solid\b[^\r\n]*[\r\n]+\s*(facet|endsolid)\b", data, re.IGNORECASE)
    if text and len(data) != HEAD + count * FACET.itemsize:
        return _text(data)
    there = (len(data) - HEAD) // FACET.itemsize
    if len(data) < HEAD or there < count:
        raise FileFormatError(f"it is truncated: {max(there, 0):,} of {count:,} triangles")
    if there > count:
        raise FileFormatError(f"it has {there:,} triangles, and its header claims {count:,}")
    facets = np.frombuffer(data, FACET, count, HEAD)
    return _mesh(facets["vertices"].reshape(-1, 3).astype(np.float64))


def _text(data: bytes) -> MeshFile:
    """Read text, one part per solid."""
    vertices = Lines()
    names: list[str] = []
    parts: list[int] = []
    inside = False  # within a solid
    corners = 3  # vertices of the current facet
    for number, line in lines_of(data):
        first, _, rest = line.replace("\t", " ", 1).partition(" ")
        word = first.lower()
        if word == "vertex":
            vertices.append(number, rest)
            corners += 1
        elif word == "facet" and inside and corners == 3:
            corners = 0
            parts.append(len(names) - 1)
        elif word == "solid" and not inside:
            inside = True
            names.append(" ".join(rest.split()))
        elif word == "endsolid" and inside and corners == 3:
            inside = False
        elif not (word in {"outer", "endloop", "endfacet"} and inside):
            raise FileFormatError(f"line {number}: expected facets of three vertices, got something else")
        if corners > 3:
            raise FileFormatError(f"line {number}: expected three vertices of a facet, got more")
    if inside:
        raise FileFormatError("it is truncated: its last solid does not end")
    return _mesh(floats(vertices, 3), names, np.array(parts, np.int64))


def _mesh(vertices: Floats, names: Sequence[str] = (), parts: npt.NDArray[np.int64] | None = None) -> MeshFile:
    return MeshFile(vertices, np.arange(len(vertices)), np.full(len(vertices) // 3, 3), names, parts)


register_mesh_reader(lambda path: path.suffix.lower() == ".stl", read)
