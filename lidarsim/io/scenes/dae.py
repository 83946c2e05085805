"""COLLADA 1.4 and 1.5 (``.dae``, ``.zae``): the triangles and polygons of its scene, in its own unit and axes.

Skinned meshes are read at rest. Lines, cameras, lights and physics are passed over; morphed meshes are left out.
Base colours are the diffuse colours and textures of the common profile and the colours of vertices, all in sRGB.

pycollada reads coordinates as float32, and accepts document types, truncated sources and wrong counts of corners.

Format: https://www.khronos.org/files/collada_spec_1_4.pdf.
"""

from __future__ import annotations

import math
import posixpath
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

import numpy as np

from lidarsim._base.files import beside
from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io._records import Expansion
from lidarsim.io.scenes._model import (
    MOST_DEPTH,
    MOST_LETTERS,
    OBJECT,
    Axis,
    Indices,
    Key,
    Names,
    Node,
    Paint,
    Part,
    Picture,
    SceneFile,
    affine,
    mean_of_corners,
)
from lidarsim.io.scenes._xml import Element, floats, integer, integers, local, parse, unpack
from lidarsim.materials import Interpolation, Wrap, linear_light
from lidarsim.world.shapes._polygons import check_faces, of_strips, with_holes

AXES: dict[str, Axis] = {"X_UP": "x", "Y_UP": "y", "Z_UP": "z"}
WRAPS: dict[str, Wrap] = {"MIRROR": "mirror", **dict.fromkeys(("CLAMP", "BORDER", "NONE"), "clamp")}
"""Of textures; else they repeat. A border has a colour of its own, but no scene is known that uses it."""
ELEMENT = 100
"""Memory of an element of XML, bytes."""
FACES = {"triangles", "polylist", "polygons", "trifans", "tristrips"}
LINES = {"lines", "linestrips"}


def read(path: Path) -> SceneFile:
    """Read a file."""
    data = path.read_bytes()
    expansion = Expansion(len(data))
    if not data.startswith(b"PK"):
        return _Reader(parse(data, "the file"), lambda name: beside(path, name).read_bytes(), expansion).read()
    archive = zipfile.ZipFile(BytesIO(data))
    names = [name for name in archive.namelist() if name.lower().endswith(".dae")]
    if "manifest.xml" in archive.namelist():
        root = parse(unpack(archive, "manifest.xml"), "manifest.xml").findtext("{*}dae_root")
        names = names if root is None else [root.strip()]
    if len(names) != 1:
        raise FileFormatError(f"expected one COLLADA document in the archive, got {len(names)}")
    document = names[0]

    def within(name: str) -> bytes:
        return unpack(archive, posixpath.normpath(posixpath.join(posixpath.dirname(document), unquote(name))))

    content = unpack(archive, document)
    expansion.take(ELEMENT * content.count(b"<"))
    return _Reader(parse(content, "the document in the archive"), within, expansion).read()


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

    def join(self, other: _Faces) -> _Faces:
        """Return these faces and then others."""
        return _Faces(np.concatenate([self.indices, other.indices]), np.concatenate([self.sizes, other.sizes]))


