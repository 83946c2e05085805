"""glTF 2.0 (``.glb``, ``.gltf``): the triangles of its default scene, in rest pose.

Read are: triangles, strips and fans; sparse, normalised and quantised accessors (``KHR_mesh_quantization``);
``KHR_draco_mesh_compression`` (by DracoPy) and ``EXT_mesh_gpu_instancing``; skins and morph targets; base colours.
Points, lines, cameras, lights and animations are passed over. A file that requires another extension is refused.

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

from lidarsim._extras import import_extra
from lidarsim._validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io.scenes import _gltf_document as gltf
from lidarsim.io.scenes._gltf_data import Data, at, real
from lidarsim.io.scenes._model import MOST_DEPTH, MOST_OBJECTS, Indices, Names, Node, Paint, Part, Picture, SceneFile
from lidarsim.materials import Wrap
from lidarsim.shapes._polygons import of_strips

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


def read(path: Path) -> SceneFile:
    """Read a file."""
    document, binary = _opened(path.read_bytes())
    reader = _Reader(path, document, binary)
    reader.read()
    return reader.file


def _opened(data: bytes) -> tuple[gltf.Document, memoryview | None]:
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
        self.file = SceneFile(up="y")

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
                local = _local(node, f"nodes[{index}]")
                with np.errstate(over="ignore", invalid="ignore"):
                    self._places[index] = local if parent is None else self._places[parent] @ local
                if not node.extensions.visibility.visible or parent in hidden:
                    hidden.add(index)
                order.append((index, top, names))
                stack += [(child, Names(self._name(child), names), depth + 1) for child in reversed(node.children)]
        if reached < len(nodes):
            cycle = next(index for index in range(len(nodes)) if index not in self._places)
            raise FileFormatError(f"nodes[{cycle}]: expected a tree, got nodes that lie below themselves")
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
            keys = [(key, number) for key in (index, index if parent is None else parent, top)]
            self.file.add(Node(names, transform, parts, *keys))

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
        if count > MOST_OBJECTS:
            raise FileFormatError(f"{where}: expected at most {MOST_OBJECTS:,} copies, got {count:,}")
        for name, values in found.items():
            _check_finite(values, f"{where}.{name}")
        turns = _rotations(found.get("ROTATION", np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))), where)
        placed = np.tile(np.eye(4), (count, 1, 1))
        placed[:, :3, :3] = turns * found.get("SCALE", np.ones((count, 3)))[:, None, :]
        placed[:, :3, 3] = found.get("TRANSLATION", 0.0)
        return placed

    def _mesh(self, number: int, index: int) -> tuple[Part, ...]:
        """Return the parts of the mesh of a node, which nodes without their own weights or skin share."""
        node, where = self._document.nodes[index], f"nodes[{index}]"
        mesh = at(self._document.meshes, number, f"{where}.mesh")
        weights = mesh.weights if node.weights is None else node.weights
        key = (number, None if weights is None else tuple(weights), node.skin)
        if key not in self._parts:
            skin = None if node.skin is None else self._skin(node.skin, f"{where}.skin")
            found = []
            for place, primitive in enumerate(mesh.primitives):
                part = self._primitive(primitive, f"meshes[{number}].primitives[{place}]", weights, skin)
                if part is not None:
                    found.append(part)
            self._parts[key] = tuple(found)
        return self._parts[key]

    def _skin(self, number: int, where: str) -> Floats:
        """Return the transforms of the joints of a skin, from the bound mesh to the scene, shape (joints, 4, 4)."""
        skin = at(self._document.skins, number, where)
        for place, joint in enumerate(skin.joints):
            at(self._document.nodes, joint, f"skins[{number}].joints[{place}]")
        places = np.array([self._places[joint] for joint in skin.joints])
        if skin.inverse_bind_matrices is None:
            return places
        name = f"skins[{number}].inverseBindMatrices"
        inverse = self._data.numbers(skin.inverse_bind_matrices, name, ["MAT4"], "f")
        if len(inverse) < len(places):
            raise FileFormatError(f"{name}: expected {len(places)}, one a joint, got {len(inverse)}")
        _check_finite(inverse, name)
        columns = inverse[: len(places)].reshape(-1, 4, 4).transpose(0, 2, 1)  # stored column by column
        with np.errstate(over="ignore", invalid="ignore"):
            return places @ columns

    def _primitive(
        self, primitive: gltf.Primitive, where: str, weights: Sequence[float] | None, skin: Floats | None
    ) -> Part | None:
        """Return the part that a primitive makes, or None for points, lines and what has no positions."""
        if primitive.mode == POINTS or primitive.mode in LINES:
            self._left_out["points and lines"] += 1
            return None
        if "POSITION" not in primitive.attributes:
            self._left_out["primitives without positions"] += 1
            return None
        attribute, faces = self._attributes(primitive, where)
        vertices = attribute("POSITION", ["VEC3"])
        _check_finite(vertices, f"{where}.attributes.POSITION")
        vertices = self._morphed(vertices, primitive, where, weights)
        if skin is not None:
            vertices = _skinned(vertices, primitive, where, attribute, skin)
        indices = self._indices(primitive, where, len(vertices), faces)
        triangles = _triangles(primitive.mode if faces is None else TRIANGLES, indices, where)
        corners = triangles.ravel()
        used = np.zeros(len(vertices), bool)
        used[corners] = True
        if not used.all():  # primitives may share the vertices of a whole file
            vertices, corners = vertices[used], (np.cumsum(used) - 1)[corners]
        material = (
            None
            if primitive.material is None
            else at(self._document.materials, primitive.material, f"{where}.material")
        )
        paint = partial(self._paint, primitive, where, attribute, used=used, corners=corners)
        name = "" if material is None else material.name or f"{primitive.material}"
        return Part(vertices, corners, np.full(len(triangles), 3), name, paint)

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
                _check_finite(values, f"{where}.attributes.{name}")
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
            decoded = self._decoded(draco, where)

        def attribute(name: str, kinds: Sequence[str], dtypes: str = "fiu") -> Any:
            index = primitive.attributes[name]
            place = f"{where}.attributes.{name}"
            if decoded is None or draco is None or name not in draco.attributes:
                return self._data.numbers(index, place, kinds, dtypes)
            accessor = at(self._document.accessors, index, place)
            found = decoded.get_attribute_by_unique_id(draco.attributes[name])
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

    def _decoded(self, draco: gltf.Draco, where: str) -> Any:
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

    def _morphed(
        self, vertices: Floats, primitive: gltf.Primitive, where: str, weights: Sequence[float] | None
    ) -> Floats:
        """Return vertices displaced by morph targets."""
        if weights is None or not primitive.targets:
            return vertices
        if len(weights) != len(primitive.targets):
            got = len(primitive.targets)
            raise FileFormatError(f"{where}.targets: expected {len(weights)}, one a weight, got {got}")
        for number, (weight, target) in enumerate(zip(weights, primitive.targets, strict=True)):
            if weight and "POSITION" in target:
                name = f"{where}.targets[{number}].POSITION"
                moves = self._data.numbers(target["POSITION"], name, ["VEC3"])
                _check_finite(moves, name)
                if len(moves) != len(vertices):
                    raise FileFormatError(f"{name}: expected {len(vertices)}, one a vertex, got {len(moves)}")
                vertices = vertices + weight * moves
        return vertices

    def _picture(self, index: int, where: str) -> Picture:
        """Return a texture."""
        if index in self._pictures:
            return self._pictures[index]
        texture = at(self._document.textures, index, where)
        wrap = (10497, 10497)
        if texture.sampler is not None:
            sampler = at(self._document.samplers, texture.sampler, f"textures[{index}].sampler")
            wrap = sampler.wrap_s, sampler.wrap_t
        source = texture.source
        if source is None and texture.extensions.webp is not None:
            source = texture.extensions.webp.source
        if source is None:
            raise FileFormatError(f"textures[{index}]: expected an image in PNG, JPEG or WebP")
        image = at(self._document.images, source, f"textures[{index}].source")
        read = partial(self._image, image, f"images[{source}]")
        self._pictures[index] = Picture(read, (WRAPS[wrap[0]], WRAPS[wrap[1]]))
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


def _local(node: gltf.Node, where: str) -> Floats:
    """Return the transform of a node, shape (4, 4)."""
    parts = (node.translation, node.rotation, node.scale)
    if node.matrix is not None:
        if any(part is not None for part in parts):
            raise FileFormatError(f"{where}: expected either a matrix or translation, rotation and scale, got both")
        matrix = np.reshape(node.matrix, (4, 4)).T.copy()  # stored column by column
        if matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
            raise FileFormatError(f"{where}.matrix: expected (0, 0, 0, 1) as the last row, got {matrix[3].tolist()}")
        return matrix
    matrix = np.eye(4)
    if node.rotation is not None:
        matrix[:3, :3] = _rotations(np.array([node.rotation]), f"{where}.rotation")[0]
    if node.scale is not None:
        matrix[:3, :3] *= node.scale
    if node.translation is not None:
        matrix[:3, 3] = node.translation
    return matrix


def _rotations(quaternions: Floats, where: str) -> Floats:
    """Return the matrices of quaternions (x, y, z, w) of any length but zero, shape (n, 3, 3).

    A matrix of quaternions (0, 0, 0, w) is the identity, and the matrices of half turns about an axis are exact.
    """
    largest = np.abs(quaternions).max(axis=1, keepdims=True)
    wrong = np.flatnonzero(largest[:, 0] == 0.0)
    if len(wrong):
        raise FileFormatError(f"{where}: expected quaternions other than zero, got zero at place {wrong[0]}")
    scaled = quaternions / largest
    x, y, z, w = scaled.T
    s = 2.0 / (scaled**2).sum(axis=1)
    rows = [
        [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


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


def _skinned(
    vertices: Floats, primitive: gltf.Primitive, where: str, attribute: Callable[..., Any], skin: Floats
) -> Floats:
    """Return vertices at rest in the scene: the mean of their places by their joints, by weight."""
    moved = np.zeros((len(vertices), 3))
    total = np.zeros(len(vertices))
    homogeneous = np.column_stack((vertices, np.ones(len(vertices))))
    sets = sum(name.startswith("JOINTS_") for name in primitive.attributes)
    for number in range(sets):
        names = f"JOINTS_{number}", f"WEIGHTS_{number}"
        for name in names:
            if name not in primitive.attributes:
                raise FileFormatError(f"{where}.attributes: missing {name}")
        joints = attribute(names[0], ["VEC4"], "u").astype(np.int64)
        weights = attribute(names[1], ["VEC4"], "fu")
        if joints.shape != weights.shape or len(joints) != len(vertices):
            got = f"{len(joints)} and {len(weights)}"
            raise FileFormatError(f"{where}.attributes: expected {len(vertices)} {names[0]} and {names[1]}, got {got}")
        _check_finite(weights, f"{where}.attributes.{names[1]}")
        wrong = np.argwhere((joints >= len(skin)) & (weights != 0.0))
        if len(wrong):
            i, j = wrong[0]
            got = joints[i, j]
            raise FileFormatError(f"{where}.attributes.{names[0]}[{i}]: expected joints below {len(skin)}, got {got}")
        joints[weights == 0.0] = 0
        total += weights.sum(axis=1)
        for slot in range(4):
            placed = np.einsum("nij,nj->ni", skin[joints[:, slot], :3], homogeneous)
            moved += weights[:, slot, None] * placed
    without = np.flatnonzero(~(total > 0.0))
    if len(without):
        got = total[without[0]]
        raise FileFormatError(f"{where}.attributes: expected weights > 0, got a sum of {got} at vertex {without[0]}")
    moved /= total[:, None]
    _check_finite(moved, f"{where}, moved by its skin")
    return moved


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


def _check_finite(values: npt.NDArray[Any], where: str) -> None:
    finite = np.isfinite(values)
    if not finite.all():
        i, j = np.argwhere(~finite)[0]
        raise FileFormatError(f"{where}[{i}]: expected finite numbers, got {values[i, j]}")
