"""A writer of small glTF files, right or wrong."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])


class Gltf:
    """A document and its buffer, to which accessors, meshes and nodes are added; ``tree`` is the document."""

    def __init__(self, **tree: Any) -> None:
        self.blob = bytearray()
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], **tree}

    def put(self, key: str, item: Any) -> int:
        items = self.tree.setdefault(key, [])
        items.append(item)
        return len(items) - 1

    def view(self, data: bytes, **more: Any) -> int:
        self.blob += bytes(-len(self.blob) % 4)
        place = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data), **more}
        self.blob += data
        return self.put("bufferViews", place)

    def numbers(self, values: npt.ArrayLike, dtype: str = "f4", **more: Any) -> int:
        array = np.asarray(values).astype(f"<{dtype}")
        width = array[0].size
        return self.put(
            "accessors",
            {
                "bufferView": self.view(array.tobytes()),
                "componentType": CODES[dtype],
                "count": len(array),
                "type": KINDS[width],
                **more,
            },
        )

    def primitive(self, vertices: npt.ArrayLike = CORNERS, indices: Any = (0, 1, 2), **more: Any) -> dict[str, Any]:
        attributes = {"POSITION": self.numbers(vertices), **more.pop("attributes", {})}
        faces = {} if indices is None else {"indices": self.numbers(np.asarray(indices), "u2")}
        return {"attributes": attributes, **faces, **more}

    def mesh(self, *primitives: dict[str, Any], **more: Any) -> int:
        return self.put("meshes", {"primitives": list(primitives or [self.primitive()]), **more})

    def node(self, top: bool = True, **more: Any) -> int:
        number = self.put("nodes", more)
        if top:
            self.tree["scenes"][0]["nodes"].append(number)
        return number

    @property
    def data(self) -> bytes:
        return bytes(self.blob + bytes(-len(self.blob) % 4))

    def save(self, path: Path, uri: str | None = None) -> Path:
        """Write a GLB, or a glTF with a file of its buffer beside it, or with the buffer in a URI."""
        blob = self.data
        tree = dict(self.tree)
        if blob:
            tree.setdefault("buffers", [{"byteLength": len(blob)}])
        if path.suffix == ".gltf":
            if uri is None:
                path.with_suffix(".bin").write_bytes(blob)
                uri = f"{path.stem}.bin"
            if blob and "uri" not in tree["buffers"][0]:
                tree["buffers"] = [{**tree["buffers"][0], "uri": uri}, *tree["buffers"][1:]]
            path.write_text(json.dumps(tree), encoding="utf-8")
            return path
        head = json.dumps(tree).encode()
        head += b" " * (-len(head) % 4)
        chunks = [struct.pack("<I4s", len(head), b"JSON"), head]
        if blob:
            chunks += [struct.pack("<I4s", len(blob), b"BIN\0"), blob]
        size = 12 + sum(map(len, chunks))
        path.write_bytes(b"".join([struct.pack("<4sII", b"glTF", 2, size), *chunks]))
        return path

    def data_uri(self) -> str:
        return f"data:application/octet-stream;base64,{base64.b64encode(self.data).decode()}"


def one(*primitives: Any, **more: Any) -> Gltf:
    """A document with one node that has one mesh."""
    file = Gltf()
    made = [make(file) if callable(make) else make for make in primitives]
    file.node(mesh=file.mesh(*made), **more)
    return file