class _Reader:
    """The reading of one document."""

    def __init__(self, root: Element, image: Callable[[str], bytes], expansion: Expansion) -> None:
        self._root = root
        self._image = image
        self._by_id = _ids(root)
        self._own: dict[Element, dict[str, Element]] = {}
        self._parts: dict[tuple[int, tuple[tuple[str, str], ...]], tuple[Part, ...]] = {}
        self._sources: dict[int, Floats] = {}
        self._diffuses: dict[Element | None, tuple[Floats, Picture | None]] = {}
        self._places: dict[Element, Floats] = {}
        self._expansion = expansion
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
        file = SceneFile(up=AXES[up], unit=float(meters), expansion=self._expansion)
        scene = self._root.find("{*}scene/{*}instance_visual_scene")
        visual = self._root.find("{*}library_visual_scenes/{*}visual_scene")
        if scene is not None:
            visual = self._refer(scene, "visual_scene")
        tops = [] if visual is None else visual.findall("{*}node")
        visits: list[tuple[Element, Node]] = []
        stack = [_Visit(top) for top in reversed(tops)]
        while stack:
            element, above, names, top, parent, depth = stack.pop()
            key = len(visits), 0
            if depth == MOST_DEPTH:
                raise FileFormatError(f"expected at most {MOST_DEPTH} nodes in line")
            self._expansion.take(OBJECT)
            called = element.get("name") or element.get("id") or str(len(visits))
            names = Names(called[:MOST_LETTERS], names)
            where = f"node {called!a:.60}"
            with np.errstate(over="ignore", invalid="ignore"):
                place = above @ _local(element, where)
            visits.append((element, Node(names, place, (), key, parent or key, top or key)))
            self._places.setdefault(element, place)
            below = []
            for child in element:
                if local(child) in {"node", "instance_node"}:
                    other = child if local(child) == "node" else self._refer(child, "node")
                    below.append(_Visit(other, place, names, top or key, key, depth + 1))
            stack += reversed(below)
        for element, node in visits:
            self._add(file, element, node)
        file.left_out += [f"{what} ({count:,})" for what, count in self._left_out.items()]
        return file

    def _add(self, file: SceneFile, element: Element, node: Node) -> None:
        """Add what a node places; skinned meshes are where their joints are."""
        parts: list[Part] = []
        for child in element:
            if local(child) == "instance_geometry":
                parts += self._geometry(child)
            elif local(child) == "instance_controller" and (skinned := self._skin(child)):
                file.add(replace(node, transform=np.eye(4), parts=skinned))
        if parts:
            file.add(replace(node, parts=tuple(parts)))

    def _skin(self, instance: Element) -> tuple[Part, ...]:
        """Return the parts of a skinned mesh at rest; none for a morphed one, which is left out."""
        skin = self._refer(instance, "controller").find("{*}skin")
        geometry = None if skin is None else self._by_id.get(skin.get("source", "").removeprefix("#"))
        if skin is None or geometry is None or local(geometry) != "geometry":
            self._left_out["morphed meshes"] += 1
            return ()
        return tuple(self._parts_of(geometry, dict(_materials_of(instance)), partial(self._at_rest, skin, instance)))

    def _at_rest(self, skin: Element, instance: Element, vertices: Floats) -> Floats:
        """Return the vertices of a skinned mesh in the scene: the mean of their places by their joints, by weight.

        A joint moves a vertex by its own transform, its inverse bind matrix and the bind shape matrix (COLLADA 1.4.1,
        section 4, Skinning a skeleton).
        """
        where = f"controller of {skin.get('source', '')!a:.60}"
        joints, weights = skin.find("{*}joints"), skin.find("{*}vertex_weights")
        if joints is None or weights is None:
            raise FileFormatError(f"{where}: expected joints and vertex_weights")
        sources = {found.get("semantic"): self._refer(found, "source", "source", skin) for found in joints}
        if not {"JOINT", "INV_BIND_MATRIX"} <= sources.keys():
            raise FileFormatError(f"{where}: expected JOINT and INV_BIND_MATRIX of its joints")
        names = "".join(sources["JOINT"].itertext()).split()
        inverse = self._source(sources["INV_BIND_MATRIX"], 16).reshape(-1, 4, 4)
        if len(inverse) != len(names):
            raise FileFormatError(f"{where}: expected {len(names)} INV_BIND_MATRIX, one a joint, got {len(inverse)}")
        shape = floats(skin.findtext("{*}bind_shape_matrix") or "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", where, 16)
        with np.errstate(over="ignore", invalid="ignore"):
            places = np.array([self._joint(name, instance) for name in names]).reshape(-1, 4, 4)
            moves = places @ inverse @ shape.reshape(4, 4)
        inputs = {found.get("semantic"): found for found in weights.iterfind("{*}input")}
        if not {"JOINT", "WEIGHT"} <= inputs.keys():
            raise FileFormatError(f"{where}: expected JOINT and WEIGHT of its vertex_weights")
        offsets = {key: integer(found.get("offset"), where) for key, found in inputs.items()}
        counts, rows = integers(weights.findtext("{*}vcount"), where), integers(weights.findtext("{*}v"), where)
        stride = max(offsets.values()) + 1
        if len(counts) != len(vertices) or len(rows) != stride * counts.sum():
            got = f"{len(counts)} and {len(rows)}"
            raise FileFormatError(f"{where}: expected {len(vertices)} counts and indices for each, got {got}")
        rows = rows.reshape(-1, stride)
        chosen = rows[:, offsets["JOINT"]]
        shares = self._source(self._refer(inputs["WEIGHT"], "source", "source", skin), 1)[:, 0]
        if len(rows) and (chosen.max() >= len(names) or rows[:, offsets["WEIGHT"]].max() >= len(shares)):
            raise FileFormatError(f"{where}: expected joints below {len(names)} and weights below {len(shares)}")
        share = shares[rows[:, offsets["WEIGHT"]]]
        owner = np.repeat(np.arange(len(vertices)), counts)
        total = np.bincount(owner, share, minlength=len(vertices))
        wrong = np.flatnonzero(~(total > 0.0))
        if len(wrong):
            raise FileFormatError(f"{where}: expected weights > 0, got a sum of {total[wrong[0]]} at vertex {wrong[0]}")
        moved = np.zeros((len(vertices), 3))
        homogeneous = np.column_stack((vertices, np.ones(len(vertices))))
        with np.errstate(over="ignore", invalid="ignore"):
            np.add.at(moved, owner, share[:, None] * np.einsum("nij,nj->ni", moves[chosen, :3], homogeneous[owner]))
        return moved / total[:, None]

    def _joint(self, name: str, instance: Element) -> Floats:
        """Return where a joint is: the node of this scoped id below a skeleton of an instance, or of this id."""
        roots = [
            self._by_id.get((root.text or "").strip().removeprefix("#")) for root in instance.iterfind("{*}skeleton")
        ]
        for root in [*(root for root in roots if root is not None), self._root]:
            for key in ("sid", "id"):
                for node in root.iter():
                    if node.get(key) == name and node in self._places:
                        return self._places[node]
        raise FileFormatError(f"joint {name!a:.60}: expected a node of the scene")

    def _refer(self, element: Element, kind: str, attribute: str = "url", within: Element | None = None) -> Element:
        """Return the element of a kind that an element refers to by ``#id``.

        Some programs give the data of each geometry the same ids: those below `within`, if given, come first.
        """
        url = element.get(attribute, "")
        if within is not None and within not in self._own:
            self._own[within] = _ids(within)
        for ids in ({} if within is None else self._own[within], self._by_id):
            found = ids.get(url.removeprefix("#")) if url.startswith("#") else None
            if found is not None and local(found) == kind:
                return found
        raise FileFormatError(f"{local(element)}: expected the id of a {kind} in this file, got {url!a:.60}")

    def _geometry(self, instance: Element) -> tuple[Part, ...]:
        """Return the parts of a geometry, with the materials that an instance gives its symbols."""
        geometry = self._refer(instance, "geometry")
        bound = _materials_of(instance)
        key = id(geometry), bound
        if key not in self._parts:
            self._parts[key] = tuple(self._parts_of(geometry, dict(bound), np.asarray))
        return self._parts[key]

    def _parts_of(self, geometry: Element, bound: dict[str, str], move: Callable[[Floats], Floats]) -> Iterator[Part]:
        """Yield the parts of a geometry, whose vertices are moved."""
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
            sources = [
                (source, integer(source.get("offset"), f"{where}, offset")) for source in element.iterfind("{*}input")
            ]
            stride = max((offset for _, offset in sources), default=0) + 1
            # Of several texture coordinates, the first.
            inputs = {source.get("semantic", ""): (source, offset) for source, offset in reversed(sources)}
            if "VERTEX" not in inputs:
                raise FileFormatError(f"{where}: expected an input VERTEX")
            source, offset = inputs["VERTEX"]
            vertices = move(self._positions(self._refer(source, "vertices", "source", mesh), mesh))
            faces = _faces(element, kind, stride, where)
            for polygon in element.iterfind("{*}ph"):
                faces = faces.join(_triangulate(polygon, stride, vertices, offset, where))
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
            paint = partial(self._paint, material, mesh, inputs, faces.indices, corners=corners, where=where)
            self._expansion.take(24 * len(used) + corners.nbytes + faces.sizes.nbytes + faces.indices.nbytes)
            yield Part(vertices[used], corners, faces.sizes, called, paint)

    def _positions(self, vertices: Element, mesh: Element) -> Floats:
        """Return the positions of the vertices of a mesh, shape (n, 3)."""
        for source in vertices.iterfind("{*}input"):
            if source.get("semantic") == "POSITION":
                return self._source(self._refer(source, "source", "source", mesh), 3)
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
            integer(accessor.get(key, default), f"{name}, accessor, {key}")
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
        mesh: Element,
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
            values = self._source(self._refer(source, "source", "source", mesh), width)
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
        profile = self._refer(effect, "effect").find("{*}profile_COMMON")
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
        sampler = params[name].find("{*}sampler2D") if name in params else None
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
        return white, Picture(lambda: self._image(file.replace("\\", "/")), *_sampling(sampler))


