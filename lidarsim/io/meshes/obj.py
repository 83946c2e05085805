"""Wavefront OBJ files (``.obj``): vertices and faces; materials, textures, lines and free-form surfaces are skipped.

Material libraries are not read, since they do not affect the shape. A part of the mesh consists of the faces of one
object (``o``, or ``g`` in a file without objects) and one material (``usemtl``).

Format: Wavefront, Advanced Visualizer manual, appendix B1 (http://paulbourke.net/dataformats/obj).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidarsim.errors import FileFormatError
from lidarsim.io.meshes._lines import Indices, Lines, floats, join, lines_of
from lidarsim.world.shapes.triangle_mesh import MeshFile, register_mesh_reader


class Contents(NamedTuple):
    """What a file holds, with the lines of its faces."""

    mesh: MeshFile
    materials: list[str]
    """Name of the material of each part."""
    faces: Lines
    vertices: Lines
    """Coordinates, which a colour may follow."""
    places: Lines
    """Texture coordinates."""
    places_before: list[int]
    """Texture coordinates above each face."""
    libraries: list[str]
    """Files with materials."""


def read(path: Path) -> MeshFile:
    """Read a file."""
    return contents(path).mesh


def contents(path: Path) -> Contents:
    """Return what a file holds."""
    lines = lines_of(path.read_bytes())
    vertices, faces, places = Lines(), Lines(), Lines()
    libraries: list[str] = []
    before: list[int] = []  # vertices read before each face
    places_before: list[int] = []
    now = {"o": "", "g": "", "usemtl": ""}
    states: dict[tuple[str, ...], int] = {}
    state_of: list[int] = []
    state = -1
    for number, text in _join_continued(lines) if any(text.endswith("\\") for text in lines.texts) else lines:
        word, _, rest = text.replace("\t", " ", 1).partition(" ")
        if word == "v":
            vertices.append(number, rest)
        elif word in {"f", "fo"}:
            faces.append(number, rest)
            before.append(len(vertices))
            places_before.append(len(places))
            if state < 0:
                state = states.setdefault(tuple(now.values()), len(states))
            state_of.append(state)
        elif word == "vt":
            places.append(number, rest)
        elif word in now:
            now[word] = " ".join(rest.split())
            state = -1
        elif word == "mtllib":
            libraries.append(rest.strip())
    corners, sizes = _corners(faces, len(vertices), np.array(before, np.int64))
    objects = any(o for o, _, _ in states)
    keys = [(o if objects else g, material) for o, g, material in states]
    parts = {key: part for part, key in enumerate(dict.fromkeys(keys))}
    mesh = MeshFile(
        floats(vertices, 3, more=True),
        corners,
        sizes,
        names=[name or material for name, material in parts],
        parts=np.array([parts[key] for key in keys], np.int64)[state_of],
    )
    return Contents(mesh, [material for _, material in parts], faces, vertices, places, places_before, libraries)


def _corners(faces: Lines, vertices: int, before: Indices) -> tuple[Indices, Indices]:
    """Return the vertex indices of the faces, counted from 0, and their sizes; `before`: vertices above each face."""
    # In a/b/c, b and c are texture coordinates and normals; some programs append a comment.
    texts = [re.sub(r"(?<=\d)/\S*|#.*", "", text) if "/" in text or "#" in text else text for text in faces.texts]
    sizes = np.array([len(text.split()) for text in texts], np.int64)
    indices = join(Lines(faces.numbers, texts), sizes, 0)
    corners = np.where(indices < 0, indices + np.repeat(before, sizes), indices - 1)
    wrong = (corners < 0) | (corners >= vertices) | (indices == 0)
    if wrong.any():
        face = int(np.searchsorted(np.cumsum(sizes), np.argmax(wrong), side="right"))
        raise FileFormatError(
            f"line {faces.numbers[face]}: expected vertices from 1 to {vertices}, or from −{before[face]} on"
        )
    return corners, sizes


def _join_continued(lines: Lines) -> Lines:
    """Join continued lines: any line but a comment continues after a backslash at its end."""
    whole = Lines()
    begun = ""
    for number, text in lines:
        if text.endswith("\\") and not text.startswith("#"):
            begun += text[:-1] + " "
        else:
            whole.append(number, (begun + text).strip())
            begun = ""
    if begun:
        raise FileFormatError("it is truncated: its last line goes on")
    return whole


register_mesh_reader(lambda path: path.suffix.lower() == ".obj", read)
