"""Wavefront OBJ files (``.obj``): vertices and faces; materials, textures, lines and free forms are skipped.

No other file is read: a material library says nothing of the surface's shape. A part of the mesh is what one object
(``o``, or in a file without any, ``g``) has of one material (``usemtl``).

Format: Wavefront, Advanced Visualizer manual, appendix B1 (http://paulbourke.net/dataformats/obj).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import takewhile
from pathlib import Path

import numpy as np

from lidarsim.errors import FileFormatError
from lidarsim.io.meshes._lines import Line, floats, integers, lines_of
from lidarsim.shapes.triangle_mesh import MeshFile, register_mesh_reader


def read(path: Path) -> MeshFile:
    """Read a file."""
    coordinates: list[list[float]] = []
    corners: list[int] = []
    sizes: list[int] = []
    numbers: list[int] = []  # the line of each face
    now = {"o": "", "g": "", "usemtl": ""}
    states: dict[tuple[str, ...], int] = {}
    state_of: list[int] = []
    state = -1
    for number, words in _joined(lines_of(path.read_bytes())):
        match words[0]:
            case "v":
                if len(words) < 4:
                    raise FileFormatError(f"line {number}: expected three coordinates, got fewer")
                coordinates.append(floats(number, words[1:4]))
            case "f" | "fo":
                given = integers(number, [word.partition("/")[0] for word in _before_comment(words[1:])])
                count = len(coordinates)
                corners += [index - 1 if index > 0 else index + count if index < 0 else -1 for index in given]
                sizes.append(len(given))
                numbers.append(number)
                if state < 0:
                    state = states.setdefault(tuple(now.values()), len(states))
                state_of.append(state)
            case "o" | "g" | "usemtl":
                now[words[0]] = " ".join(words[1:])
                state = -1
    _check(corners, sizes, numbers, len(coordinates))
    objects = any(o for o, _, _ in states)
    keys = [(o if objects else g, material) for o, g, material in states]
    parts = {key: part for part, key in enumerate(dict.fromkeys(keys))}
    return MeshFile(
        np.array(coordinates).reshape(-1, 3),
        np.array(corners, np.int64),
        np.array(sizes, np.int64),
        names=[name or material for name, material in parts],
        parts=np.array([parts[key] for key in keys], np.int64)[state_of],
    )


def _before_comment(words: list[str]) -> list[str]:
    if "#" in "".join(words):
        return list(takewhile(lambda word: not word.startswith("#"), words))
    return words


def _joined(lines: Iterable[Line]) -> Iterator[Line]:
    """Yield the lines, each with those that it goes on in: all but comments do after a backslash at their end."""
    begun: list[str] = []
    for number, words in lines:
        if words[-1].endswith("\\") and not words[0].startswith("#"):
            begun += [*words[:-1], *filter(None, [words[-1][:-1]])]
        else:
            yield Line(number, [*begun, *words] if begun else words)
            begun = []
    if begun:
        raise FileFormatError("it is truncated: its last line goes on")


def _check(corners: list[int], sizes: list[int], lines: list[int], vertices: int) -> None:
    """Raise an error that names the line of the first face with a vertex that is not there."""
    wrong = [k for k, corner in enumerate(corners) if not 0 <= corner < vertices]
    if wrong:
        face = int(np.searchsorted(np.cumsum(sizes), wrong[0], side="right"))
        raise FileFormatError(f"line {lines[face]}: expected vertices from 1 to {vertices}, or from −{vertices} on")


register_mesh_reader(lambda path: path.suffix.lower() == ".obj", read)
