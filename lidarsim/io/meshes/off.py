"""OFF text files (``.off``); normals, colours and texture coordinates are skipped.

Format: http://www.geomview.org/docs/html/OFF.html.
"""

from __future__ import annotations

import re
from pathlib import Path

from lidarsim.errors import FileFormatError
from lidarsim.io.meshes._lines import floats, integers, lines_of, polygons
from lidarsim.world.shapes.triangle_mesh import MeshFile, register_mesh_reader


def read(path: Path) -> MeshFile:
    """Read a file."""
    lines = lines_of(re.sub(rb"#[^\r\n]*", b"", path.read_bytes()))
    if lines and (head := re.match(r"(?:ST)?C?N?(4?n?)OFF", lines.texts[0])):
        rest = lines.texts[0][head.end() :]  # the counts may follow, even without a blank
        if head[1] or "BINARY" in rest:
            raise FileFormatError("expected an OFF of text in three dimensions, got another kind")
        if rest.strip():
            lines.texts[0] = rest
        else:
            lines = lines[1:]
    if not lines:
        raise FileFormatError("it has no counts of vertices and faces")
    vertices, faces = integers(lines[:1], 2, more=True)[0].tolist()
    if min(vertices, faces) < 0:
        raise FileFormatError(f"line {lines.numbers[0]}: expected the counts of vertices and faces")
    there = len(lines) - 1
    if vertices + faces > there:
        raise FileFormatError(f"it is truncated: {there:,} lines for {vertices:,} vertices and {faces:,} faces")
    if vertices + faces < there:
        extra = lines.numbers[1 + vertices + faces]
        raise FileFormatError(f"line {extra}: expected the end after {vertices:,} vertices and {faces:,} faces")
    points = floats(lines[1 : 1 + vertices], 3, more=True)
    return MeshFile(points, *polygons(lines[1 + vertices :], more=True))


register_mesh_reader(lambda path: path.suffix.lower() == ".off", read)
