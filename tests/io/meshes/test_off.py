"""OFF files as software writes them, by hand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError

VERTICES = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]
ROWS = "0 0 0\n2 0 0\n2 2 0\n0 2 0\n"
FACES = "3 0 1 2\n4 0 1 2 3\n"


def read(folder: Path, content: str) -> ls.TriangleMesh:
    path = folder / "a.off"
    path.write_bytes(content.encode())
    return ls.TriangleMesh.from_file(path)


@pytest.mark.parametrize(
    "content",
    [
        f"OFF\n4 2 0\n{ROWS}{FACES}",
        f"OFF 4 2 0\n{ROWS}{FACES}",
        f"OFF4 2 0\n{ROWS}{FACES}",  # as ModelNet has it
        f"4 2 0\n{ROWS}{FACES}",
        f"OFF\n4 2\n{ROWS}{FACES}",
        f"OFF # file\n# a square\n\n4 2 0 # counts\n{ROWS}\n# faces\n{FACES}# end",
        f"OFF\n4 2 0\n{ROWS}{FACES}".replace("\n", "\r\n"),
        f"OFF\n4 2 0\n{ROWS}{FACES}".replace("\n", "\r"),
        f"OFF\n4 2 0\n{ROWS}{FACES}".replace(" ", "\t "),
        f"NOFF\n4 2 0\n{ROWS}{FACES}".replace("0\n", "0 0 0 1\n").replace("4 2 0 0 0 1", "4 2 0"),
        f"COFF\n4 2 0\n{ROWS}{FACES}".replace("0\n", "0 255 0 0 255\n").replace("4 2 0 255 0 0 255", "4 2 0"),
        f"STOFF\n4 2 0\n{ROWS}{FACES}".replace("0\n", "0 .5 .5\n").replace("4 2 0 .5 .5", "4 2 0"),
        f"OFF\n4 2 0\n{ROWS}" + FACES.replace("\n", " 0.1 0.2 0.3\n"),
        f"OFF\n4 2 0\n{ROWS}" + FACES.replace("\n", " 7\n"),
    ],
)
def test_two_faces_in_all_forms(content: str, tmp_path: Path) -> None:
    mesh = read(tmp_path, content)
    assert mesh.vertices.tolist() == VERTICES
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "it has no counts of vertices and faces"),
        ("OFF\n", "it has no counts of vertices and faces"),
        ("OFF BINARY\n4 2 0\n", "expected an OFF of text in three dimensions, got another kind"),
        (f"4OFF\n4 2 0\n{ROWS}{FACES}", "expected an OFF of text in three dimensions, got another kind"),
        (f"nOFF\n3\n4 2 0\n{ROWS}{FACES}", "expected an OFF of text in three dimensions, got another kind"),
        ("OFF\n-4 2 0\n", "line 2: expected the counts of vertices and faces"),
        ("OFF\n4\n", "line 2: expected at least 2 integers, got 1"),
        ("OFF\nfour 2 0\n", "line 2: expected integers, got something else"),
        (f"OFF\n4 3 0\n{ROWS}{FACES}", "it is truncated: 6 lines for 4 vertices and 3 faces"),
        (f"OFF\n4 1 0\n{ROWS}{FACES}", "line 8: expected the end after 4 vertices and 1 faces"),
        (f"OFF\n4 2 0\n{ROWS}{FACES}".replace("2 2 0\n", "2 2\n"), "line 5: expected at least 3 numbers, got 2"),
        (f"OFF\n4 2 0\n{ROWS}{FACES}".replace("2 2 0\n", "2 2 a\n"), "line 5: expected numbers, got something else"),
        (f"OFF\n4 2 0\n{ROWS}3 0 1\n3 0 1 2\n", "line 7: expected at least 4 integers, got 3"),
        (f"OFF\n4 2 0\n{ROWS}3 0 1 2\n-1 0 1\n", "line 8: expected -1 indices after their count"),
        (f"OFF\n4 2 0\n{ROWS}3 0 1 2\n3 0 1 x\n", "line 8: expected integers, got something else"),
    ],
)
def test_bad_files(content: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(
        FileFormatError, match=f"^{re.escape(f'{tmp_path}/a.off: cannot be read as a mesh: {message}')}$"
    ):
        read(tmp_path, content)


@pytest.mark.parametrize("index", [4, -1, 10**12])
def test_faces_name_vertices_that_are_there(index: int, tmp_path: Path) -> None:
    message = f"a.off: faces: expected indices from 0 to 3, got faces[1][2] = {index}"
    with pytest.raises(FileFormatError, match=f"{re.escape(message)}$"):
        read(tmp_path, f"OFF\n4 2 0\n{ROWS}4 0 1 2 3\n4 0 1 {index} 3\n")
