"""COLLADA 1.4 and 1.5 (``.dae``): the triangles and polygons of its scene, in its own unit and axes.

Lines, cameras, lights and physics are passed over; skinned and morphed meshes (``instance_controller``) are left out.
Base colours are the diffuse colours and textures of the common profile and the colours of vertices, all in sRGB.

Format: https://www.khronos.org/files/collada_spec_1_4.pdf.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidarsim._files import beside
from lidarsim._validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io.scenes._model import (
    MOST_DEPTH,
    MOST_LETTERS,
    MOST_OBJECTS,
    Axis,
    Indices,
    Key,
    Names,
    Node,
    Paint,
    Part,
    Picture,
    SceneFile,
    mean_of_corners,
)
from lidarsim.io.scenes._xml import Element, floats, integers, local, parse
from lidarsim.materials import linear_light
from lidarsim.shapes._polygons import check_faces, of_strips, with_holes

AXES: dict[str, Axis] = {"X_UP": "x", "Y_UP": "y", "Z_UP": "z"}
FACES = {"triangles", "polylist", "polygons", "trifans", "tristrips"}
LINES = {"lines", "linestrips"}


def read(path: Path) -> SceneFile:
    """Read a file."""
    return _Reader(path, parse(path.read_bytes(), "the file")).read()


class _Visit(NamedTuple):
    """A node to visit, and what is known of the nodes above it."""

    element: Element
    above: Floats = np.eye(4)
    names: Names | None = None
    top: Key | None = None
    parent: Key | None = None
    depth: int = 0


class _Faces(NamedTuple):
    """Faces of one material of a geometry; each corner has several indices."""

    indices: Indices
    """Indices of each corner, shape (k, stride)."""
    sizes: Indices

    def joined(self, other: _Faces) -> _Faces:
        """Return these faces and then others."""
        return _Faces(np.concatenate([self.indices, other.indices]), np.concatenate([self.sizes, other.sizes]))


class _Reader:
    """The reading of one document."""

    def __init__(self, path: Path, root: Element) -> None:
        self._path = path
        self._root = root
        self._by_id: dict[str, Element] = {}
        for element in root.iter():
            if (name := element.get("id")) is not None:
                self._by_id.setdefault(name, element)
        self._parts: dict[tuple[int, tuple[tuple[str, str], ...]], tuple[Part, ...]] = {}
        self._sources: dict[int, Floats] = {}
        self._diffuses: dict[Element | None, tuple[Floats, Picture | None]] = {}
        self._left_out: Counter[str] = Counter()

    def read(self) -> SceneFile:
        """Return the nodes of the scene."""
        if local(self._root) != "COLLADA":
            raise FileFormatError("expected COLLADA as the first element")
        unit, up = self._root.find("{*}asset/{*}unit"), self._root.findtext("{*}asset/{*}up_axis", "Y_UP").strip()
        if up not in AXES:
            raise FileFormatError(f"asset/up_axis: expected {', '.join(AXES)}")
        text = "1" if unit is None else unit.get("meter", "1").replace(",", ".")  # as some programs write it
        meters = floats(text, "asset/unit, meter", 1)[0]
        if not 0.0 < meters < math.inf:
            raise FileFormatError(f"asset/unit, meter: expected a finite number > 0, got {meters}")
        file = SceneFile(up=AXES[up], unit=float(meters))
        scene = self._root.find("{*}scene/{*}instance_visual_scene")
        visual = self._root.find("{*}library_visual_scenes/{*}visual_scene")
        if scene is not None:
            visual = self._referred(scene, "visual_scene")
        tops = [] if visual is None else visual.findall("{*}node")
        visited = 0
        stack = [_Visit(top) for top in reversed(tops)]
        while stack:
            element, above, names, top, parent, depth = stack.pop()
            key = visited, 0
            visited += 1
            if depth == MOST_DEPTH or visited > MOST_OBJECTS:
                raise FileFormatError(f"expected at most {MOST_DEPTH} nodes in line and {MOST_OBJECTS:,} in all")
            called = element.get("name") or element.get("id") or str(visited - 1)
            names = Names(called[:MOST_LETTERS], names)
            where = f"node {called!a:.60}"
            with np.errstate(over="ignore", invalid="ignore"):
                place = above @ _local(element, where)
            parts: list[Part] = []
            below = []
            for child in element:
                match local(child):
                    case "instance_geometry":
                        parts += self._geometry(child)
                    case "instance_controller":
                        self._left_out["skinned and morphed meshes"] += 1
                    case "node":
                        below.append(_Visit(child, place, names, top or key, key, depth + 1))
                    case "instance_node":
                        other = self._referred(child, "node")
                        below.append(_Visit(other, place, names, top or key, key, depth + 1))
            stack += reversed(below)
            if parts:
                file.add(Node(names, place, tuple(parts), key, parent or key, top or key))
        file.left_out += [f"{what} ({count:,})" for what, count in self._left_out.items()]
        return file

    def _referred(self, element: Element, kind: str, attribute: str = "url") -> Element:
        """Return the element of a kind that an element refers to by ``#id``."""
        url = element.get(attribute, "")
        found = self._by_id.get(url.removeprefix("#")) if url.startswith("#") else None
        if found is None or local(found) != kind:
            raise FileFormatError(f"{local(element)}: expected the id of a {kind} in this file, got {url!a:.60}")
        return found

    def _geometry(self, instance: Element) -> tuple[Part, ...]:
        """Return the parts of a geometry, with the materials that an instance gives its symbols."""
        geometry = self._referred(instance, "geometry")
        bound = tuple(
            (material.get("symbol", ""), material.get("target", ""))
            for material in instance.iterfind("{*}bind_material/{*}technique_common/{*}instance_material")
        )
        key = id(geometry), bound
        if key not in self._parts:
            self._parts[key] = tuple(self._made(geometry, dict(bound)))
        return self._parts[key]

    def _made(self, geometry: Element, bound: dict[str, str]) -> Iterator[Part]:
        """Yield the parts of a geometry."""
        mesh = geometry.find("{*}mesh")
        name = f"geometry {geometry.get('id', '')!a:.60}"
        if mesh is None:
            self._left_out["geometries without a mesh"] += 1
            return
        for element in mesh:
            kind = local(element)
            if kind in LINES:
                self._left_out["lines"] += 1
            if kind not in FACES:
                continue
            where = f"{name}, {kind}"
            inputs = {
                source.get("semantic", ""): (source, int(integers(source.get("offset", "0"), f"{where}, offset")[0]))
                for source in reversed(element.findall("{*}input"))  # of several texture coordinates, the first
            }
            offsets = [integers(source.get("offset", "0"), where)[0] for source in element.iterfind("{*}input")]
            stride = int(max(offsets, default=0)) + 1
            if "VERTEX" not in inputs:
                raise FileFormatError(f"{where}: expected an input VERTEX")
            source, offset = inputs["VERTEX"]
            vertices = self._positions(self._referred(source, "vertices", "source"))
            faces = _faces(element, kind, stride, where)
            for polygon in element.iterfind("{*}ph"):
                faces = faces.joined(_holed(polygon, stride, vertices, offset, where))
            corners = faces.indices[:, offset]
            try:
                check_faces(vertices, corners, faces.sizes)
            except ValueError as error:
                raise FileFormatError(f"{where}: {error}") from error
            used, corners = np.unique(corners, return_inverse=True)
            target = bound.get(element.get("material", ""), "")
            material = self._by_id.get(target.removeprefix("#"))
            named = {} if material is None else material.attrib
            called = named.get("name") or named.get("id") or element.get("material") or ""
            paint = partial(self._paint, material, inputs, faces.indices, corners=corners, where=where)
            yield Part(vertices[used], corners, faces.sizes, called, paint)

    def _positions(self, vertices: Element) -> Floats:
        """Return the positions of vertices, shape (n, 3)."""
        for source in vertices.iterfind("{*}input"):
            if source.get("semantic") == "POSITION":
                return self._source(self._referred(source, "source", "source"), 3)
        raise FileFormatError(f"vertices {vertices.get('id', '')!a:.60}: expected an input POSITION")

    def _source(self, source: Element, width: int) -> Floats:
        """Return the first `width` named columns of a source, shape (n, width)."""
        name = f"source {source.get('id', '')!a:.60}"
        array, accessor = source.find("{*}float_array"), source.find("{*}technique_common/{*}accessor")
        if array is None or accessor is None:
            raise FileFormatError(f"{name}: expected a float_array and its accessor")
        if id(array) not in self._sources:
            self._sources[id(array)] = floats(array.text, name)
        values = self._sources[id(array)]
        count, offset, stride = (
            int(integers(accessor.get(key, default), f"{name}, accessor, {key}")[:1].sum())
            for key, default in (("count", "0"), ("offset", "0"), ("stride", "1"))
        )
        columns = [k for k, param in enumerate(accessor.findall("{*}param")) if param.get("name") or param.get("type")]
        chosen = columns[:width] if len(columns) >= width else list(range(width))
        if stride < max(chosen) + 1:
            raise FileFormatError(f"{name}: expected {width} numbers in each row, got a stride of {stride}")
        end = offset + count * stride
        if end > len(values):
            raise FileFormatError(f"{name}: truncated, {len(values):,} of {end:,} numbers")
        return values[offset:end].reshape(count, stride)[:, chosen]

    def _paint(
        self,
        material: Element | None,
        inputs: dict[str, tuple[Element, int]],
        rows: Indices,
        *,
        corners: Indices,
        where: str,
    ) -> Paint:
        """Return the base colours of a part: `rows` are the indices of its corners, `corners` their vertices."""

        def of_corners(semantic: str, width: int) -> Floats | None:
            if semantic not in inputs:
                return None
            source, offset = inputs[semantic]
            values = self._source(self._referred(source, "source", "source"), width)
            indices = rows[:, offset]
            if len(indices) and indices.max() >= len(values):
                raise FileFormatError(f"{where}: expected {semantic} below {len(values)}, got {indices.max()}")
            return values[indices]

        colors, uv = of_corners("COLOR", 3), of_corners("TEXCOORD", 2)
        if material not in self._diffuses:
            self._diffuses[material] = self._diffuse(material)
        color, picture = self._diffuses[material]
        if uv is not None:
            uv = np.column_stack((uv[:, 0], 1.0 - uv[:, 1]))  # v counts from the lower edge
        linear = None if colors is None else linear_light(np.clip(mean_of_corners(corners, colors), 0.0, 1.0))
        return Paint(color, linear, picture, uv)

    def _diffuse(self, material: Element | None) -> tuple[Floats, Picture | None]:
        """Return the diffuse colour of a material, and its texture."""
        white = np.ones(3)
        effect = None if material is None else material.find("{*}instance_effect")
        if effect is None:
            return white, None
        profile = self._referred(effect, "effect").find("{*}profile_COMMON")
        diffuse = None if profile is None else profile.find("{*}technique/*/{*}diffuse")
        if profile is None or diffuse is None:
            return white, None
        color, texture = diffuse.find("{*}color"), diffuse.find("{*}texture")
        if color is not None:
            values = floats(color.text, "diffuse/color")[:3]
            if len(values) < 3 or not np.isfinite(values).all():
                raise FileFormatError("diffuse/color: expected three finite numbers")
            return linear_light(np.clip(values, 0.0, 1.0)), None
        if texture is None:
            return white, None
        params = {param.get("sid", ""): param for param in profile.iter() if local(param) == "newparam"}
        name = texture.get("texture", "")
        for step in ("{*}sampler2D/{*}source", "{*}surface/{*}init_from"):  # 1.4; or the image's own id
            if name in params:
                name = (params[name].findtext(step) or "").strip()
        if name in params:
            instance = params[name].find("{*}sampler2D/{*}instance_image")  # 1.5
            name = "" if instance is None else instance.get("url", "").removeprefix("#")
        image = self._by_id.get(name)
        if image is None:
            raise FileFormatError(f"diffuse/texture: expected an image, got {name!a:.60}")
        file = (image.findtext("{*}init_from/{*}ref") or image.findtext("{*}init_from") or "").strip()
        return white, Picture(lambda: beside(self._path, file.replace("\\", "/")).read_bytes())