def _ids(top: Element) -> dict[str, Element]:
    """Return the elements from one on down by their ids; of several with the same, the first."""
    found: dict[str, Element] = {}
    for element in top.iter():
        if (name := element.get("id")) is not None:
            found.setdefault(name, element)
    return found


def _sampling(sampler: Element | None) -> tuple[tuple[Wrap, Wrap], Interpolation]:
    """Return what a texture is beyond its edges along u and v, and between its pixels."""

    def text_of(name: str) -> str:
        return "" if sampler is None else (sampler.findtext(f"{{*}}{name}") or "").strip()

    nearest = (text_of("magfilter") or text_of("minfilter")).startswith("NEAREST")
    wrap = WRAPS.get(text_of("wrap_s"), "repeat"), WRAPS.get(text_of("wrap_t"), "repeat")
    return wrap, "nearest" if nearest else "linear"


def _materials_of(instance: Element) -> tuple[tuple[str, str], ...]:
    """Return the materials that an instance gives its symbols."""
    return tuple(
        (material.get("symbol", ""), material.get("target", ""))
        for material in instance.iterfind("{*}bind_material/{*}technique_common/{*}instance_material")
    )


def _faces(element: Element, kind: str, stride: int, where: str) -> _Faces:
    """Return the faces of an element."""
    rows = [integers(p.text, where) for p in element.iterfind("{*}p")]
    for row in rows:
        if len(row) % stride:
            raise FileFormatError(f"{where}: expected {stride} indices a corner, got {len(row)} in all")
    corners = [row.reshape(-1, stride) for row in rows]
    joined = np.concatenate([np.empty((0, stride), np.int64), *corners])
    count = integer(element.get("count"), f"{where}, count") - len(element.findall("{*}ph"))
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


