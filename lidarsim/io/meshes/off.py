"""OFF files (``.off``) of text, with normals, colours or texture coordinates, which are skipped, or without.

Format: http://www.geomview.org/docs/html/OFF.html.
"""

from __future__ import annotations

import re
from pathlib import Path

from lidarsim.errors import FileFormatError
from lidarsim.io.meshes._lines import Line, integers, lines_of, polygons, table
from lidarsim.shapes.triangle_mesh import MeshFile, register_mesh_reader


def read(path: Path) -> MeshFile:
    """Read a file."""
    data = re.sub(rb"#[^\r\n]*", b"", path.read_bytes())
    lines = list(lines_of(data))
    if lines and (head := re.fullmatch(r"(?:ST)?C?N?(4?n?)OFF(.*)", lines[0].words[0])):
        rest = [*filter(None, [head[2]]), *lines[0].words[1:]]  # some write the counts beside it, even without a blank
        if head[1] or "BINARY" in rest:
            raise FileFormatError("expected an OFF of text in three dimensions, got another kind")
        lines[:1] = [Line(lines[0].number, rest)] if rest else []
    if not lines:
        raise FileFormatError("it has no counts of vertices and faces")
    counts = integers(lines[0].number, lines[0].words)
    if len(counts) not in {2, 3} or min(counts) < 0:
        raise FileFormatError(f"line {lines[0].number}: expected the counts of vertices, faces and edges")
    vertices, faces = counts[:2]
    there = len(lines) - 1
    if vertices + faces > there:
        raise FileFormatError(f"it is truncated: {there:,} lines for {vertices:,} vertices and {faces:,} faces")
    if vertices + faces < there:
        extra = lines[1 + vertices + faces].number
        raise FileFormatError(f"line {extra}: expected the end after {vertices:,} vertices and {faces:,} faces")
    return MeshFile(table(lines[1 : 1 + vertices], range(3)), *polygons(lines[1 + vertices :]))


register_mesh_reader(lambda path: path.suffix.lower() == ".off", read)
