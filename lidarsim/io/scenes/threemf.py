"""3MF (``.3mf``): the objects that its build places, in its own unit.

Read are meshes, components and the base materials of triangles; also the models that the production extension puts
into further files. A file that requires another extension is refused.

Format: https://github.com/3MFConsortium/spec_core/blob/master/3MF%20Core%20Specification.md.
"""

from __future__ import annotations

import posixpath
import re
import zipfile
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from lidarsim._validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io.scenes._model import (
    MOST_DEPTH,
    MOST_LETTERS,
    MOST_OBJECTS,
    Key,
    Names,
    Node,
    Paint,
    Part,
    SceneFile,
)
from lidarsim.io.scenes._xml import Element, floats, integers, parse
from lidarsim.materials import linear_light
from lidarsim.shapes._polygons import check_faces

UNITS = {
    "micron": 1e-6,
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "inch": 0.0254,
    "foot": 0.3048,
    "meter": 1.0,
}
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
READ = {
    PRODUCTION,
    "http://schemas.microsoft.com/3dmanufacturing/material/2015/02",
}
"""Extensions that may be required."""

SMALL, RATIO = 1 << 26, 100
"""A model may have as many bytes, or as many times those that it takes in the file: a bomb has a thousand times."""


def read(path: Path) -> SceneFile:
    """Read a file."""
    with zipfile.ZipFile(BytesIO(path.read_bytes())) as archive:
        return _Reader(archive).read()


class _Base(NamedTuple):
    """A base material."""

    name: str
    color: Floats


class _Visit(NamedTuple):
    """An object to place, and what is known of those above it."""

    model: str
    number: str
    place: Floats
    called: str = ""
    names: Names | None = None
    top: Key | None = None
    parent: Key | None = None
    depth: int = 0