def _triangulate(polygon: Element, stride: int, vertices: Floats, offset: int, where: str) -> _Faces:
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
    counts = np.maximum(lengths - 2, 0)
    first = np.repeat(np.cumsum(lengths) - lengths, counts)
    step = first + np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    return np.stack([first, step, step + 1], axis=1).ravel(), np.full(len(first), 3)


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
            matrix = affine(values.reshape(4, 4), where)
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
        case "lookat":
            # Cameras look along −z with y up: from the eye to the point of interest.
            eye, interest, up = values.reshape(3, 3)
            z = eye - interest
            x = np.cross(up, z)
            y = np.cross(z, x)
            lengths = np.linalg.norm((x, y, z), axis=1)
            if not ((lengths > 0.0) & (lengths < math.inf)).all():
                raise FileFormatError(f"{where}: expected an eye apart from its interest, and up not along its view")
            matrix[:3, :3] = (np.array((x, y, z)) / lengths[:, None]).T
            matrix[:3, 3] = eye
        case _:  # skew
            # As in RenderMan, points move along b in proportion to how far they are along n, the unit vector across b
            # in the plane of a and b, so that a turns by the angle towards b: k = tan(angle + φ) − tan φ, where φ is
            # the angle from n to a.
            a, b = (axis / np.linalg.norm(axis) for axis in (values[1:4], values[4:]))
            across = a - (a @ b) * b
            length = float(np.linalg.norm(across))
            start = math.atan2(float(a @ b), length)
            end = math.radians(float(values[0])) + start
            if not (length > 0.0 and abs(end) < 0.5 * math.pi):
                expected = "two axes that differ in direction, and an angle less than that from the first to the second"
                raise FileFormatError(f"{where}: expected {expected}")
            matrix[:3, :3] += (math.tan(end) - math.tan(start)) * np.outer(b, across / length)
    return matrix
