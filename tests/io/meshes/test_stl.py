"""STL files as software writes them, against VTK's reader or by hand."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest
import pyvista

import lidarsim as ls
from lidarsim.errors import FileFormatError

FACET = "facet normal 0 0 1\n outer loop\n  vertex 0 0 {z}\n  vertex 1 0 {z}\n  vertex 0 1 {z}\n endloop\nendfacet\n"
TEXT = f"solid thing\n{FACET.format(z=0)}{FACET.format(z=5)}endsolid thing\n"
VERTICES = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [1, 0, 5], [0, 1, 5]]


def binary(header: bytes = b"", count: int = 2, rest: bytes = b"") -> bytes:
    facets = b"".join(
        struct.pack("<12fH", 0, 0, 1, *(x for vertex in VERTICES[3 * k : 3 * k + 3] for x in vertex), 0) for k in (0, 1)
    )
    return header.ljust(80, b" ") + struct.pack("<I", count) + facets + rest


@pytest.mark.parametrize(
    "content",
    [
        TEXT,
        TEXT.upper(),
        TEXT.replace("\n", "\r\n"),
        TEXT.replace("\n", "\r"),
        TEXT.replace("solid thing", "solid"),
        TEXT.replace("solid thing", "solid a vertex of 3 facets, caf\u00e9"),
        TEXT.replace("vertex 1 0 5", "vertex\t+1.0E+00  0.e0 5."),
        f"\n  {TEXT}\n\n",
        f"\ufeff{TEXT}",
        f"\ufeff\n{TEXT}",
        binary(b"\xef\xbb\xbfsolid"),
        TEXT.replace("0 0 1", "nan nan nan"),
        binary(),
        binary(b"solid exported as binary"),
        binary(b"solid\nfacet normal"),
        binary(b"\xff\xfe"),
        binary(rest=b"\n"),
    ],
)
def test_two_triangles_in_all_forms(content: str | bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    mesh = ls.TriangleMesh.from_file(path)
    assert mesh.vertices.tolist() == VERTICES
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize("text", [True, False])
def test_as_vtk_writes_and_reads_it(text: bool, tmp_path: Path) -> None:
    path = tmp_path / "ball.stl"
    pyvista.Sphere().save(path, binary=not text)
    mesh, other = ls.TriangleMesh.from_file(path), pyvista.read(path)
    triangles = np.asarray(other.points, np.float64)[other.regular_faces]
    assert len(mesh) == len(triangles) > 1000
    # VTK rounds text to float32.
    np.testing.assert_array_equal(mesh.vertices[mesh.faces].astype(np.float32), triangles)


def test_solids_are_parts_of_a_scene(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_text(f"solid a\n{FACET.format(z=0)}endsolid a\nsolid\n{FACET.format(z=5)}endsolid\n", encoding="utf-8")
    first, second = ls.Scene.from_file(path)
    assert (first.name, second.name) == ("a", "a.stl")
    assert first.shape.vertices.tolist() + second.shape.vertices.tolist() == VERTICES  # type: ignore[attr-defined]
    assert len(ls.TriangleMesh.from_file(path)) == 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "it is truncated: 0 of 0 triangles"),
        (binary(count=3), "it is truncated: 2 of 3 triangles"),
        (binary()[:-1], "it is truncated: 1 of 2 triangles"),
        (binary(count=1), "it has 2 triangles, and its header claims 1"),
        (TEXT[:-15], "it is truncated: its last solid does not end"),
        (TEXT[: TEXT.rindex("vertex")], "it is truncated: its last solid does not end"),
        (TEXT.replace("  vertex 0 1 0\n", ""), "line 8: expected facets of three vertices, got something else"),
        (
            TEXT.replace("vertex 0 1 0", "vertex 0 1 0\nvertex 0 1 0"),
            "line 7: expected three vertices of a facet, got more",
        ),
        (TEXT.replace("vertex 0 1 0", "vertex 0 1"), "line 6: expected 3 numbers, got 2"),
        (TEXT.replace("vertex 0 1 0", "vertex 0 1 x"), "line 6: expected numbers, got something else"),
        (TEXT.replace("endsolid thing", "secret"), "line 16: expected facets of three vertices, got something else"),
        ("solid\nendsolid\n", "it holds no triangles"),
    ],
)
def test_bad_files(content: str | bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: cannot be read as a mesh: {message}')}$"):
        ls.TriangleMesh.from_file(path)


def test_vertices_are_finite(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(binary().replace(struct.pack("<f", 5.0), struct.pack("<f", np.nan), 1))
    with pytest.raises(
        FileFormatError, match=r"a\.stl: vertices: expected finite numbers, got vertices\[3\]\[2\] = nan$"
    ):
        ls.TriangleMesh.from_file(path)
