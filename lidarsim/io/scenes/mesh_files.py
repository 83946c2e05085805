"""Files of a single mesh (OBJ, OFF, PLY, STL) as scenes: a node for each object, group or solid.

The base colours of OBJ are those of its material library (``Kd``, ``map_Kd``) and of its vertices; those of PLY are
``red``, ``green`` and ``blue`` of its vertices. All are in sRGB.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidarsim._base.files import beside, reading_as, redact
from lidarsim._base.validation import Floats, short
from lidarsim.errors import FileFormatError
from lidarsim.io.meshes import obj
from lidarsim.io.meshes._lines import floats, lines_of
from lidarsim.io.scenes._build import report
from lidarsim.io.scenes._model import Indices, Names, Node, Paint, Part, Picture, SceneFile, white
from lidarsim.materials import Wrap, linear_light
from lidarsim.world.shapes._polygons import check_faces
from lidarsim.world.shapes.triangle_mesh import MeshFile, read_mesh

Chosen = Indices | slice
Painter = Callable[[int, Indices, Chosen], Paint]
"""Returns the paint of a part, of which it gets the number, the vertices and which corners of all are its own."""


def read(path: Path) -> SceneFile:
    """Read a file."""
    if path.suffix.lower() != ".obj":
        mesh = read_mesh(path)
        return _nodes(mesh, path.name, painter=_vertex_painter(path, mesh.colors) if mesh.colors else None)
    contents = obj.contents(path)
    return _nodes(contents.mesh, path.name, contents.materials, _ObjPaint(path, contents))


def _nodes(
    mesh: MeshFile, name: str, materials: Sequence[str] | None = None, painter: Painter | None = None
) -> SceneFile:
    """Return a node for each part of a mesh; with materials, parts of the same name are one node.

    A part has those vertices that it uses; a mesh of one part keeps all.
    """
    check_faces(mesh.vertices, mesh.corners, mesh.sizes)
    found: dict[object, tuple[str, list[Part]]] = {}
    divided: list[tuple[Indices, Indices]] = []
    if mesh.parts is not None and len(mesh.names) > 1:
        count, owners = len(mesh.names), np.repeat(mesh.parts, mesh.sizes)
        divided = list(zip(_by_part(mesh.parts, count), _by_part(owners, count), strict=True))
    for number in range(len(divided) or 1):
        if not divided:
            corners, sizes, used = mesh.corners, mesh.sizes, np.arange(len(mesh.vertices))
            chosen: Chosen = slice(None)
            called = next(filter(None, mesh.names), name)
        else:
            faces, chosen = divided[number]
            sizes = mesh.sizes[faces]
            used, corners = np.unique(mesh.corners[chosen], return_inverse=True)
            called = mesh.names[number] or name
        material = materials[number] if materials else ""
        paint = white if painter is None else partial(painter, number, used, chosen)
        part = Part(mesh.vertices[used], corners, sizes, material, paint)
        found.setdefault(number if materials is None else called, (called, []))[1].append(part)
    file = SceneFile()
    for number, (called, parts) in enumerate(found.values()):
        key = number, 0
        file.add(Node(Names(called), np.eye(4), tuple(parts), key, key, key))
    return file


def _by_part(parts: Indices, count: int) -> list[Indices]:
    """Return for each of `count` parts where it is in `parts`, ascending."""
    order = np.argsort(parts, kind="stable")
    return np.split(order, np.searchsorted(parts[order], np.arange(1, count)))


class _Material(NamedTuple):
    color: Floats
    picture: Picture | None


def _vertex_painter(path: Path, encoded: Callable[[], Floats]) -> Painter:
    """Return the painter of a mesh whose vertices have colours, which are computed once they are asked for."""
    linear = cache(lambda: _linear(path, encoded()))

    def paint(_number: int, used: Indices, _chosen: Chosen) -> Paint:
        colors = linear()
        return Paint(np.ones(3), None if colors is None else colors[used])

    return paint


def _linear(path: Path, encoded: Floats) -> Floats | None:
    """Return the linear colours of sRGB ones; if these are not all from 0 to 1, log it and return None."""
    wrong = encoded[~((encoded >= 0.0) & (encoded <= 1.0))]
    if len(wrong):
        report(path, [f"colours of vertices (expected numbers from 0 to 1, got {wrong[0]:g})"])
        return None
    return linear_light(encoded)


class _ObjPaint:
    """The colours of an OBJ file, for which its libraries and textures are read once they are asked for."""

    def __init__(self, path: Path, contents: obj.Contents) -> None:
        self._path = path
        self._contents = contents
        self._colors = cache(self._vertex_colors)
        self._library = cache(self._materials)
        self._uv = cache(self._texture_places)

    def __call__(self, number: int, used: Indices, chosen: Chosen) -> Paint:
        """Return the colours of a part, of which `used` are the vertices, and `chosen` the corners."""
        name = self._contents.materials[number] if self._contents.materials else ""
        material = self._library().get(name, _Material(np.ones(3), None))
        colors, uv = self._colors(), None if material.picture is None else self._uv()[chosen]
        return Paint(material.color, None if colors is None else colors[used], material.picture, uv)

    def _vertex_colors(self) -> Floats | None:
        """Return the linear colours of the vertices, if each has three numbers from 0 to 1 behind its coordinates."""
        lines = self._contents.vertices
        counts = {len(text.partition("#")[0].split()) for text in lines.texts}
        if counts == {6}:
            return _linear(self._path, floats(lines, 6, more=True)[:, 3:])
        if max(counts, default=0) > 4:  # three coordinates, or four in homogeneous ones
            report(self._path, ["colours of vertices (expected three numbers behind the coordinates of each)"])
        return None

    def _materials(self) -> dict[str, _Material]:
        """Return the materials of the libraries by name."""
        materials: dict[str, _Material] = {}
        for file in dict.fromkeys(self._libraries()):
            name = ""
            for number, text in lines_of(file.read_bytes()):
                word, *rest = text.split(maxsplit=1)
                value = rest[0] if rest else ""
                known = materials.get(name, _Material(np.ones(3), None))
                with reading_as(file, "a library of materials"):
                    if word == "newmtl":
                        name = " ".join(value.split())
                        materials[name] = _Material(np.ones(3), None)
                    elif word == "Kd":
                        materials[name] = known._replace(color=_kd(value, number))
                    elif word == "map_Kd":
                        image = map_kd(value)
                        wrap: Wrap = "clamp" if image.clamped else "repeat"
                        picture = Picture(partial(_image, file, image.name), (wrap, wrap))
                        materials[name] = known._replace(picture=picture)
        return materials

    def _libraries(self) -> Iterator[Path]:
        """Yield the libraries of materials: a ``mtllib`` names a file, be there spaces in its name, or several."""
        for text in self._contents.libraries:
            try:
                yield beside(self._path, file_name(text))
            except (FileFormatError, OSError):
                yield from (_find(self._path, "mtllib", word) for word in text.split())

    def _texture_places(self) -> Floats:
        """Return the texture coordinates of the corners of all faces, shape (k, 2); (0, 1) for those without."""
        contents = self._contents
        given = floats(contents.places, 2, more=True)
        words = [word.split("/") for text in contents.faces.texts for word in text.partition("#")[0].split()]
        indices = np.array([int(word[1]) if len(word) > 1 and word[1] else 0 for word in words], np.int64)
        before = np.repeat(contents.places_before, contents.mesh.sizes)
        places = np.where(indices < 0, indices + before, indices - 1)
        wrong = np.flatnonzero((places >= len(given)) | ((places < 0) & (indices != 0)))
        if len(wrong):
            face = int(np.searchsorted(np.cumsum(contents.mesh.sizes), wrong[0], side="right"))
            raise FileFormatError(f"line {contents.faces.numbers[face]}: expected texture coordinates to {len(given)}")
        uv = np.zeros((len(places), 2))
        uv[places >= 0] = given[places[places >= 0]]
        return np.column_stack((uv[:, 0], 1.0 - uv[:, 1]))  # v of OBJ counts from the lower edge


def _find(path: Path, statement: str, name: str) -> Path:
    """Return the file that a statement in a file names; the error quotes both."""
    try:
        return beside(path, name)
    except (FileFormatError, OSError) as error:
        raise FileFormatError(f"{statement} {short(ascii(name))}: {redact(error)}") from error


def _kd(value: str, number: int) -> Floats:
    """Return the linear colour of a ``Kd``, given as one or three numbers; white for those of a spectrum or XYZ."""
    words = value.partition("#")[0].split()
    if words and words[0] in {"spectral", "xyz"}:
        return np.ones(3)
    try:
        color = np.array([float(word) for word in words], np.float64)
    except ValueError:
        color = np.array([np.nan])
    if len(color) not in {1, 3} or not np.isfinite(color).all():
        raise FileFormatError(f"line {number}: expected Kd and one or three numbers")
    return linear_light(np.clip(np.broadcast_to(color, 3), 0.0, 1.0))


class Map(NamedTuple):
    """What a ``map_Kd`` names."""

    name: str
    clamped: bool
    """Whether the pixels at the edge go on beyond it; else the image repeats."""


NEUTRAL = {"-o": [0.0, 0.0, 0.0], "-s": [1.0, 1.0, 1.0], "-t": [0.0, 0.0, 0.0], "-mm": [0.0, 1.0]}
"""Options of ``map_Kd`` that have numbers, up to so many, and those with which they change nothing."""
OPTION = re.compile(r"(-[A-Za-z]+)\s+(?=\S)")
NUMBER = re.compile(r"([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)\s+(?=\S)", re.ASCII)


def map_kd(value: str) -> Map:
    """Return what a ``map_Kd`` names: an image after options of one word each, or of numbers that change nothing."""
    clamped, rest = False, value.strip()
    while found := OPTION.match(rest):
        option, rest = found[1], rest[found.end() :]
        neutral = NEUTRAL.get(option, [])
        numbers: list[float] = []
        while len(numbers) < len(neutral) and (found := NUMBER.match(rest)):
            numbers.append(float(found[1]))
            rest = rest[found.end() :]
        if numbers != neutral[: len(numbers)]:
            alone = " ".join(f"{number:g}" for number in neutral)
            raise FileFormatError(f"map_Kd: its option {option} is not supported, except as {option} {alone}")
        if not neutral:
            word, *after = rest.split(maxsplit=1)
            rest = after[0] if after else ""
            clamped = word == "on" if option == "-clamp" else clamped
    return Map(file_name(rest), clamped)


def file_name(text: str) -> str:
    """Return the name of a file, which some programs quote or write with backslashes."""
    name = text.strip()
    if len(name) > 1 and name[0] == name[-1] == '"':
        name = name[1:-1]
    return name.replace("\\", "/")


def _image(library: Path, name: str) -> bytes:
    """Return the bytes of the image of a ``map_Kd``."""
    return _find(library, "map_Kd", name).read_bytes()
