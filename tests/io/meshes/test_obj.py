"""OBJ files as software writes them, against VTK's reader or by hand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import pyvista

import lidarsim as ls
from lidarsim.errors import FileFormatError

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n"
VERTICES = [[0, 0, 0], [1, 0, 0], [1, 1, 0]]


def read(folder: Path, content: str | bytes) -> ls.TriangleMesh:
    path = folder / "a.obj"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return ls.TriangleMesh.from_file(path)


@pytest.mark.parametrize(
    "content",
    [
        TRIANGLE,
        TRIANGLE.replace("\n", "\r\n"),
        TRIANGLE.replace("\n", "\r"),
        TRIANGLE.replace(" ", "  "),
        TRIANGLE.replace(" ", "\t"),
        TRIANGLE.replace(" ", " \t "),
        "".join(f"  {line}\n" for line in TRIANGLE.splitlines()),
        "\n\n" + TRIANGLE.replace("\n", " \n\n"),
        TRIANGLE.rstrip(),
        TRIANGLE.replace("f 1 2 3", "f 1 2 \\\n3"),
        TRIANGLE.replace("f 1 2 3", "f 1 \\\r\n 2\\\r\n 3"),
        TRIANGLE.replace("f 1 2 3", "f 1 2 3 # the only one"),
        TRIANGLE.replace("f 1 2 3", "f 1 2 3 #1"),
        TRIANGLE.replace("f", "# C:\\\nf"),
        f"# caf\u00e9\nmtllib none.mtl\n{TRIANGLE}".encode("latin-1"),
        b"\xef\xbb\xbf" + TRIANGLE.encode(),
        TRIANGLE.replace("f 1 2 3", "vt 0 0\nvn 0 0 1\ns off\nf 1/1 2/1 3/1"),
        TRIANGLE.replace("f 1 2 3", "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1"),
        TRIANGLE.replace("f 1 2 3", "vn 0 0 1\nf 1//1 2//1 3//1"),
        TRIANGLE.replace("f 1 2 3", "f -3 -2 -1"),
        TRIANGLE.replace("f 1 2 3", "f -3/-1/-1 -2/-1/-1 -1/-1/-1"),
        TRIANGLE.replace("0\n", "0 1.0\n"),  # w
        TRIANGLE.replace("0\n", "0 0.5 0.25 1\n"),  # colours
        TRIANGLE.replace("1 ", "1e0 ").replace("f 1e0", "f 1"),
        "f 1 2 3\n" + TRIANGLE[:-8],
        TRIANGLE + "l 1 2\np 1\nf 1 2\n",
    ],
)
def test_one_triangle_in_all_forms(content: str | bytes, tmp_path: Path) -> None:
    mesh = read(tmp_path, content)
    assert mesh.vertices.tolist() == VERTICES
    assert mesh.faces.tolist() == [[0, 1, 2]]


def test_indices_count_from_the_end_of_what_was_read(tmp_path: Path) -> None:
    mesh = read(tmp_path, "".join(f"v 0 0 {z}\nv 1 0 {z}\nv 0 1 {z}\nf -3 -2 -1\n" for z in (0, 5)))
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert mesh.vertices[:, 2].tolist() == [0, 0, 0, 5, 5, 5]


def test_objects_and_groups_keep_the_order_of_the_file(tmp_path: Path) -> None:
    mesh = read(
        tmp_path,
        "mtllib a.mtl\nv 9 9 9\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\no a\ng x y\n"
        "usemtl red\nf 3 4 5\nusemtl blue\nf 2 3 4\no b\nusemtl red\nf 2 4 5\n",
    )
    assert mesh.vertices[0].tolist() == [9, 9, 9]  # one that no face has
    assert mesh.faces.tolist() == [[2, 3, 4], [1, 2, 3], [1, 3, 4]]
    names = [item.name for item in ls.Scene.from_file(tmp_path / "a.obj")]
    assert names == ["a", "a", "b"]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("f 1 2 3\n", ["a.obj"]),
        ("o thing\nf 1 2 3\n", ["thing"]),
        ("g left wing\nf 1 2 3\ng\nf 1 2 3\n", ["left wing", "a.obj"]),
        ("usemtl red\nf 1 2 3\nusemtl blue\nf 1 3 2\nusemtl red\nf 1 2 3\n", ["red", "blue"]),
        ("o empty\no thing\nf 1 2 3\n", ["thing"]),
    ],
)
def test_parts_of_a_scene(text: str, names: list[str], tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text(TRIANGLE[:-8] + text, encoding="utf-8")
    scene = ls.Scene.from_file(path)
    assert [item.name for item in scene] == names
    assert sum(len(item.shape) for item in scene) == text.count("f 1")  # type: ignore[arg-type]


def test_as_vtk_reads_it(tmp_path: Path) -> None:
    """VTK leaves the faces as they are, and splits a vertex only for its texture coordinates: there are none."""
    rng = np.random.default_rng(3)
    vertices = rng.normal(size=(200, 3))
    faces = [rng.choice(200, rng.integers(3, 5), replace=False) for _ in range(300)]
    lines = [*("v " + " ".join(map(repr, vertex)) for vertex in vertices.tolist())]
    lines += ["f " + " ".join(str(corner + 1 - 201 * int(rng.integers(2))) for corner in face) for face in faces]
    path = tmp_path / "a.obj"
    path.write_text("\n".join(lines), encoding="utf-8")
    mesh, other = ls.TriangleMesh.from_file(path), ls.TriangleMesh.from_pyvista(pyvista.read(path))
    np.testing.assert_array_equal(mesh.vertices.astype(np.float32), other.vertices.astype(np.float32))
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, other.faces)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "it holds no triangles"),
        ("v 0 0 0\n", "it holds no triangles"),
        (f"{TRIANGLE}f 1 2\n".replace("f 1 2 3\n", ""), "it holds no triangles"),
        (f"{TRIANGLE}f 1 2 4\n", "line 5: expected vertices from 1 to 3, or from −3 on"),
        (f"{TRIANGLE}f 1 2 0\n", "line 5: expected vertices from 1 to 3, or from −3 on"),
        (f"{TRIANGLE}f 1 2 -4\nv 0 0 0\n", "line 5: expected vertices from 1 to 4, or from −3 on"),
        (f"{TRIANGLE}f 1 2 x\n", "line 5: expected integers, got something else"),
        (f"{TRIANGLE}f 1 2 3.0\n", "line 5: expected integers, got something else"),
        (f"{TRIANGLE}f 1 2 {2**70}\n", "line 5: expected integers, got something else"),
        (f"{TRIANGLE}f 1 2 /3\n", "line 5: expected integers, got something else"),
        (f"{TRIANGLE}v 1 2\n", "line 5: expected at least 3 numbers, got 2"),
        (f"{TRIANGLE}v 1 2 z\n", "line 5: expected numbers, got something else"),
        (f"{TRIANGLE}v 1 2 3_0\n", "line 5: expected numbers, got something else"),
        (f"{TRIANGLE}f 1 2 \\", "it is truncated: its last line goes on"),
    ],
)
def test_bad_files(content: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(
        FileFormatError, match=f"^{re.escape(f'{tmp_path}/a.obj: cannot be read as a mesh: {message}')}$"
    ):
        read(tmp_path, content)


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e999"])
def test_vertices_are_finite(number: str, tmp_path: Path) -> None:
    message = f"vertices: expected finite numbers, got vertices[3][1] = {float(number)}"
    for load, start in ((ls.TriangleMesh.from_file, ""), (ls.Scene.from_file, "cannot be read as a scene: ")):
        (tmp_path / "a.obj").write_text(f"{TRIANGLE}v 0 {number} 0\n", encoding="utf-8")
        with pytest.raises(FileFormatError, match=f"{re.escape(f'a.obj: {start}{message}')}$"):
            load(tmp_path / "a.obj")
