"""Workarounds for trimesh's glTF reader: node order and names are corrected; geometry that it misreads is refused.

Format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.
"""

from __future__ import annotations

import json
import re
import struct
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

from lidarsim.errors import FileFormatError

GLB = struct.Struct("<4sII")
CHUNK = struct.Struct("<I4s")
HARMLESS = re.compile(r"KHR_(materials|texture|lights|xmp)_\w+|EXT_texture_\w+|KHR_mesh_quantization")
"""Extensions that do not change the triangles."""
DRACO = "KHR_draco_mesh_compression"


def prepared(path: Path) -> tuple[BytesIO, list[str]]:
    """Return a file for trimesh in which each node is named by its number, and the original names.

    trimesh gives the parts of a node random names, visits nodes from last to first, and drops a node with a camera
    together with its children.
    """
    data = path.read_bytes()
    if path.suffix.lower() == ".gltf":
        document = json.loads(data.decode("utf-8-sig"))
        names = _prepare(document)
        return BytesIO(json.dumps(document).encode()), names
    magic, version, _ = GLB.unpack_from(data)
    length, kind = CHUNK.unpack_from(data, GLB.size)
    start = GLB.size + CHUNK.size
    if (magic, version, kind) != (b"glTF", 2, b"JSON") or start + length > len(data):
        raise FileFormatError("it does not begin as a GLB of version 2 does, or is truncated")
    document = json.loads(data[start : start + length])
    names = _prepare(document)
    header = json.dumps(document).encode()
    header += b" " * (-len(header) % 4)
    rest = data[start + length :]
    size = start + len(header) + len(rest)
    whole = (GLB.pack(magic, version, size), CHUNK.pack(len(header), kind), header, rest)
    return BytesIO(b"".join(whole)), names


def _prepare(document: dict[str, Any]) -> list[str]:
    """Check a document, change it as `prepared` describes and return the names of its nodes."""
    for name in document.get("extensionsRequired", []):
        if not HARMLESS.fullmatch(name) and (name != DRACO or not find_spec("DracoPy")):
            known = name if re.fullmatch(r"[A-Z]{2,8}_\w{1,60}", name, re.ASCII) else "an extension"
            raise FileFormatError(f"it requires {known}, which is not supported")
    for mesh in document.get("meshes", []):
        for primitive in mesh["primitives"]:
            _check(primitive, document)
    nodes = document.get("nodes", [])
    names = [node.get("name", str(number)) for number, node in enumerate(nodes)]
    for number, node in enumerate(nodes):
        node["name"] = str(number)
        node.pop("camera", None)
        node.get("children", []).reverse()
    for scene in document.get("scenes", []):
        scene.get("nodes", []).reverse()
    return names


def _check(primitive: dict[str, Any], document: dict[str, Any]) -> None:
    """Raise an error for a primitive whose triangles trimesh drops or misreads."""
    mode = primitive.get("mode", 4)
    if mode in {0, 1, 2, 3}:  # points and lines
        return
    if mode not in {4, 5}:
        raise FileFormatError("it has a fan of triangles, which is not supported")
    compressed = DRACO in primitive.get("extensions", {})
    if compressed and find_spec("DracoPy"):
        return
    places = {"positions": primitive["attributes"]["POSITION"], "indices": primitive.get("indices")}
    for what, place in places.items():
        accessor = {"bufferView": None} if place is None else document["accessors"][place]
        if "sparse" in accessor or "bufferView" not in accessor:
            reason = "compressed by Draco (pip install DracoPy)" if compressed else "sparse, which is not supported"
            raise FileFormatError(f"its {what} are {reason}")
        if what == "positions" and accessor.get("normalized"):
            raise FileFormatError("its positions are normalized integers, which are not supported")
        view = document["bufferViews"][accessor["bufferView"]] if place is not None else {}
        if any("meshopt" in name for name in view.get("extensions", {})):
            raise FileFormatError(f"its {what} are compressed by meshopt, which is not supported")