class _Reader:
    """The reading of one archive."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._roots: dict[str, Element] = {}
        self._objects: dict[tuple[str, str], Element] = {}
        self._parts: dict[tuple[str, str], tuple[Part, ...]] = {}

    def read(self) -> SceneFile:
        """Return the objects that the build places."""
        start = self._start()
        root = self._root(start)
        unit = root.get("unit", "millimeter")
        if unit not in UNITS:
            raise FileFormatError(f"unit: expected one of {', '.join(UNITS)}")
        file = SceneFile(unit=UNITS[unit])
        items = root.findall("{*}build/{*}item")
        stack = [self._visit(item, start, np.eye(4), item.get("partnumber", "")) for item in reversed(items)]
        visited = 0
        while stack:
            visit = stack.pop()
            key = visited, 0
            visited += 1
            if visit.depth == MOST_DEPTH or visited > MOST_OBJECTS:
                raise FileFormatError(f"expected at most {MOST_DEPTH} components in line and {MOST_OBJECTS:,} in all")
            element = self._object(visit.model, visit.number)
            called = element.get("name") or visit.called or visit.number
            names = Names(called[:MOST_LETTERS], visit.names)
            top = visit.top or key
            parts = self._made(visit.model, visit.number)
            if parts:
                file.add(Node(names, visit.place, parts, key, visit.parent or key, top))
            components = element.findall("{*}components/{*}component")
            stack += [
                self._visit(component, visit.model, visit.place)._replace(
                    names=names, top=top, parent=key, depth=visit.depth + 1
                )
                for component in reversed(components)
            ]
        return file

    def _visit(self, element: Element, model: str, above: Floats, called: str = "") -> _Visit:
        """Return the object that an item or a component refers to."""
        path = element.get(f"{{{PRODUCTION}}}path")
        with np.errstate(over="ignore", invalid="ignore"):
            place = above @ _transform(element.get("transform"))
        return _Visit(model if path is None else path.lstrip("/"), element.get("objectid", ""), place, called)

    def _start(self) -> str:
        """Return the name of the first model."""
        relations = parse(self._bytes("_rels/.rels"), "_rels/.rels")
        for relation in relations:
            if relation.get("Type", "").endswith("/3dmodel"):
                return posixpath.normpath(relation.get("Target", "")).lstrip("/")
        raise FileFormatError("_rels/.rels: expected a relation to a 3dmodel")

    def _bytes(self, name: str) -> bytes:
        """Return a file of the archive after checking its size."""
        try:
            info = self._archive.getinfo(name)
        except KeyError:
            raise FileFormatError(f"{name!a:.60}: missing in the archive") from None
        if info.file_size > max(SMALL, RATIO * info.compress_size):
            raise FileFormatError(f"{name!a:.60}: expected at most {RATIO} bytes for each that it takes in the archive")
        return self._archive.read(info)

    def _root(self, model: str) -> Element:
        """Return the root of a model after checking which extensions it requires."""
        if model not in self._roots:
            data = self._bytes(model)
            root = self._roots[model] = parse(data, f"{model!a:.60}")
            required = root.get("requiredextensions", "").split()
            spaces = _namespaces(data) if required else {}
            for prefix in required:
                if spaces.get(prefix) not in READ:
                    raise FileFormatError(
                        f"it requires the extension {spaces.get(prefix)!a:.100}, which is not supported"
                    )
            for element in root.iterfind("{*}resources/{*}object"):
                if self._objects.setdefault((model, element.get("id", "")), element) is not element:
                    raise FileFormatError(f"object {element.get('id', '')!a:.60}: expected each id once")
        return self._roots[model]

    def _object(self, model: str, number: str) -> Element:
        """Return an object of a model."""
        self._root(model)
        if (model, number) not in self._objects:
            raise FileFormatError(f"expected the id of an object, got {number!a:.60}")
        return self._objects[model, number]

    def _made(self, model: str, number: str) -> tuple[Part, ...]:
        """Return the parts of an object, which differ in material."""
        if (model, number) not in self._parts:
            element = self._object(model, number)
            mesh = element.find("{*}mesh")
            self._parts[model, number] = () if mesh is None else self._of_mesh(model, element, mesh)
        return self._parts[model, number]

    def _of_mesh(self, model: str, element: Element, mesh: Element) -> tuple[Part, ...]:
        where = f"object {element.get('id', '')!a:.60}"
        rows = mesh.findall("{*}vertices/{*}vertex")
        text = " ".join(row.get(axis, "nothing") for row in rows for axis in "xyz")
        vertices = floats(text, f"{where}, vertices", 3 * len(rows)).reshape(-1, 3)
        triangles = mesh.findall("{*}triangles/{*}triangle")
        text = " ".join(triangle.get(corner, "nothing") for triangle in triangles for corner in ("v1", "v2", "v3"))
        faces = integers(text, f"{where}, triangles").reshape(-1, 3)
        try:
            check_faces(vertices, faces.ravel(), np.full(len(faces), 3))
        except ValueError as error:
            raise FileFormatError(f"{where}: {error}") from error
        bases = self._bases(model)
        default = element.get("pid", ""), element.get("pindex", "0")
        chosen: dict[tuple[str, str], int] = {}
        which = np.array(
            [chosen.setdefault((t.get("pid", default[0]), t.get("p1", default[1])), len(chosen)) for t in triangles],
            np.int64,
        )
        parts = []
        for key, index in chosen.items():
            base = self._base(bases, key, where)
            used, corners = np.unique(faces[which == index], return_inverse=True)
            corners = corners.ravel()
            sizes = np.full(len(corners) // 3, 3)
            parts.append(Part(vertices[used], corners, sizes, base.name, partial(Paint, base.color)))
        return tuple(parts)

    def _bases(self, model: str) -> dict[str, list[_Base]]:
        """Return the groups of base materials of a model by id."""
        return {
            group.get("id", ""): [
                _Base(base.get("name", ""), _color(base.get("displaycolor", ""))) for base in group.findall("{*}base")
            ]
            for group in self._root(model).iterfind("{*}resources/{*}basematerials")
        }

    @staticmethod
    def _base(bases: dict[str, list[_Base]], key: tuple[str, str], where: str) -> _Base:
        """Return a base material; white for properties of another kind."""
        group, index = key
        if group not in bases:
            return _Base("", np.ones(3))
        number = int(integers(index, where)[:1].sum())
        if number >= len(bases[group]):
            raise FileFormatError(f"{where}: expected a material below {len(bases[group])}, got {number}")
        return bases[group][number]


def _namespaces(data: bytes) -> dict[str, str]:
    """Return the namespaces of a document by prefix."""
    found = ET.iterparse(BytesIO(data), events=("start-ns",))  # noqa: S314 - parsed before
    return {prefix: space for _, (prefix, space) in found}


def _transform(text: str | None) -> Floats:
    """Return the matrix of a transform, which 3MF writes by columns without the last row, shape (4, 4)."""
    matrix = np.eye(4)
    if text is not None:
        matrix[:3] = floats(text, "transform", 12).reshape(4, 3).T
    return matrix


def _color(text: str) -> Floats:
    """Return the linear colour of ``#RRGGBB`` or ``#RRGGBBAA`` in sRGB."""
    if not re.fullmatch(r"#[0-9A-Fa-f]{6}([0-9A-Fa-f]{2})?", text):
        raise FileFormatError("displaycolor: expected #RRGGBB or #RRGGBBAA")
    return linear_light(np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0)