def _faces(element: Element, kind: str, stride: int, where: str) -> _Faces:
    """Return the faces of an element."""
    rows = [integers(p.text, where) for p in element.iterfind("{*}p")]
    for row in rows:
        if len(row) % stride:
            raise FileFormatError(f"{where}: expected {stride} indices a corner, got {len(row)} in all")
    corners = [row.reshape(-1, stride) for row in rows]
    joined = np.concatenate([np.empty((0, stride), np.int64), *corners])
    count = int(integers(element.get("count", "0"), f"{where}, count")[:1].sum()) - len(element.findall("{*}ph"))
    if kind in {"trifans", "tristrips"}:
        lengths = np.array([len(part) for part in corners], np.int64)
        if kind == "tristrips":
            order, sizes = of_strips(np.arange(len(joined)), lengths)
        else:
            order, sizes = _of_fans(lengths)
        return _Faces(joined[order], sizes)
    if kind == "triangles":
        sizes = np.full(len(joined) // 3, 3)
    elif kind == "polygons":
        sizes = np.array([len(part) for part in corners], np.int64)
    else:
        sizes = integers(element.findtext("{*}vcount"), f"{where}, vcount")
    if len(sizes) != count or int(sizes.sum()) != len(joined):
        got = f"{len(sizes)} and {len(joined)} corners"
        raise FileFormatError(f"{where}: expected {count} faces of {int(sizes.sum())} corners in all, got {got}")
    return _Faces(joined, sizes)


def _holed(polygon: Element, stride: int, vertices: Floats, offset: int, where: str) -> _Faces:
    """Return the triangles of a polygon with holes."""
    rings = [integers(ring.text, where) for ring in (*polygon.findall("{*}p"), *polygon.findall("{*}h"))]
    if any(len(ring) % stride or len(ring) < 3 * stride for ring in rings) or len(polygon.findall("{*}p")) != 1:
        raise FileFormatError(f"{where}: expected an outline and holes of at least three corners")
    rows = np.concatenate(rings).reshape(-1, stride)
    ends = np.cumsum([len(ring) // stride for ring in rings])
    try:
        check_faces(vertices, rows[:, offset], np.diff(ends, prepend=0))
    except ValueError as error:
        raise FileFormatError(f"{where}: {error}") from error
    triangles = with_holes(vertices[rows[:, offset]], ends)
    return _Faces(rows[triangles.ravel()], np.full(len(triangles), 3))


def _of_fans(lengths: Indices) -> tuple[Indices, Indices]:
    """Return the triangles of fans as faces, and their sizes."""
    starts = np.cumsum(lengths) - lengths
    triangles = [np.empty((0, 3), np.int64)]
    for start, length in zip(starts.tolist(), lengths.tolist(), strict=True):
        step = start + np.arange(1, max(length - 1, 1))
        triangles.append(np.stack([np.full(len(step), start), step, step + 1], axis=1))
    joined = np.concatenate(triangles)
    return joined.ravel(), np.full(len(joined), 3)


def _local(node: Element, where: str) -> Floats:
    """Return the transform of a node: the product of its own in their order, shape (4, 4)."""
    matrix = np.eye(4)
    for element in node:
        kind = local(element)
        if kind not in TRANSFORMS:
            continue
        values = floats(element.text, f"{where}, {kind}", TRANSFORMS[kind])
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = matrix @ _transform(kind, values, f"{where}, {kind}")
    return matrix


TRANSFORMS = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3, "lookat": 9, "skew": 7}
"""How many numbers each transform has."""


def _transform(kind: str, values: Floats, where: str) -> Floats:
    """Return the matrix of a transform."""
    matrix = np.eye(4)
    match kind:
        case "matrix":
            matrix = values.reshape(4, 4)
            if matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
                raise FileFormatError(f"{where}: expected (0, 0, 0, 1) as the last row, got {matrix[3].tolist()}")
        case "translate":
            matrix[:3, 3] = values
        case "scale":
            matrix[:3, :3] = np.diag(values)
        case "rotate":
            length = float(np.linalg.norm(values[:3]))
            if not 0.0 < length < math.inf:
                if values[3] == 0.0:
                    return matrix
                raise FileFormatError(f"{where}: expected an axis of finite length > 0, got {length}")
            x, y, z = values[:3] / length
            angle = math.radians(float(values[3]) % 360.0)
            quarter = {0.0: (1.0, 0.0), 90.0: (0.0, 1.0), 180.0: (-1.0, 0.0), 270.0: (0.0, -1.0)}
            cos, sin = quarter.get(float(values[3]) % 360.0, (math.cos(angle), math.sin(angle)))
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            axis = np.array([x, y, z])
            matrix[:3, :3] = cos * np.eye(3) + sin * cross + (1.0 - cos) * np.outer(axis, axis)
        case _:
            raise FileFormatError(f"{where}: this transform is not supported")
    return matrix
