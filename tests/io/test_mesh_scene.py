"""Scenes of meshes: names and order of glTF, and what trimesh reads wrongly is refused."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")


def document(nodes: list[dict[str, Any]], primitives: int = 1) -> dict[str, Any]:
    """One mesh of a triangle, or of several, as nodes place it."""
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [k for k in range(len(nodes)) if not any(k in n.get("children", []) for n in nodes)]}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1} for _ in range(primitives)]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
        "buffers": [{"byteLength": 44}],
    }


def write(path: Path, tree: dict[str, Any], indices: tuple[int, ...] = (0, 1, 2)) -> Path:
    blob = CORNERS.tobytes() + np.array([*indices, 0], "<u2").tobytes()
    if path.suffix == ".gltf":
        path.with_suffix(".bin").write_bytes(blob)
        tree = tree | {"buffers": [{"byteLength": len(blob), "uri": f"{path.stem}.bin"}]}
        path.write_text(json.dumps(tree), encoding="utf-8")
        return path
    head = json.dumps(tree).encode()
    head += b" " * (-len(head) % 4)
    parts = [
        struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(blob)),
        struct.pack("<I4s", len(head), b"JSON"),
        head,
    ]
    path.write_bytes(b"".join([*parts, struct.pack("<I4s", len(blob), b"BIN\0"), blob]))
    return path


@pytest.fixture(params=[".glb", ".gltf"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return tmp_path / f"a{request.param}"


def at(x: float) -> dict[str, Any]:
    return {"mesh": 0, "translation": [x, 0, 0]}


def shift(item: ls.SceneObject) -> float:
    return 0.0 if item.transform is None else float(item.transform[0, 3])


def test_instances_keep_names_and_order(place: Path) -> None:
    names = ["road", "car", "tree_1a2b3c", "7", "car", "world"]
    tree = document([{"name": name, **at(5.0 * k)} for k, name in enumerate(names)] + [at(30.0)])
    scene = ls.Scene.from_file(write(place, tree))
    assert [item.name for item in scene] == [*names, "6"]
    assert [shift(item) for item in scene] == [0, 5, 10, 15, 20, 25, 30]
    assert len({id(item.shape) for item in scene}) == 1
    mesh = ls.TriangleMesh.from_file(place)
    assert mesh.vertices[::3, 0].tolist() == [0, 5, 10, 15, 20, 25, 30]


def test_nodes_come_before_what_is_below_them(place: Path) -> None:
    nodes = [
        {"name": "a", **at(1), "children": [2, 1]},
        {"name": "b", **at(1)},
        {"name": "c", "camera": 0, **at(10), "children": [3]},
        {"name": "d", **at(100)},
        {"name": "e", **at(0)},
    ]
    tree = document(nodes) | {"cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}]}
    scene = ls.Scene.from_file(write(place, tree))
    assert [(item.name, shift(item)) for item in scene] == [("a", 1), ("c", 11), ("d", 111), ("b", 2), ("e", 0)]


def test_parts_of_a_node_have_its_name(place: Path) -> None:
    write(place, document([{"name": "car", "mesh": 0}, {"name": "bus", **at(5)}], primitives=2))
    for _ in range(2):
        assert [item.name for item in ls.Scene.from_file(place)] == ["car", "car", "bus", "bus"]


def test_a_mirrored_instance_keeps_its_outside(place: Path) -> None:
    path = write(place, document([{"mesh": 0, "scale": [-1, 1, 1]}, {"mesh": 0, "scale": [2, 2, 2]}]))
    mesh = ls.TriangleMesh.from_file(path)
    hits = mesh.cast([[-0.2, 0.2, 1], [0.2, 0.2, 1]], [[0, 0, -1]] * 2)
    assert hits.normal.tolist() == [[0, 0, 1], [0, 0, 1]]
    assert mesh.vertices.tolist() == [[0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 0], [2, 0, 0], [0, 2, 0]]


def changed(change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    tree = document([{"mesh": 0}])
    change(tree)
    return tree


DRACO = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
WRONG: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "fan": (
        lambda t: t["meshes"][0]["primitives"][0].update(mode=6),
        "it has a fan of triangles, which is not supported",
    ),
    "sparse": (
        lambda t: t["accessors"][0].update(sparse={"count": 1}),
        "its positions are sparse, which is not supported",
    ),
    "zeros": (lambda t: t["accessors"][0].pop("bufferView"), "its positions are sparse, which is not supported"),
    "normalized": (
        lambda t: t["accessors"][0].update(normalized=True, componentType=5122),
        "its positions are normalized integers, which are not supported",
    ),
    "draco": (
        lambda t: (t["meshes"][0]["primitives"][0].update(extensions=DRACO), t["accessors"][1].pop("bufferView")),
        "its indices are compressed by Draco (pip install DracoPy)",
    ),
    "meshopt": (
        lambda t: t["bufferViews"][0].update(extensions={"EXT_meshopt_compression": {}}),
        "its positions are compressed by meshopt, which is not supported",
    ),
    "required": (lambda t: t.update(extensionsRequired=["ACME_displace"]), "it requires ACME_displace, which is not"),
    "required, of any name": (
        lambda t: t.update(extensionsRequired=["\n/etc"]),
        "it requires an extension, which is not",
    ),
}


@pytest.mark.parametrize(("change", "message"), WRONG.values(), ids=WRONG)
def test_what_trimesh_reads_wrongly_is_refused(
    change: Callable[[dict[str, Any]], object], message: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lidarsim.io._gltf.find_spec", lambda _: None)  # nobody decodes Draco
    write(place, changed(change))
    for what, read in (("mesh", ls.TriangleMesh.from_file), ("scene", ls.Scene.from_file)):
        with pytest.raises(FileFormatError, match=f"^{re.escape(f'{place}: cannot be read as a {what}: {message}')}"):
            read(place)


def test_points_lines_and_harmless_extensions_are_no_obstacle(place: Path) -> None:
    tree = document([{"mesh": 0}], primitives=3)
    tree["extensionsRequired"] = ["KHR_texture_transform", "KHR_materials_unlit"]
    for mode in (0, 1):
        tree["meshes"][0]["primitives"][mode]["mode"] = mode
    assert len(ls.TriangleMesh.from_file(write(place, tree))) == 1


def test_indices_are_those_of_vertices(place: Path) -> None:
    write(place, document([{"mesh": 0}]), indices=(0, 1, 255))
    message = f"^{re.escape(str(place))}: faces: expected indices from 0 to 2, got faces\\[0\\]\\[2\\] = 255$"
    for read in (ls.TriangleMesh.from_file, ls.Scene.from_file):
        with pytest.raises(FileFormatError, match=message):
            read(place)


@pytest.mark.parametrize("cut", [8, 30, 200, -10])
def test_truncated_files(cut: int, tmp_path: Path) -> None:
    path = write(tmp_path / "a.glb", document([{"mesh": 0}]))
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(FileFormatError, match=r"a\.glb: cannot be read as a mesh: "):
        ls.TriangleMesh.from_file(path)


def test_vertices_of_mesh_files_are_not_merged(tmp_path: Path) -> None:
    path = tmp_path / "a.off"
    path.write_text("OFF\n4 2 0\n0 0 0\n4e-9 0 0\n0 1 0\n1 1 0\n3 0 1 2\n3 1 3 2\n", encoding="utf-8")
    (item,) = ls.Scene.from_file(path)
    assert item.name == "a.off"
    np.testing.assert_array_equal(item.shape.vertices, ls.TriangleMesh.from_file(path).vertices)  # type: ignore[attr-defined]
