"""PLY files as software writes them, against plyfile, which writes them, VTK's reader, or by hand."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import plyfile
import pytest
import pyvista

import lidarsim as ls
from lidarsim.errors import FileFormatError

HEADER = (
    "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\nproperty float y\n"
    "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
BODY = "0 0 0\n2 0 0\n2 2 0\n0 2 0\n3 0 1 2\n4 0 1 2 3\n"
TEXT = HEADER + BODY
VERTICES = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]
FACES = [[0, 1, 2], [0, 1, 2], [0, 2, 3]]
FLAGGED = TEXT.replace("vertex_indices\n", "vertex_indices\nproperty float area\n")
FLAGGED = FLAGGED.replace("3 0 1 2\n4 0 1 2 3", "3 0 1 2 0.5\n4 0 1 2 3 0.5")
STRIPS = TEXT.replace("face 2", "tristrips 1").replace("3 0 1 2\n4 0 1 2 3", "8 0 1 3 2 -1 0 1 2")


def read(folder: Path, content: str | bytes) -> ls.TriangleMesh:
    path = folder / "a.ply"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return ls.TriangleMesh.from_file(path)


def binary(order: str = "<", header: str = HEADER, ending: str = "\n", count: str = "B", index: str = "i") -> bytes:
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    vertices = b"".join(struct.pack(f"{order}3f", *vertex) for vertex in VERTICES)
    faces = b"".join(struct.pack(f"{order}{count}{len(f)}{index}", len(f), *f) for f in ([0, 1, 2], [0, 1, 2, 3]))
    return header.replace("ascii", name).replace("\n", ending).encode() + vertices + faces


@pytest.mark.parametrize(
    "content",
    [
        TEXT,
        TEXT.replace("\n", "\r\n"),
        TEXT.replace("\n", "\r"),
        TEXT.replace("ply\n", "ply \n"),
        TEXT.replace(" ", "\t").replace("ply\n", "ply\t\n"),
        TEXT.replace("\n", " \n"),
        FLAGGED,
        HEADER + BODY.replace("\n", "\n\n"),
        TEXT.rstrip(),
        TEXT.replace("comment made by hand", "comment caf\u00e9"),
        TEXT.replace("comment made by hand", "comment caf\u00e9").encode("latin-1"),
        TEXT.replace("comment made by hand", "comment\nobj_info num_cols 2\ncomment TextureFile none.png"),
        TEXT.replace("uchar int vertex_indices", "uint8 int32 vertex_index"),
        TEXT.replace("property float", "property float32"),
        TEXT.replace("list uchar int", "list int uint"),
        TEXT.replace("element face", "element edge 0\nproperty int a\nelement face"),
        TEXT.replace("element vertex", "element camera 1\nproperty float f\nelement vertex").replace(
            BODY, f"7\n{BODY}"
        ),
        binary(),
        binary(">"),
        binary(ending="\r\n"),
        binary(ending="\r"),
        binary(header=HEADER.replace("comment made by hand", "comment caf\u00e9")),
        binary(header=HEADER.replace("list uchar int", "list int ushort"), count="i", index="H"),
        binary(">", header=HEADER.replace("list uchar int", "list ushort uint"), count="H", index="I"),
        binary() + b"\n",
    ],
)
def test_two_faces_in_all_forms(content: str | bytes, tmp_path: Path) -> None:
    mesh = read(tmp_path, content)
    assert mesh.vertices.tolist() == VERTICES
    assert mesh.faces.tolist() == FACES


def test_triangle_strips(tmp_path: Path) -> None:
    mesh = read(tmp_path, STRIPS)
    assert mesh.faces.tolist() == [[0, 1, 3], [1, 2, 3], [0, 1, 2]]  # all seen from the same side
    assert (mesh.cast([(1.5, 1.0, 1.0)], [(0, 0, -1)]).normal == (0, 0, 1)).all()


@pytest.mark.parametrize("form", ["text", "<", ">"])
@pytest.mark.parametrize("mixed", [True, False])
@pytest.mark.parametrize("types", [("f4", "u1", "i4"), ("f8", "i4", "u4"), ("f4", "i1", "u2"), ("f8", "u2", "i2")])
def test_as_plyfile_writes_it(form: str, mixed: bool, types: tuple[str, str, str], tmp_path: Path) -> None:
    number, count, index = types
    rng = np.random.default_rng(4)
    vertices = np.zeros(60, [(axis, number) for axis in "zyx"] + [("red", "u1"), ("quality", "f4")])
    for axis in "xyz":
        vertices[axis] = rng.normal(size=60)
    sizes = rng.integers(3, 5, 80) if mixed else np.full(80, 4)
    corners = [rng.choice(60, size, replace=False) for size in sizes]
    faces = np.zeros(80, [("flags", "u1"), ("vertex_indices", "O"), ("texcoord", "O"), ("quality", "f4")])
    edges = np.zeros(3, [("vertex1", "i4"), ("vertex2", "i4")])
    for face, these in zip(faces, corners, strict=True):
        face["vertex_indices"] = these.astype(index)
        face["texcoord"] = rng.random(2 * len(these)).astype("f4")
    elements = [
        plyfile.PlyElement.describe(edges, "edge"),
        plyfile.PlyElement.describe(vertices, "vertex"),
        plyfile.PlyElement.describe(
            faces, "face", val_types={"vertex_indices": index, "texcoord": "f4"}, len_types={"vertex_indices": count}
        ),
        plyfile.PlyElement.describe(edges, "more"),
    ]
    path = tmp_path / "a.ply"
    plyfile.PlyData(elements, text=form == "text", byte_order="<" if form == "text" else form).write(path)
    mesh = ls.TriangleMesh.from_file(path)
    expected = np.stack([plyfile.PlyData.read(path)["vertex"][axis] for axis in "xyz"], axis=1)
    np.testing.assert_array_equal(mesh.vertices, expected)
    at = 0
    for these in corners:  # each as triangles of its own corners, one after the other
        own = mesh.faces[at : at + len(these) - 2]
        assert set(own.ravel().tolist()) == set(these.tolist())
        at += len(these) - 2
    assert at == len(mesh)


@pytest.mark.parametrize("text", [True, False])
def test_as_vtk_writes_and_reads_it(text: bool, tmp_path: Path) -> None:
    path = tmp_path / "ball.ply"
    pyvista.Sphere().save(path, binary=not text)
    mesh, other = ls.TriangleMesh.from_file(path), pyvista.read(path)
    np.testing.assert_array_equal(mesh.vertices.astype(np.float32), other.points)
    np.testing.assert_array_equal(mesh.faces, other.regular_faces)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "it does not begin with the line 'ply'"),
        ("plywood\n", "it does not begin with the line 'ply'"),
        (HEADER[:-4], "its header has no end"),
        (TEXT.replace("format ascii 1.0\n", ""), "its header has no format"),
        (TEXT.replace("1.0", "2.0"), "line 2: expected a format, element, property or comment of PLY 1.0"),
        (
            TEXT.replace("element vertex 4", "element vertex -4"),
            "line 4: expected a format, element, property or comment",
        ),
        (TEXT.replace("float y", "quad y"), "line 6: expected a format, element, property or comment"),
        (TEXT.replace("float y", "float secret"), "its element vertex has 0 properties y"),
        (TEXT.replace("float y", "float x"), "its element vertex has 2 properties x"),
        (TEXT.replace("vertex_indices", "corners"), "its element face has 0 properties vertex_indices or vertex_index"),
        (TEXT.replace("list uchar int", "list uchar float"), "its element face has vertex indices that are no list of"),
        (TEXT.replace("list uchar int", "int"), "line 15: expected 1 number, got 4"),
        (TEXT.replace("face 2", "face 3"), "it is truncated: 2 of 3 of the element face"),
        (TEXT.replace("face 2", f"face {10**17}"), f"it is truncated: 2 of {10**17:,} of the element face"),
        (TEXT.replace("vertex 4", "vertex 7"), "it is truncated: 6 of 7 of the element vertex"),
        (TEXT.replace("face 2", "face 1"), "line 16: expected the end, after all that the header claims"),
        (TEXT.replace("2 2 0\n", "2 2\n"), "line 13: expected 3 numbers, got 2"),
        (TEXT.replace("2 2 0\n", "2 2 z\n"), "line 13: expected numbers, got something else"),
        (TEXT.replace("4 0 1 2 3", "5 0 1 2 3"), "line 16: expected 6 integers, got 5"),
        (TEXT.replace("4 0 1 2 3", "-4 0 1 2 3"), "line 16: expected -4 indices after their count"),
        (TEXT.replace("4 0 1 2 3", "3 0 1 2 3"), "line 16: expected 4 integers, got 5"),
        (TEXT.replace("4 0 1 2 3", "4 0 1 2 x"), "line 16: expected integers, got something else"),
        *(
            (FLAGGED.replace("4 0 1 2 3 0.5", wrong), f"line 17: {message}")
            for wrong, message in (
                ("5 0 1 2 3 0.5", "expected integers, got something else"),
                ("4 0 1 2 3", "expected as many numbers as its lists claim, got fewer"),
                ("-4 0 1 2 3 0.5", "expected as many numbers as its lists claim, got fewer"),
                ("nan 0 1 2 3 0.5", "expected as many numbers as its lists claim, got fewer"),
                ("3 0 1 2 3 0.5", "expected as many numbers as its lists claim, got more"),
                ("4 0 1 2 x 0.5", "expected numbers, got something else"),
            )
        ),
        (binary()[:-1], "it is truncated: 1 of 2 of the element face"),
        (binary()[:-30], "it is truncated: 0 of 2 of the element face"),
        (binary(header=HEADER.replace("face 2", f"face {10**17}")), f"it is truncated: 2 of {10**17:,} of the element"),
        (binary(header=HEADER.replace("face 2", "face 1")), "expected the end, after all that the header claims"),
        (
            binary(header=HEADER.replace("vertex 4", f"vertex {10**9}")),
            f"it is truncated: 6 of {10**9:,} of the element",
        ),
        (TEXT.replace("face 2", "face 0").replace("3 0 1 2\n4 0 1 2 3\n", ""), "it holds no triangles"),
    ],
)
def test_bad_files(content: str | bytes, message: str, tmp_path: Path) -> None:
    with pytest.raises(
        FileFormatError, match=f"^{re.escape(f'{tmp_path}/a.ply: cannot be read as a mesh: {message}')}"
    ):
        read(tmp_path, content)


@pytest.mark.parametrize("index", [4, -1, 2**31 - 1])
@pytest.mark.parametrize("text", [True, False])
def test_faces_name_vertices_that_are_there(index: int, text: bool, tmp_path: Path) -> None:
    message = f"a.ply: faces: expected indices from 0 to 3, got faces[1][3] = {index}"
    content: Any = TEXT.replace("1 2 3\n", f"1 2 {index}\n") if text else binary()[:-4] + struct.pack("<i", index)
    with pytest.raises(FileFormatError, match=f"{re.escape(message)}$"):
        read(tmp_path, content)


def test_vertices_are_finite(tmp_path: Path) -> None:
    place = binary().index(b"end_header\n") + len(b"end_header\n") + 4 * (3 * 3 + 1)
    content = binary()[:place] + struct.pack("<f", np.inf) + binary()[place + 4 :]
    with pytest.raises(
        FileFormatError, match=r"a\.ply: vertices: expected finite numbers, got vertices\[3\]\[1\] = inf$"
    ):
        read(tmp_path, content)
