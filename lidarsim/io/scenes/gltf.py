"""glTF 2.0 (``.glb``, ``.gltf``): the triangles of its default scene, at rest and at the times of its animations.

Read are: triangles, strips and fans; sparse, normalised and quantised accessors (``KHR_mesh_quantization``);
``KHR_draco_mesh_compression`` (by DracoPy) and ``EXT_mesh_gpu_instancing``; animations, skins and morph targets; base
colours. Points, lines, cameras and lights are passed over, and so is what an extension animates. A file that requires
another extension is refused.

Format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.validation import Floats
from lidarsim._base.vectors import transforms
from lidarsim.errors import FileFormatError
from lidarsim.io.scenes import _gltf_document as gltf
from lidarsim.io.scenes._animation import Bend, Pose, Skin, rotations, total_of
from lidarsim.io.scenes._gltf_animation import animations_of, figure_of, local_of, weights_animated
from lidarsim.io.scenes._gltf_data import Data, at, check_finite, real
from lidarsim.io.scenes._model import MOST_DEPTH, OBJECT, Indices, Names, Node, Paint, Part, Picture, SceneFile
from lidarsim.materials import Wrap
from lidarsim.world.shapes._polygons import of_strips

GLB = struct.Struct("<4sII")
CHUNK = struct.Struct("<I4s")

DRACO = "KHR_draco_mesh_compression"
READ = re.compile(rf"{DRACO}|EXT_mesh_gpu_instancing|KHR_mesh_quantization|KHR_node_visibility")
HARMLESS = re.compile(
    r"(KHR|EXT)_(materials|texture|lights|xmp|animation)_\w+|KHR_xmp|KHR_audio_emitter|MSFT_(texture_dds|lod)"
)
"""Extensions that do not change the triangles."""
COMPRESSED = re.compile(r"(EXT|KHR)_meshopt_compression")
"""Extensions of which a buffer view may hold the data without compression as well."""

POINTS, LINES, TRIANGLES, STRIP = 0, (1, 2, 3), 4, 5
WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
NEAREST = {9728, 9984, 9986}
"""Filters that take the nearest pixel, of any mipmap."""


def read(path: Path) -> SceneFile:
    """Read a file."""
    document, binary = _open(path.read_bytes())
    reader = _Reader(path, document, binary)
    reader.read()
    return reader.file


def _open(data: bytes) -> tuple[gltf.Document, memoryview | None]:
    """Return the document and the binary chunk of a file, after checking versions and extensions."""
    binary = None
    if data.startswith(b"glTF"):
        text, binary = _chunks(data)
    else:
        text = data
    document = gltf.parse(text)
    for name, version in (("version", document.asset.version), ("minVersion", document.asset.min_version)):
        if version is not None and not re.fullmatch(r"2\.\d+" if name == "version" else r"2\.0", version, re.ASCII):
            _refuse_version(f"asset.{name}", version)
    for name in document.extensions_required:
        if not (READ.fullmatch(name) or HARMLESS.fullmatch(name) or COMPRESSED.fullmatch(name)):
            known = name if re.fullmatch(r"[A-Z]{2,8}_\w{1,60}", name, re.ASCII) else "an extension"
            raise FileFormatError(f"it requires {known}, which is not supported")
    return document, binary


def _refuse_version(where: str, version: str) -> None:
    known = version if re.fullmatch(r"\d{1,3}\.\d{1,3}", version, re.ASCII) else "another"
    hint = "; convert it with gltf-pipeline" if known.startswith("1.") else ""
    raise FileFormatError(f"{where}: expected glTF 2.0, got {known}{hint}")


def _chunks(data: bytes) -> tuple[bytes, memoryview | None]:
    """Return the JSON and the binary chunk of a GLB."""
    if len(data) < GLB.size + CHUNK.size:
        raise FileFormatError(f"truncated: {len(data)} bytes")
    _, version, size = GLB.unpack_from(data)
    if version != 2:
        _refuse_version("the version of the GLB", f"{version}.0")
    if size > len(data):
        raise FileFormatError(f"truncated: {len(data):,} of {size:,} bytes")
    chunks: list[tuple[bytes, memoryview]] = []
    place = GLB.size
    while place + CHUNK.size <= size:
        length, kind = CHUNK.unpack_from(data, place)
        place += CHUNK.size
        if length > size - place:
            raise FileFormatError(f"chunk {len(chunks)}: truncated, {size - place:,} of {length:,} bytes")
        chunks.append((kind, memoryview(data)[place : place + length]))
        place += length
    if not chunks or chunks[0][0] != b"JSON":
        raise FileFormatError("expected JSON as the first chunk of the GLB")
    binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == b"BIN\0" else None
    return bytes(chunks[0][1]), binary


class _Reader:
    """The reading of one document."""

    def __init__(self, path: Path, document: gltf.Document, binary: memoryview | None) -> None:
        self._path = path
        self._document = document
        self._data = Data(path, document, binary)
        self._parts: dict[tuple[object, ...], tuple[Part, ...]] = {}
        self._pictures: dict[int, Picture] = {}
        self._left_out: Counter[str] = Counter()
        self._parents = _parents(document.nodes)
        self._places: dict[int, Floats] = {}
        self._skins: dict[int, Skin] = {}
        self._rest = Pose(np.empty((0, 4, 4)), self._skins)
        self._weighted: dict[int, int] = {}
        self.file = SceneFile(up="y", expansion=self._data.expansion)

    def read(self) -> None:
        """Read the nodes of the scene."""
        nodes = self._document.nodes
        order: list[tuple[int, int, Names]] = []  # node, its top node, the names from there
        hidden: set[int] = set()
        tops = [index for index, parent in enumerate(self._parents) if parent is None]
        shown_tops = self._tops(tops)
        reached = 0
        for top in [*shown_tops, *sorted(set(tops) - set(shown_tops))]:
            stack: list[tuple[int, Names, int]] = [(top, Names(self._name(top)), 0)]
            while stack:
                index, names, depth = stack.pop()
                reached += 1
                node, parent = nodes[index], self._parents[index]
                if depth == MOST_DEPTH:
                    raise FileFormatError(f"nodes[{index}]: expected at most {MOST_DEPTH} nodes in line, got more")
                local = local_of(node, f"nodes[{index}]")
                with np.errstate(over="ignore", invalid="ignore"):
                    self._places[index] = local if parent is None else self._places[parent] @ local
                if not node.extensions.visibility.visible or parent in hidden:
                    hidden.add(index)
                order.append((index, top, names))
                stack += [(child, Names(self._name(child), names), depth + 1) for child in reversed(node.children)]
        if reached < len(nodes):
            cycle = next(index for index in range(len(nodes)) if index not in self._places)
            raise FileFormatError(f"nodes[{cycle}]: expected a tree, got nodes that lie below themselves")
        self._rest = Pose(np.array([self._places[index] for index in range(len(nodes))]), self._skins)
        animations = animations_of(self._document, self._data)
        self._weighted = weights_animated(animations)
        self.file.figure = figure_of(animations, nodes, [index for index, _, _ in order], self._parents, self._rest)
        drawn = set(shown_tops)
        for index, top, names in order:
            mesh = nodes[index].mesh
            if top in drawn and mesh is not None:
                if index in hidden:
                    self._left_out["hidden nodes"] += 1
                else:
                    self._add(mesh, index, top, names)
        self.file.left_out += [f"{what} ({count:,})" for what, count in self._left_out.items()]

    def _name(self, index: int) -> str:
        """Return the name of a node, else of its mesh, else its number."""
        node = self._document.nodes[index]
        mesh = "" if node.mesh is None else at(self._document.meshes, node.mesh, f"nodes[{index}].mesh").name
        return node.name or mesh or str(index)

    def _tops(self, tops: list[int]) -> list[int]:
        """Return the top nodes of the default scene, else of the first, else all."""
        scenes = self._document.scenes
        if self._document.scene is None and not scenes:
            return tops
        number = self._document.scene or 0
        chosen = at(scenes, number, "scene").nodes
        for place, index in enumerate(chosen):
            where = f"scenes[{number}].nodes[{place}]"
            at(self._document.nodes, index, where)
            if self._parents[index] is not None:
                above = self._parents[index]
                raise FileFormatError(f"{where}: expected a top node, got {index}, which is below nodes[{above}]")
        if len(set(chosen)) < len(chosen):
            raise FileFormatError(f"scenes[{number}].nodes: expected each node once")
        return chosen

    def _add(self, mesh: int, index: int, top: int, names: Names) -> None:
        """Add a node with a mesh."""
        node, place = self._document.nodes[index], self._places[index]
        parts = self._mesh(mesh, index)
        if node.skin is not None:
            place = np.eye(4)  # its vertices are where the joints are
        if not parts:
            return
        parent = self._parents[index]
        instancing = node.extensions.instancing
        copies = np.eye(4)[None] if instancing is None else self._copies(instancing, index)
        for number, copy in enumerate(copies):
            with np.errstate(over="ignore", invalid="ignore"):
                transform = place @ copy
            own, above, first = ((key, number) for key in (index, index if parent is None else parent, top))
            self.file.add(Node(names, transform, parts, own, above, first, copy))

    def _copies(self, instancing: gltf.Instancing, index: int) -> Floats:
        """Return the transforms of the copies of a mesh by ``EXT_mesh_gpu_instancing``, shape (n, 4, 4)."""
        where = f"nodes[{index}].extensions.EXT_mesh_gpu_instancing.attributes"
        found = {
            name: self._data.numbers(accessor, f"{where}.{name}", ["VEC4" if name == "ROTATION" else "VEC3"])
            for name, accessor in instancing.attributes.items()
            if name in {"TRANSLATION", "ROTATION", "SCALE"}
        }
        counts = {len(values) for values in found.values()}
        if len(counts) != 1:
            raise FileFormatError(f"{where}: expected attributes of one count, got {sorted(counts)}")
        count = counts.pop()
        self._data.expansion.take(OBJECT * count)
        for name, values in found.items():
            check_finite(values, f"{where}.{name}")
        turns = rotations(found.get("ROTATION", np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))), where)
        return transforms(turns * found.get("SCALE", np.ones((count, 3)))[:, None, :], found.get("TRANSLATION", 0.0))

    def _mesh(self, number: int, index: int) -> tuple[Part, ...]:
        """Return the parts of the mesh of a node, which nodes without their own weights or skin share."""
        node, where = self._document.nodes[index], f"nodes[{index}]"
        mesh = at(self._document.meshes, number, f"{where}.mesh")
        weights = mesh.weights if node.weights is None else node.weights
        animated = index if index in self._weighted else None
        key = (number, None if weights is None else tuple(weights), node.skin, animated)
        if key not in self._parts:
            if node.skin is not None:
                self._read_skin(node.skin, f"{where}.skin")
            found = []
            for place, primitive in enumerate(mesh.primitives):
                part = self._primitive(primitive, f"meshes[{number}].primitives[{place}]", weights, index)
                if part is not None:
                    found.append(part)
            self._parts[key] = tuple(found)
        return self._parts[key]

    def _read_skin(self, number: int, where: str) -> None:
        """Read the joints of a skin, and the maps from the bound mesh to them."""
        skin = at(self._document.skins, number, where)
        if number in self._skins:
            return
        for place, joint in enumerate(skin.joints):
            at(self._document.nodes, joint, f"skins[{number}].joints[{place}]")
        joints = np.array(skin.joints)
        if skin.inverse_bind_matrices is None:
            self._skins[number] = Skin(joints, None)
            return
        name = f"skins[{number}].inverseBindMatrices"
        inverse = self._data.numbers(skin.inverse_bind_matrices, name, ["MAT4"], "f")
        if len(inverse) < len(joints):
            raise FileFormatError(f"{name}: expected {len(joints)}, one a joint, got {len(inverse)}")
        check_finite(inverse, name)
        columns = inverse[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)  # stored column by column
        self._skins[number] = Skin(joints, columns)

    def _primitive(
        self, primitive: gltf.Primitive, where: str, weights: Sequence[float] | None, index: int
    ) -> Part | None:
        """Return the part that a primitive makes for a node, or None for points, lines and what has no positions."""
        if primitive.mode == POINTS or primitive.mode in LINES:
            self._left_out["points and lines"] += 1
            return None
        if "POSITION" not in primitive.attributes:
            self._left_out["primitives without positions"] += 1
            return None
        attribute, faces = self._attributes(primitive, where)
        vertices = attribute("POSITION", ["VEC3"])
        check_finite(vertices, f"{where}.attributes.POSITION")
        bend = self._bend(vertices, primitive, where, attribute, weights=weights, index=index)
        if bend is not None:
            vertices = bend.at(self._rest)
            if bend.skin is not None:
                check_finite(vertices, f"{where}, moved by its skin")
        indices = self._indices(primitive, where, len(vertices), faces)
        triangles = _triangles(primitive.mode if faces is None else TRIANGLES, indices, where)
        corners = triangles.ravel()
        used = np.zeros(len(vertices), bool)
        used[corners] = True
        if not used.all():  # primitives may share the vertices of a whole file
            vertices, corners = vertices[used], (np.cumsum(used) - 1)[corners]
            bend = None if bend is None else bend.of(used)
        self._data.expansion.take(vertices.nbytes + corners.nbytes + 8 * len(triangles))
        material = (
            None
            if primitive.material is None
            else at(self._document.materials, primitive.material, f"{where}.material")
        )
        paint = partial(self._paint, primitive, where, attribute, used=used, corners=corners)
        name = "" if material is None else material.name or f"{primitive.material}"
        return Part(vertices, corners, np.full(len(triangles), 3), name, paint, bend)

    def _paint(
        self,
        primitive: gltf.Primitive,
        where: str,
        attribute: Callable[..., Any],
        *,
        used: npt.NDArray[np.bool_],
        corners: Indices,
    ) -> Paint:
        """Return the base colours of the vertices that are used."""
        color, picture, found = np.ones(3), None, {}
        if primitive.material is not None:
            material = self._document.materials[primitive.material]
            base, older = material.pbr_metallic_roughness, material.extensions.specular
            factor, texture = base.base_color_factor, base.base_color_texture
            if older is not None:
                factor, texture = older.diffuse_factor, older.diffuse_texture
            color = np.array(factor[:3])
            if texture is not None:
                picture = self._picture(texture.index, f"materials[{primitive.material}], its texture")
                found["TEXCOORD"] = _uv(texture, primitive, attribute)
        if "COLOR_0" in primitive.attributes:
            found["COLOR_0"] = attribute("COLOR_0", ["VEC3", "VEC4"])[:, :3]
        for name, values in found.items():
            if values is not None:
                check_finite(values, f"{where}.attributes.{name}")
                if len(values) != len(used):
                    raise FileFormatError(f"{where}.attributes.{name}: expected {len(used)}, got {len(values)}")
                found[name] = values[used]
        uv = found.get("TEXCOORD")
        return Paint(color, found.get("COLOR_0"), picture, None if uv is None else uv[corners])

    def _attributes(self, primitive: gltf.Primitive, where: str) -> tuple[Callable[..., Any], Indices | None]:
        """Return a function that gives the numbers of an attribute, and the vertices of the faces if Draco has them."""
        draco = primitive.extensions.draco
        decoded: Any = None
        if draco is not None and self._needs_draco(primitive):
            decoded = self._decode(draco, where)

        def attribute(name: str, kinds: Sequence[str], dtypes: str = "fiu") -> Any:
            index = primitive.attributes[name]
            place = f"{where}.attributes.{name}"
            accessor = at(self._document.accessors, index, place)
            stored = accessor.buffer_view is not None or accessor.sparse is not None
            if decoded is None or draco is None or (name not in draco.attributes and stored):
                return self._data.numbers(index, place, kinds, dtypes)
            found = decoded.get_attribute_by_unique_id(draco.attributes.get(name, -1))
            values = None if found is None else np.asarray(found["data"])
            shape = (accessor.count, int(accessor.type[-1]) if accessor.type[-1].isdigit() else 1)
            if values is None or values.shape != shape or accessor.type not in kinds or values.dtype.kind not in dtypes:
                got = "none" if values is None else f"{values.dtype} of shape {values.shape}"
                raise FileFormatError(f"{place}: expected {' or '.join(kinds)} of shape {shape} by Draco, got {got}")
            return real(values, normalized=accessor.normalized)

        return attribute, None if decoded is None else np.asarray(decoded.faces, np.int64).ravel()

    def _needs_draco(self, primitive: gltf.Primitive) -> bool:
        """Return whether a primitive compressed by Draco has no other data."""
        places = [*primitive.attributes.values(), *([] if primitive.indices is None else [primitive.indices])]
        stored = [at(self._document.accessors, place, "accessors") for place in places]
        return any(accessor.buffer_view is None and accessor.sparse is None for accessor in stored)

    def _decode(self, draco: gltf.Draco, where: str) -> Any:
        """Return what DracoPy decodes."""
        name = f"{where}.extensions.{DRACO}"
        module = import_extra("DracoPy", "formats", f"{self._path}: {DRACO}")
        content = bytes(self._data.view(draco.buffer_view, f"{name}.bufferView"))
        try:
            decoded = module.decode(content)
        except Exception as error:
            raise FileFormatError(f"{name}: DracoPy cannot decode it") from error
        if not hasattr(decoded, "faces"):
            raise FileFormatError(f"{name}: expected a mesh, got a point cloud")
        return decoded

    def _indices(self, primitive: gltf.Primitive, where: str, vertices: int, faces: Indices | None) -> Indices:
        """Return the vertices of the faces, those of Draco if there are."""
        name = f"{where}.indices"
        if faces is not None:
            indices = faces
        elif primitive.indices is None:
            return np.arange(vertices)
        else:
            indices = self._data.accessor(primitive.indices, name, ["SCALAR"], "u")[:, 0].astype(np.int64)
        wrong = np.flatnonzero((indices >= vertices) | (indices < 0))
        if len(wrong):
            got = indices[wrong[0]]
            raise FileFormatError(f"{name}[{wrong[0]}]: expected an index below {vertices}, got {got}")
        return indices

    def _bend(
        self,
        vertices: Floats,
        primitive: gltf.Primitive,
        where: str,
        attribute: Callable[..., Any],
        *,
        weights: Sequence[float] | None,
        index: int,
    ) -> Bend | None:
        """Return how morph targets and the skin of a node move vertices, or None if nothing does."""
        targets: list[Floats | None] = []
        count = self._weighted.get(index)
        if weights is None and count is not None:
            weights = [0.0] * count
        if weights is not None and primitive.targets:
            for expected in (len(weights), count):
                if expected is not None and expected != len(primitive.targets):
                    got = len(primitive.targets)
                    raise FileFormatError(f"{where}.targets: expected {expected}, one a weight, got {got}")
            targets = [
                self._target(target, f"{where}.targets[{number}].POSITION", len(vertices))
                if weight or count is not None
                else None
                for number, (weight, target) in enumerate(zip(weights, primitive.targets, strict=True))
            ]
        skin = self._document.nodes[index].skin
        if targets or skin is not None:  # float64 of the targets, and 64-bit joints and weights by four
            sets = sum(name.startswith("JOINTS_") for name in primitive.attributes)
            self._data.expansion.take((vertices.nbytes * (1 + len(targets))) + 64 * sets * len(vertices))
        if skin is None:
            return Bend(index, vertices, tuple(weights or ()), tuple(targets)) if targets else None
        joints, influence = _influences(primitive, where, attribute, len(vertices), len(self._skins[skin].joints))
        given = tuple(weights or ()) if targets else ()
        return Bend(index, vertices, given, tuple(targets), skin, joints, influence)

    def _target(self, target: gltf.Attributes, where: str, vertices: int) -> Floats | None:
        """Return the displacements by a morph target, if it has any."""
        if "POSITION" not in target:
            return None
        moves = self._data.numbers(target["POSITION"], where, ["VEC3"])
        check_finite(moves, where)
        if len(moves) != vertices:
            raise FileFormatError(f"{where}: expected {vertices}, one a vertex, got {len(moves)}")
        return moves

    def _picture(self, index: int, where: str) -> Picture:
        """Return a texture."""
        if index in self._pictures:
            return self._pictures[index]
        texture = at(self._document.textures, index, where)
        sampler = gltf.Sampler()
        if texture.sampler is not None:
            sampler = at(self._document.samplers, texture.sampler, f"textures[{index}].sampler")
        # A ray hits a point, which is the limit of magnification.
        nearest = (sampler.mag_filter or sampler.min_filter) in NEAREST
        source = texture.source
        if source is None and texture.extensions.webp is not None:
            source = texture.extensions.webp.source
        if source is None:
            raise FileFormatError(f"textures[{index}]: expected an image in PNG, JPEG or WebP")
        image = at(self._document.images, source, f"textures[{index}].source")
        read = partial(self._image, image, f"images[{source}]")
        wrap = WRAPS[sampler.wrap_s], WRAPS[sampler.wrap_t]
        self._pictures[index] = Picture(read, wrap, "nearest" if nearest else "linear")
        return self._pictures[index]

    def _image(self, image: gltf.Image, where: str) -> bytes:
        """Return the bytes of an image."""
        if image.uri is not None:
            return self._data.file(image.uri, where)
        if image.buffer_view is not None:
            return bytes(self._data.view(image.buffer_view, f"{where}.bufferView"))
        raise FileFormatError(f"{where}: expected a uri or a bufferView")


def _parents(nodes: Sequence[gltf.Node]) -> list[int | None]:
    """Return the parent of each node."""
    parents: list[int | None] = [None] * len(nodes)
    for index, node in enumerate(nodes):
        for place, child in enumerate(node.children):
            where = f"nodes[{index}].children[{place}]"
            at(nodes, child, where)
            if parents[child] is not None:
                other = f"{child}, which is below nodes[{parents[child]}] too"
                raise FileFormatError(f"{where}: expected a node with one parent, got {other}")
            parents[child] = index
    return parents


def _triangles(mode: int, indices: Indices, where: str) -> Indices:
    """Return the triangles of a list, strip or fan of vertices, shape (n, 3)."""
    if len(indices) < 3 or (mode == TRIANGLES and len(indices) % 3):
        expected = "a multiple of three vertices" if mode == TRIANGLES else "at least three vertices"
        raise FileFormatError(f"{where}: expected {expected}, got {len(indices)}")
    if mode == TRIANGLES:
        return indices.reshape(-1, 3)
    if mode == STRIP:
        return of_strips(indices, np.array([len(indices)]))[0].reshape(-1, 3)
    return np.stack([indices[1:-1], indices[2:], np.broadcast_to(indices[0], len(indices) - 2)], axis=1)


def _influences(
    primitive: gltf.Primitive, where: str, attribute: Callable[..., Any], vertices: int, joints_of_skin: int
) -> tuple[Indices, Floats]:
    """Return the joints that move each vertex and their weights, both of shape (n, k)."""
    found: tuple[list[Indices], list[Floats]] = ([], [])
    sets = sum(name.startswith("JOINTS_") for name in primitive.attributes)
    for number in range(sets):
        names = f"JOINTS_{number}", f"WEIGHTS_{number}"
        for name in names:
            if name not in primitive.attributes:
                raise FileFormatError(f"{where}.attributes: missing {name}")
        joints = attribute(names[0], ["VEC4"], "u").astype(np.int64)
        weights = attribute(names[1], ["VEC4"], "fu")
        if joints.shape != weights.shape or len(joints) != vertices:
            got = f"{len(joints)} and {len(weights)}"
            raise FileFormatError(f"{where}.attributes: expected {vertices} {names[0]} and {names[1]}, got {got}")
        check_finite(weights, f"{where}.attributes.{names[1]}")
        wrong = np.argwhere((joints >= joints_of_skin) & (weights != 0.0))
        if len(wrong):
            i, j = wrong[0]
            expected = f"joints below {joints_of_skin}"
            raise FileFormatError(f"{where}.attributes.{names[0]}[{i}]: expected {expected}, got {joints[i, j]}")
        joints[weights == 0.0] = 0
        found[0].append(joints)
        found[1].append(weights)
    influence = np.concatenate(found[1], axis=1) if sets else np.zeros((vertices, 0))
    total = total_of(influence)
    without = np.flatnonzero(~(total > 0.0))
    if len(without):
        got = total[without[0]]
        raise FileFormatError(f"{where}.attributes: expected weights > 0, got a sum of {got} at vertex {without[0]}")
    return np.concatenate(found[0], axis=1), influence


def _uv(texture: gltf.TextureInfo, primitive: gltf.Primitive, attribute: Callable[..., Any]) -> Floats | None:
    """Return the texture coordinates of the vertices, transformed by ``KHR_texture_transform``."""
    change = texture.extensions.transform
    chosen = texture.tex_coord if change is None or change.tex_coord is None else change.tex_coord
    name = f"TEXCOORD_{chosen}"
    if name not in primitive.attributes:
        return None
    uv: Floats = attribute(name, ["VEC2"])
    if change is None:
        return uv
    cos, sin = np.cos(change.rotation), np.sin(change.rotation)
    turned: Floats = uv * change.scale @ np.array([[cos, -sin], [sin, cos]]) + change.offset
    return turned
