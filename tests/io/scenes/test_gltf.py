"""glTF: what is read is right, by the specification's formulas and by other readers; what cannot be read is refused."""

from __future__ import annotations

import dataclasses
import io
import logging
import re
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import DracoPy
import numpy as np
import numpy.typing as npt
import PIL.Image
import pygltflib
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.errors import FileFormatError, MissingExtraError
from lidarsim.io.scenes import _pictures
from tests.io.scenes.gltf_files import CODES, CORNERS, Gltf, one


@pytest.fixture(params=[".glb", ".gltf"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return tmp_path / f"a{request.param}"


def as_written(path: Path, **options: Any) -> ls.Scene:
    """The scene in the axes of the file."""
    return ls.Scene.from_file(path, up="z", **options)


def triangles(item: ls.SceneObject) -> npt.NDArray[np.float64]:
    """The corners of the triangles of an object in the scene, shape (n, 3, 3)."""
    assert isinstance(item.shape, ls.TriangleMesh)
    corners = item.shape.vertices[item.shape.faces]
    if item.transform is None:
        return corners
    return corners @ item.transform[:3, :3].T + item.transform[:3, 3]


def refusal(path: Path, **options: Any) -> str:
    with pytest.raises(FileFormatError) as caught:
        ls.Scene.from_file(path, **options)
    text = str(caught.value)
    start = f"{path}: cannot be read as a scene: "
    assert text.startswith(start)
    return text.removeprefix(start)


# Accessors


@pytest.mark.parametrize("dtype", CODES)
@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("stride", [None, 24])
def test_accessors(dtype: str, normalized: bool, stride: int | None, place: Path) -> None:
    rng = np.random.default_rng(1)
    given: Any
    if dtype == "f4":
        given, normalized = rng.normal(size=(5, 3)).astype("<f4"), False
    else:
        span = np.iinfo(dtype)
        given = rng.integers(span.min, span.max, (5, 3), endpoint=True).astype(f"<{dtype}")
        given[0] = span.min, span.max, 0
    row = given[0].nbytes if stride is None else stride
    data = b"".join(line.tobytes().ljust(row, b"\xa5") for line in given)
    file = Gltf()
    view = file.view(b"head" + data, **({} if stride is None else {"byteStride": stride}))
    accessor = {"bufferView": view, "byteOffset": 4, "componentType": CODES[dtype], "count": 5, "type": "VEC3"}
    number = file.put("accessors", accessor | {"normalized": normalized})
    file.node(mesh=file.mesh({"attributes": {"POSITION": number}, "indices": file.numbers([0, 1, 2, 2, 3, 4], "u1")}))
    (item,) = as_written(file.save(place))

    document = pygltflib.GLTF2().load(str(place))
    found = document.accessors[number]
    buffer = document.bufferViews[found.bufferView]
    blob = document.binary_blob() if place.suffix == ".glb" else place.with_suffix(".bin").read_bytes()
    formats = {5120: "b", 5121: "B", 5122: "<h", 5123: "<H", 5125: "<I", 5126: "<f"}
    expected = []
    for k in range(found.count):
        start = buffer.byteOffset + found.byteOffset + k * (buffer.byteStride or row)
        size = struct.calcsize(formats[found.componentType])
        values = [struct.unpack_from(formats[found.componentType], blob, start + j * size)[0] for j in range(3)]
        if normalized:
            values = [max(value / np.iinfo(dtype).max, -1.0) for value in values]
        expected.append(values)
    np.testing.assert_array_equal(item.shape.vertices, expected)  # type: ignore[attr-defined]


@pytest.mark.parametrize("base", [True, False])
@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_sparse_accessors(base: bool, dtype: str, place: Path) -> None:
    points = np.arange(12.0).reshape(4, 3) ** 2
    file = Gltf()
    number = file.numbers(points)
    if not base:
        del file.tree["accessors"][number]["bufferView"]
        points = np.zeros((4, 3))
    changed = [[7, 8, -9], [1, 2, 3]]
    file.tree["accessors"][number]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": file.view(np.array([1, 3], f"<{dtype}").tobytes()), "componentType": CODES[dtype]},
        "values": {"bufferView": file.view(np.array(changed, "<f4").tobytes())},
    }
    points[[1, 3]] = changed
    file.node(mesh=file.mesh({"attributes": {"POSITION": number}, "indices": file.numbers([0, 1, 2, 1, 2, 3], "u2")}))
    (item,) = as_written(file.save(place))
    np.testing.assert_array_equal(item.shape.vertices, points)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (4, [(0, 1, 2), (3, 4, 5)]),
        (5, [(0, 1, 2), (1, 3, 2), (2, 3, 4), (3, 5, 4)]),
        (6, [(1, 2, 0), (2, 3, 0), (3, 4, 0), (4, 5, 0)]),
    ],
)
@pytest.mark.parametrize("order", [None, (5, 3, 1, 0, 2, 4)])
def test_lists_strips_and_fans(
    mode: int, expected: list[tuple[int, ...]], order: tuple[int, ...] | None, place: Path
) -> None:
    """By the formulas of section 3.7.2.1 of the specification; the first corner of a triangle does not matter."""
    points = np.random.default_rng(2).integers(-9, 9, (6, 3))
    (item,) = as_written(one(lambda file: file.primitive(points, order, mode=mode)).save(place))
    corners = points if order is None else points[list(order)]

    def rotate(triangle: Any) -> Any:
        rows = [tuple(row) for row in np.asarray(triangle, float).tolist()]
        return min(rows[k:] + rows[:k] for k in range(3))

    assert [rotate(triangle) for triangle in triangles(item)] == [rotate(corners[list(face)]) for face in expected]


def test_points_and_lines_are_left_out(place: Path, caplog: pytest.LogCaptureFixture) -> None:
    modes = [{"mode": mode} for mode in (0, 1, 2, 3, 4)]
    file = one(*(lambda file, mode=mode: file.primitive(**mode) for mode in modes))
    with caplog.at_level(logging.WARNING, "lidarsim"):
        assert len(as_written(file.save(place))) == 1
        assert len(ls.TriangleMesh.from_file(place)) == 1
    assert caplog.messages == [f"{place}: left out: points and lines (4)"] * 2


def test_vertices_that_a_primitive_does_not_use_are_not_in_its_mesh(place: Path) -> None:
    points = np.arange(30.0).reshape(10, 3) ** 2
    (item,) = as_written(one(lambda file: file.primitive(points, (9, 2, 5))).save(place))
    np.testing.assert_array_equal(triangles(item), [points[[9, 2, 5]]])
    assert len(item.shape.vertices) == 3  # type: ignore[attr-defined]


# Nodes


def trees(rng: np.random.Generator) -> Gltf:
    """Nodes in a random tree, with random transforms of all kinds."""
    file = Gltf()
    mesh = file.mesh()
    for number in range(12):
        local: dict[str, Any] = {"name": f"n{number}", "mesh": mesh}
        turn = Rotation.random(rng=rng)
        move, scale = rng.normal(size=3).tolist(), rng.uniform(-2, 2, 3).tolist()
        if number % 2:
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = turn.as_matrix() * scale, move
            local["matrix"] = matrix.T.ravel().tolist()
        else:
            local |= {"translation": move, "rotation": turn.as_quat().tolist(), "scale": scale}
        parent = int(rng.integers(-1, number)) if number else -1
        file.node(top=parent < 0, **local)
        if parent >= 0:
            file.tree["nodes"][parent].setdefault("children", []).append(number)
    return file


@pytest.mark.parametrize("seed", range(5))
def test_nodes_are_where_trimesh_places_them(seed: int, place: Path) -> None:
    path = trees(np.random.default_rng(seed)).save(place)
    scene = as_written(path)
    graph = trimesh.load_scene(path).graph
    assert {item.name for item in scene} == set(graph.nodes_geometry)
    for item in scene:
        matrix = np.eye(4) if item.transform is None else item.transform
        # A chain of at most eight matrices, whose products are sums of four.
        near = 8 * 4 * ROUNDING * np.abs(matrix).max()
        np.testing.assert_allclose(matrix, graph[item.name][0], rtol=0, atol=near)
    upright = ls.Scene.from_file(path)
    for item, turned in zip(scene, upright, strict=True):
        x, y, z = np.moveaxis(triangles(item), -1, 0)
        np.testing.assert_array_equal(triangles(turned), np.stack([x, -z, y], -1))


def at(x: float) -> dict[str, Any]:
    return {"translation": [x, 0, 0]}


def shift(item: ls.SceneObject) -> float:
    return 0.0 if item.transform is None else float(item.transform[0, 3])


def test_instances_keep_names_and_order(place: Path) -> None:
    names = ["road", "car", "tree_1a2b3c", "7", "car", "world"]
    file = Gltf()
    mesh = file.mesh()
    for number, name in enumerate(names):
        file.node(name=name, mesh=mesh, **at(5.0 * number))
    file.node(mesh=mesh, **at(30.0))
    scene = ls.Scene.from_file(file.save(place))
    assert [item.name for item in scene] == [*names, "6"]
    assert [shift(item) for item in scene] == [0, 5, 10, 15, 20, 25, 30]
    assert len({id(item.shape) for item in scene}) == 1
    assert [item.instance for item in scene] == [1, 2, 3, 4, 5, 6, 7]
    mesh_of_all = ls.TriangleMesh.from_file(place)
    assert mesh_of_all.vertices[::3, 0].tolist() == [0, 5, 10, 15, 20, 25, 30]


def test_matrices_may_be_rounded_to_float32(place: Path) -> None:
    file = Gltf()
    file.node(mesh=file.mesh(), matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1.0000001])
    (item,) = as_written(file.save(place))
    assert item.transform is not None
    assert item.transform.tolist() == [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def test_nodes_come_before_what_is_below_them(place: Path) -> None:
    file = Gltf(cameras=[{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}])
    mesh = file.mesh(name="its mesh")
    file.node(name="a", mesh=mesh, children=[2, 1], **at(1))
    file.node(top=False, name="b", mesh=mesh, **at(1))
    file.node(top=False, name="c", mesh=mesh, camera=0, children=[3], **at(10))
    file.node(top=False, mesh=mesh, **at(100))
    file.node(name="e", mesh=mesh, skin=None, **at(0))
    del file.tree["nodes"][4]["skin"]
    scene = ls.Scene.from_file(file.save(place))
    assert [(item.name, shift(item), item.instance) for item in scene] == [
        ("a", 1, 1),
        ("c", 11, 1),
        ("its mesh", 111, 1),
        ("b", 2, 1),
        ("e", 0, 5),
    ]


def test_parts_of_a_node_have_its_name_and_instance(place: Path) -> None:
    file = Gltf()
    mesh = file.mesh(file.primitive(), file.primitive())
    file.node(name="car", mesh=mesh)
    file.node(name="bus", mesh=mesh, **at(5))
    file.save(place)
    for _ in range(2):
        found = [(item.name, item.instance) for item in ls.Scene.from_file(place)]
        assert found == [("car", 1), ("car", 1), ("bus", 3), ("bus", 3)]


def test_a_mirrored_instance_keeps_its_outside(place: Path) -> None:
    file = Gltf()
    mesh = file.mesh()
    file.node(mesh=mesh, scale=[-1, 1, 1])
    file.node(mesh=mesh, scale=[2, 2, 2])
    mesh_of_all = ls.TriangleMesh.from_file(file.save(place))
    hits = mesh_of_all.cast([[-0.2, -1, 0.2], [0.2, -1, 0.2]], [[0, 1, 0]] * 2)
    assert hits.normal.tolist() == [[0, -1, 0], [0, -1, 0]]
    assert mesh_of_all.vertices.tolist() == [[0, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, 0], [2, 0, 0], [0, 0, 2]]
    for item, x in zip(ls.Scene.from_file(place), (-0.2, 0.2), strict=True):
        alone = ls.Scene()
        alone.add(item.shape, transform=item.transform)
        assert alone.cast([[x, -1, 0.2]], [[0, 1, 0]]).normal.tolist() == [[0, -1, 0]]


@pytest.mark.parametrize("scale", [[0, 0, 0], [1, 0, 0], [0, 3, 0]])
def test_what_is_scaled_to_nothing_is_left_out(
    scale: list[float], place: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = Gltf()
    mesh = file.mesh()
    file.node(name="hidden", mesh=mesh, scale=scale, children=[2])
    file.node(name="car", mesh=mesh)
    file.node(top=False, mesh=mesh, **at(1))
    with caplog.at_level(logging.WARNING, "lidarsim"):
        assert [item.name for item in ls.Scene.from_file(file.save(place))] == ["car"]
    assert caplog.messages == [f"{place}: left out: objects scaled to nothing (2)"]
    file.tree["scenes"][0]["nodes"] = [0]
    assert refusal(file.save(place)) == "it holds no triangles; left out: objects scaled to nothing (2)"


def test_what_is_scaled_flat_is_flat(place: Path) -> None:
    box = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    file = one(lambda file: file.primitive(box, (0, 4, 2, 1, 5, 3)), scale=[1, 1, 0], translation=[0, 0, 7])
    (item,) = as_written(file.save(place))
    assert item.transform is None
    np.testing.assert_array_equal(item.shape.vertices, (box * [1, 1, 0] + [0, 0, 7])[:6])  # type: ignore[attr-defined]


def test_the_scene_is_the_default_else_the_first_else_all(place: Path) -> None:
    file = Gltf()
    mesh = file.mesh()
    for name in "abc":
        file.node(name=name, mesh=mesh)
    file.tree |= {"scene": 1, "scenes": [{"nodes": [2]}, {"nodes": [1, 0]}]}
    assert [item.name for item in ls.Scene.from_file(file.save(place))] == ["b", "a"]
    del file.tree["scene"]
    assert [item.name for item in ls.Scene.from_file(file.save(place))] == ["c"]
    del file.tree["scenes"]
    assert [item.name for item in ls.Scene.from_file(file.save(place))] == ["a", "b", "c"]


def test_hidden_nodes_are_left_out(place: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = Gltf(extensionsRequired=["KHR_node_visibility"])
    mesh = file.mesh()
    file.node(name="a", mesh=mesh, children=[1], extensions={"KHR_node_visibility": {"visible": False}})
    file.node(top=False, name="b", mesh=mesh)
    file.node(name="c", mesh=mesh)
    with caplog.at_level(logging.WARNING, "lidarsim"):
        assert [item.name for item in ls.Scene.from_file(file.save(place))] == ["c"]
    assert caplog.messages == [f"{place}: left out: hidden nodes (2)"]


def test_copies_of_gpu_instancing(place: Path) -> None:
    rng = np.random.default_rng(3)
    file = Gltf(extensionsRequired=["EXT_mesh_gpu_instancing"])
    turns = Rotation.random(4, rng=rng)
    quaternions = np.round(turns.as_quat() * 127).astype("i1")
    moves, scales = rng.normal(size=(4, 3)).astype("f4"), rng.uniform(0.5, 2, (4, 3)).astype("f4")
    attributes = {
        "TRANSLATION": file.numbers(moves),
        "ROTATION": file.numbers(quaternions, "i1", normalized=True),
        "SCALE": file.numbers(scales),
        "_ID": file.numbers([1, 2, 3, 4], "u2"),
    }
    file.node(
        name="trees", mesh=file.mesh(), extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}}, **at(5)
    )
    scene = as_written(file.save(place))
    assert [(item.name, item.instance) for item in scene] == [("trees", 1), ("trees", 2), ("trees", 3), ("trees", 4)]
    for k, item in enumerate(scene):
        turned = Rotation.from_quat(quaternions[k]).apply(CORNERS * scales[k].astype(float))
        near = 16 * ROUNDING * 8  # a quaternion, its matrix, a scale and sums of some metres
        np.testing.assert_allclose(triangles(item)[0], turned + moves[k].astype(float) + [5, 0, 0], rtol=0, atol=near)


def test_skins_are_at_rest(place: Path) -> None:
    """Each vertex is where the formula of section 3.7.3.3 puts it, computed one by one."""
    rng = np.random.default_rng(4)
    file = Gltf()
    points = rng.normal(size=(6, 3)).astype("f4")
    joints = rng.integers(0, 3, (2, 6, 4))
    weights = rng.integers(1, 255, (2, 6, 4))
    weights[0, :, 1] = 0
    joints[0, :, 1] = 77  # of no weight
    attributes = {
        "JOINTS_0": file.numbers(joints[0], "u1"),
        "WEIGHTS_0": file.numbers(weights[0], "u1", normalized=True),
        "JOINTS_1": file.numbers(joints[1], "u2"),
        "WEIGHTS_1": file.numbers(weights[1] / 255),
    }
    inverse = np.tile(np.eye(4), (3, 1, 1))
    inverse[:, :3] = rng.normal(size=(3, 3, 4))
    inverse = inverse.astype("f4")
    mesh = file.mesh(file.primitive(points, (0, 1, 2, 3, 4, 5), attributes=attributes))
    file.node(name="skinned", mesh=mesh, skin=0, scale=[0, 0, 0], translation=[100, 0, 0])
    file.node(name="root", translation=[1, 2, 3], children=[2])
    file.node(top=False, rotation=Rotation.random(rng=rng).as_quat().tolist(), children=[3])
    file.node(top=False, scale=[1, 2, -1])
    matrices = file.numbers(inverse.transpose(0, 2, 1).reshape(3, 16))
    file.put("skins", {"joints": [3, 1, 2], "inverseBindMatrices": matrices})
    (item,) = as_written(file.save(place))

    graph = trimesh.load_scene(path_without_skin(place)).graph
    world = [graph[name][0] for name in ("3", "root", "2")]
    expected = []
    for v in range(6):
        total, moved = 0.0, np.zeros(3)
        for s in range(2):
            for k in range(4):
                weight = weights[s, v, k] / 255 if s == 0 else float(np.float32(weights[s, v, k] / 255))
                if weight:
                    matrix = world[joints[s, v, k]] @ inverse[joints[s, v, k]].astype(float)
                    moved += weight * (matrix @ [*points[v].astype(float), 1.0])[:3]
                    total += weight
        expected.append(moved / total)
    # Three products of matrices, four weights and their sum, of some metres.
    near = (3 * 4 + 2 * 4) * ROUNDING * 8
    np.testing.assert_allclose(triangles(item).reshape(-1, 3), expected, rtol=0, atol=near)
    assert item.name == "skinned"


def path_without_skin(path: Path) -> Path:
    """The same nodes, each with a mesh, for trimesh, which knows only those."""
    document = pygltflib.GLTF2().load(str(path))
    file = Gltf()
    mesh = file.mesh()
    for k, node in enumerate(document.nodes):
        parts = {key: getattr(node, key) for key in ("translation", "rotation", "scale") if getattr(node, key)}
        file.node(top=k < 2, name=node.name or str(k), mesh=mesh, children=node.children or [], **parts)
    return file.save(path.with_name(f"other{path.suffix}"))


@pytest.mark.parametrize(
    ("of_mesh", "of_node", "expected"),
    [
        (None, None, [0.0, 0.0]),
        ([0.5, 0.25], None, [0.5, 0.25]),
        ([0.5, 0.25], [0.0, -1.0], [0.0, -1.0]),
        (None, [1.0, 1.0], [1.0, 1.0]),
    ],
)
def test_morph_targets(of_mesh: Any, of_node: Any, expected: list[float], place: Path) -> None:
    rng = np.random.default_rng(5)
    moves = rng.normal(size=(2, 3, 3)).astype("f4")
    file = Gltf()
    targets = [{"POSITION": file.numbers(moves[0])}, {"POSITION": file.numbers(moves[1]), "NORMAL": 0}]
    given = {"mesh": {"weights": of_mesh}, "node": {"weights": of_node}}
    given = {key: {k: v for k, v in value.items() if v is not None} for key, value in given.items()}
    file.node(mesh=file.mesh(file.primitive(targets=targets), **given["mesh"]), **given["node"])
    (item,) = as_written(file.save(place))
    np.testing.assert_allclose(
        triangles(item)[0], CORNERS + np.tensordot(expected, moves.astype(float), 1), rtol=0, atol=4 * ROUNDING * 3
    )


# Compression


def draco(file: Gltf, points: npt.NDArray[Any], faces: npt.NDArray[Any], **more: Any) -> dict[str, Any]:
    content = DracoPy.encode(points, faces, preserve_order=True, quantization_bits=14)
    extension = {"bufferView": file.view(content), "attributes": {"POSITION": 0}}
    positions = {"componentType": 5126, "count": len(points), "type": "VEC3"}
    indices = {"componentType": 5125, "count": faces.size, "type": "SCALAR"}
    return {
        "attributes": {"POSITION": file.put("accessors", positions)},
        "indices": file.put("accessors", indices),
        "extensions": {"KHR_draco_mesh_compression": extension},
        **more,
    }


def test_draco(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=2)
    points, faces = np.asarray(sphere.vertices, "f4"), np.asarray(sphere.faces)
    file = one(lambda file: draco(file, points, faces))
    file.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    (item,) = as_written(file.save(place))
    decoded = DracoPy.decode(DracoPy.encode(points, faces, preserve_order=True, quantization_bits=14))
    np.testing.assert_array_equal(triangles(item), decoded.points[decoded.faces].astype(float))
    np.testing.assert_allclose(triangles(item), points[faces], rtol=0, atol=2 / 2**14)

    monkeypatch.setitem(sys.modules, "DracoPy", None)
    message = f'{place}: KHR_draco_mesh_compression needs DracoPy: pip install "lidarsim[formats]"'
    for read in (ls.Scene.from_file, ls.TriangleMesh.from_file):
        with pytest.raises(MissingExtraError) as caught:
            read(place)
        assert str(caught.value) == message
    for accessor in file.tree["accessors"]:  # the same without compression beside it
        accessor["bufferView"] = file.view(
            points.tobytes() if accessor["type"] == "VEC3" else faces.astype("<u4").tobytes()
        )
    (item,) = as_written(file.save(place))
    np.testing.assert_array_equal(triangles(item), points[faces].astype(float))


def test_damaged_draco(place: Path) -> None:
    where = "meshes[0].primitives[0]"
    points, faces = CORNERS.astype("f4"), np.array([[0, 1, 2]])
    file = one(lambda file: draco(file, points, faces))
    file.tree["accessors"][0]["count"] = 4
    expected = f"{where}.attributes.POSITION: expected VEC3 of shape (4, 3) by Draco, got float32 of shape (3, 3)"
    assert refusal(file.save(place)) == expected
    file = one(lambda file: draco(file, points, faces))
    file.tree["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]["attributes"] = {}
    expected = f"{where}.attributes.POSITION: expected VEC3 of shape (3, 3) by Draco, got none"
    assert refusal(file.save(place)) == expected
    file = one(lambda file: draco(file, points, faces))
    file.blob[:] = bytes(len(file.blob))
    assert refusal(file.save(place)) == f"{where}.extensions.KHR_draco_mesh_compression: DracoPy cannot decode it"


def test_meshopt_is_refused_by_name_and_read_if_it_is_optional(place: Path) -> None:
    file = one()
    extension = {"EXT_meshopt_compression": {"buffer": 1, "byteLength": 9, "byteStride": 12, "count": 3}}
    for view in file.tree["bufferViews"]:
        view["extensions"] = extension
    assert len(as_written(file.save(place))) == 1  # the buffer is there as well
    file.tree["buffers"] = [{"byteLength": 44, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}]
    file.tree["extensionsRequired"] = ["EXT_meshopt_compression"]
    for view in file.tree["bufferViews"]:
        view["buffer"] = 1
    file.tree["buffers"].insert(0, {"byteLength": len(file.blob)})
    assert refusal(file.save(place)) == "bufferViews[0]: EXT_meshopt_compression is not supported"


# Files and versions


def test_buffers_in_uris(tmp_path: Path) -> None:
    file, path = one(), tmp_path / "a.gltf"
    (tmp_path / "sub dir").mkdir()
    (tmp_path / "sub dir" / "ä b.bin").write_bytes(file.data)
    quoted = "".join(f"%{byte:02x}" for byte in file.data)
    for uri in (file.data_uri(), f"data:,{quoted}", "sub%20dir/%C3%A4%20b.bin", "sub dir/ä b.bin"):
        (item,) = as_written(file.save(path, uri))
        np.testing.assert_array_equal(triangles(item), [CORNERS])


def test_the_byte_order_mark_and_extra_chunks_are_passed_over(tmp_path: Path) -> None:
    path = one().save(tmp_path / "a.gltf")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(as_written(path)) == 1
    path = one().save(tmp_path / "a.glb")
    data = path.read_bytes() + struct.pack("<I4s", 4, b"ELSE") + b"more"
    path.write_bytes(data[:8] + struct.pack("<I", len(data)) + data[12:] + b"behind the file")
    assert len(as_written(path)) == 1


@pytest.mark.parametrize("cut", [0, 3, 8, 19, 30, 200, -10, -1])
def test_truncated_files(cut: int, tmp_path: Path) -> None:
    path = one().save(tmp_path / "a.glb")
    path.write_bytes(path.read_bytes()[:cut])
    assert "truncated" in refusal(path) or cut < 4
    path = one().save(tmp_path / "b.gltf")
    path.with_suffix(".bin").write_bytes(path.with_suffix(".bin").read_bytes()[:-2])
    assert refusal(path) == "buffers[0]: truncated, 42 of 44 bytes"


def test_harmless_extensions_are_no_obstacle(place: Path) -> None:
    file = one()
    file.tree["extensionsRequired"] = ["KHR_texture_transform", "KHR_materials_unlit", "KHR_mesh_quantization"]
    assert len(as_written(file.save(place))) == 1


def file_with(edit: Callable[[dict[str, Any]], object]) -> Gltf:
    file = one(name="car")
    edit(file.tree)
    return file


def nodes(*children: list[int]) -> Callable[[dict[str, Any]], object]:
    def edit(tree: dict[str, Any]) -> None:
        tree["nodes"] = [{"mesh": 0, **({"children": below} if below else {})} for below in children]

    return edit


WRONG: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "required": (lambda t: t.update(extensionsRequired=["ACME_displace"]), "it requires ACME_displace, which is not"),
    "required, of any name": (lambda t: t.update(extensionsRequired=["\n/etc"]), "it requires an extension, which is"),
    "version 1": (lambda t: t["asset"].update(version="1.0"), "asset.version: expected glTF 2.0, got 1.0; convert it"),
    "version": (lambda t: t["asset"].update(version="\n3"), "asset.version: expected glTF 2.0, got another"),
    "least version": (lambda t: t["asset"].update(minVersion="2.1"), "asset.minVersion: expected glTF 2.0, got 2.1"),
    "no asset": (lambda t: t.pop("asset"), "asset: missing"),
    "type": (lambda t: t["nodes"][0].update(mesh="0"), "nodes[0].mesh: expected a valid integer"),
    "number": (lambda t: t["nodes"][0].update(mesh=1.5), "nodes[0].mesh: expected a valid integer"),
    "negative": (lambda t: t["nodes"][0].update(mesh=-1), "nodes[0].mesh: expected greater than or equal to 0"),
    "huge": (lambda t: t["nodes"][0].update(mesh=10**30), "nodes[0].mesh: expected less than or equal to"),
    "long name": (lambda t: t["nodes"][0].update(name="x" * 1001), "nodes[0].name: expected String should have at"),
    "infinite": (
        lambda t: t["nodes"][0].update(scale=[1, 1, float("inf")]),
        "nodes[0].scale[2]: expected a finite number",
    ),
    "mode": (lambda t: t["meshes"][0]["primitives"][0].update(mode=7), "meshes[0].primitives[0].mode: expected less"),
    "no primitives": (lambda t: t["meshes"][0].update(primitives=[]), "meshes[0].primitives: expected List should"),
    "component": (lambda t: t["accessors"][0].update(componentType=5124), "accessors[0].componentType: expected 5120"),
    "mesh": (lambda t: t["nodes"][0].update(mesh=1), "nodes[0].mesh: expected an index below 1, got 1"),
    "scene": (lambda t: t.update(scene=1), "scene: expected an index below 1, got 1"),
    "scene's node": (lambda t: t["scenes"][0].update(nodes=[1]), "scenes[0].nodes[0]: expected an index below 1"),
    "twice": (lambda t: t["scenes"][0].update(nodes=[0, 0]), "scenes[0].nodes: expected each node once"),
    "child": (nodes([3]), "nodes[0].children[0]: expected an index below 1, got 3"),
    "own child": (nodes([0]), "scenes[0].nodes[0]: expected a top node, got 0, which is below nodes[0]"),
    "two parents": (
        nodes([2], [2], []),
        "nodes[1].children[0]: expected a node with one parent, got 2, which is below nodes[0] too",
    ),
    "cycle": (nodes([], [2], [1]), "nodes[1]: expected a tree, got nodes that lie below themselves"),
    "deep": (
        nodes(*([k + 1] for k in range(1200)), []),
        "nodes[1000]: expected at most 1000 nodes in line, got more",
    ),
    "both": (
        lambda t: t["nodes"][0].update(matrix=np.eye(4).ravel().tolist(), scale=[1, 1, 1]),
        "nodes[0]: expected either a matrix or translation, rotation and scale, got both",
    ),
    "matrix": (
        lambda t: t["nodes"][0].update(matrix=[1.0] * 16),
        "nodes[0].matrix: expected (0, 0, 0, 1) as the last row, got [1.0, 1.0, 1.0, 1.0]",
    ),
    "matrix beside an affine one": (
        lambda t: t["nodes"][0].update(matrix=[*np.eye(4).ravel().tolist()[:15], 1.0000003]),
        "nodes[0].matrix: expected (0, 0, 0, 1) as the last row, got [0.0, 0.0, 0.0, 1.0000003]",
    ),
    "rotation": (
        lambda t: t["nodes"][0].update(rotation=[0, 0, 0, 0]),
        "nodes[0].rotation: expected quaternions other than zero, got zero at place 0",
    ),
    "beyond float64": (
        lambda t: t.update(
            nodes=[{"children": [1], "scale": [1e200] * 3}, {"name": "far", "mesh": 0, "scale": [1e200] * 3}]
        ),
        "node 'far': expected a place within the range of float64",
    ),
    "accessor": (
        lambda t: t["meshes"][0]["primitives"][0]["attributes"].update(POSITION=9),
        "meshes[0].primitives[0].attributes.POSITION: expected an index below 2, got 9",
    ),
    "vectors": (
        lambda t: t["accessors"][0].update(type="VEC2"),
        "accessors[0].type: expected VEC3 for meshes[0].primitives[0].attributes.POSITION, got VEC2",
    ),
    "indices": (
        lambda t: t["accessors"][1].update(componentType=5122),
        "accessors[1].componentType: 5122 is none of meshes[0].primitives[0].indices",
    ),
    "count": (lambda t: t["accessors"][0].update(count=10**9), "accessors[0]: expected bytes up to 12,000,000,000, go"),
    "zeros": (
        lambda t: (t["accessors"][0].update(count=10**9), t["accessors"][0].pop("bufferView")),
        "accessors[0].count: expected at most 4,194,304 without a buffer view",
    ),
    "offset": (lambda t: t["accessors"][0].update(byteOffset=1), "accessors[0]: expected bytes up to 37, got 36 in"),
    "stride": (
        lambda t: t["bufferViews"][0].update(byteStride=4),
        "accessors[0]: expected a byteStride of at least 12",
    ),
    "view": (lambda t: t["accessors"][0].update(bufferView=5), "accessors[0].bufferView: expected an index below 2"),
    "view's length": (
        lambda t: t["bufferViews"][1].update(byteLength=10**12),
        "bufferViews[1]: expected bytes up to 1,000,000,000,036, got 44 in buffers[0]",
    ),
    "buffer": (lambda t: t["bufferViews"][0].update(buffer=1), "bufferViews[0].buffer: expected an index below 1"),
    "buffer's length": (lambda t: t.update(buffers=[{"byteLength": 999}]), "buffers[0]: truncated, 44 of 999 bytes"),
    "few": (lambda t: t["accessors"][1].update(count=2), "meshes[0].primitives[0]: expected a multiple of three"),
    "few for a fan": (
        lambda t: (t["accessors"][1].update(count=2), t["meshes"][0]["primitives"][0].update(mode=6)),
        "meshes[0].primitives[0]: expected at least three vertices, got 2",
    ),
    "skin": (lambda t: t["nodes"][0].update(skin=0), "nodes[0].skin: expected an index below 0, got 0"),
    "joints": (
        lambda t: (t["nodes"][0].update(skin=0), t.update(skins=[{"joints": [7]}])),
        "skins[0].joints[0]: expected an index below 1, got 7",
    ),
    "no weights": (
        lambda t: (t["nodes"][0].update(skin=0), t.update(skins=[{"joints": [0]}])),
        "meshes[0].primitives[0].attributes: expected weights > 0, got a sum of 0.0 at vertex 0",
    ),
    "targets": (
        lambda t: (t["meshes"][0].update(weights=[1]), t["meshes"][0]["primitives"][0].update(targets=[{}, {}])),
        "meshes[0].primitives[0].targets: expected 1, one a weight, got 2",
    ),
    "copies": (
        lambda t: t["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {"attributes": {}}}),
        "nodes[0].extensions.EXT_mesh_gpu_instancing.attributes: expected attributes of one count, got []",
    ),
    "material": (
        lambda t: t["meshes"][0]["primitives"][0].update(material=0),
        "meshes[0].primitives[0].material: expected an index below 0, got 0",
    ),
    "sparse": (
        lambda t: t["accessors"][0].update(
            sparse={
                "count": 3,
                "indices": {"bufferView": 1, "componentType": 5123},
                "values": {"bufferView": 0},
            },
            count=2,
        ),
        "accessors[0].sparse.count: expected at most 2, got 3",
    ),
}


@pytest.mark.parametrize(("edit", "message"), WRONG.values(), ids=WRONG)
def test_errors_name_the_place(edit: Callable[[dict[str, Any]], object], message: str, tmp_path: Path) -> None:
    path = file_with(edit).save(tmp_path / "a.glb")
    told = refusal(path)
    assert told.startswith(message)
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: cannot be read as a mesh: {message}')}"):
        ls.TriangleMesh.from_file(path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_positions_are_finite(value: float, place: Path) -> None:
    points = CORNERS.astype(float)
    points[1, 2] = value
    file = one(lambda file: file.primitive(points))
    message = f"meshes[0].primitives[0].attributes.POSITION[1]: expected finite numbers, got {value}"
    assert refusal(file.save(place)) == message


def test_morphed_positions_are_finite(place: Path) -> None:
    file = Gltf()
    target = {"POSITION": file.numbers(np.full((3, 3), 1e30))}
    file.node(mesh=file.mesh(file.primitive(targets=[target]), weights=[1e300]))
    assert refusal(file.save(place)) == "vertices: expected finite numbers, got vertices[0][0] = inf"


def test_indices_are_those_of_vertices(place: Path) -> None:
    file = one(lambda file: file.primitive(indices=(0, 1, 255)))
    message = "meshes[0].primitives[0].indices[2]: expected an index below 3, got 255"
    assert refusal(file.save(place)) == message


def test_no_json_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.gltf"
    for content in (b"", b"{", b"hunter2", b"[]", b"\xff\xfe{", b"[" * 100_000):
        path.write_bytes(content)
        assert "hunter2" not in refusal(path)


# Colours

ROUNDING = 2.0**-53
"""Largest relative error of a float64 that is rounded once."""

REC_709 = np.array([0.2126, 0.7152, 0.0722])


def decode_srgb(value: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """IEC 61966-2-1."""
    encoded = np.asarray(value, float)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_colors_become_reflectivities_only_if_asked_for(place: Path) -> None:
    file = Gltf(materials=[{"name": "paint", "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.1, 0.2, 1]}}, {}])
    colors = np.array([[0, 0, 0, 255], [255, 0, 51, 0], [255, 255, 255, 255]])
    older = {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.1, 0.2, 0.3, 1]}}
    file.put("materials", {"extensions": older})
    attributes = {"COLOR_0": file.numbers(colors, "u1", normalized=True)}
    parts = [
        file.primitive(material=0),
        file.primitive(material=0, attributes=attributes),
        file.primitive(material=1),
        file.primitive(),
        file.primitive(material=2),
    ]
    file.node(mesh=file.mesh(*parts))
    file.save(place)
    assert {item.material.reflectivity for item in ls.Scene.from_file(place)} == {1.0}
    factor = np.array([0.8, 0.1, 0.2])
    found = [item.material for item in ls.Scene.from_file(place, reflectivity="color")]
    assert [material.per for material in found] == ["object", "vertex", "object", "object", "object"]
    assert found[0].reflectivity == pytest.approx(factor @ REC_709, rel=4 * ROUNDING)
    np.testing.assert_allclose(found[1].reflectivity, factor * colors[:, :3] / 255 @ REC_709, rtol=8 * ROUNDING)
    assert found[2].reflectivity == found[3].reflectivity == pytest.approx(1.0, rel=4 * ROUNDING)
    assert found[4].reflectivity == pytest.approx(np.array([0.1, 0.2, 0.3]) @ REC_709, rel=4 * ROUNDING)


def png(pixels: npt.NDArray[Any]) -> bytes:
    content = io.BytesIO()
    PIL.Image.fromarray(pixels.astype(np.uint8)).save(content, "PNG")
    return content.getvalue()


CORNERS_OF_SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])


def square_with_image(pixels: npt.NDArray[Any], info: dict[str, Any] | None = None, **attributes: Any) -> Gltf:
    """A square that shows an image upright, seen from +z in the axes of the file."""
    file = Gltf(
        materials=[
            {
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.5, 1, 1, 1],
                    "baseColorTexture": {"index": 0, **(info or {})},
                }
            }
        ]
    )
    file.put("images", {"bufferView": file.view(png(pixels)), "mimeType": "image/png"})
    file.put("textures", {"source": 0, "sampler": 0})
    file.put("samplers", {"wrapS": 33648, "wrapT": 33071})
    numbers = {name: file.numbers(values) for name, values in {"TEXCOORD_0": UV, **attributes}.items()}
    file.node(mesh=file.mesh(file.primitive(CORNERS_OF_SQUARE, (0, 1, 2, 0, 2, 3), attributes=numbers, material=0)))
    return file


def test_textures_become_textures_of_reflectivity(place: Path) -> None:
    pixels = np.random.default_rng(6).integers(0, 256, (3, 5, 3))
    path = square_with_image(pixels, COLOR_0=np.tile([1, 0.5, 1], (4, 1))).save(place)
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    texture = item.material.reflectivity
    assert isinstance(texture, ls.Texture)
    assert texture.wrap == ("mirror", "clamp")
    np.testing.assert_allclose(
        texture.values, decode_srgb(pixels / 255) * [0.5, 0.5, 1] @ REC_709, rtol=2.0**-24
    )  # float32
    np.testing.assert_array_equal(item.material.texture_coordinates, UV[[[0, 1, 2], [0, 2, 3]]])
    assert ls.Scene.from_file(path)[0].material.reflectivity == 1.0


@pytest.mark.parametrize(
    ("filters", "expected"),
    [
        ({"magFilter": 9728, "minFilter": 9728}, "nearest"),
        ({"magFilter": 9728, "minFilter": 9987}, "nearest"),
        ({"magFilter": 9728}, "nearest"),
        ({"minFilter": 9728}, "nearest"),
        ({"minFilter": 9986}, "nearest"),
        ({"magFilter": 9729, "minFilter": 9728}, "linear"),
        ({"minFilter": 9985}, "linear"),
        ({}, "linear"),
    ],
)
def test_textures_are_filtered_as_their_samplers_say(filters: dict[str, int], expected: str, place: Path) -> None:
    file = square_with_image(np.zeros((2, 2, 3)))
    file.tree["samplers"][0].update(filters)
    texture = ls.Scene.from_file(file.save(place), reflectivity="color")[0].material.reflectivity
    assert isinstance(texture, ls.Texture)
    assert texture.interpolation == expected


def test_a_scan_sees_a_texture_upright(place: Path) -> None:
    """White above black on the left, black above white on the right; the wall stands at y = 0 and faces −y."""
    image = np.array([[255, 0], [0, 255]])[:, :, None].repeat(3, axis=2).repeat(8, axis=0).repeat(8, axis=1)
    file = square_with_image(image)
    file.tree["materials"][0]["pbrMetallicRoughness"].pop("baseColorFactor")
    scene = ls.Scene.from_file(file.save(place), reflectivity="color")
    lidar = ls.Lidar(
        ls.patterns.Table([(0, 1, 0)] * 4, origins=[(x, -1, z) for z in (0.8, 0.2) for x in (0.2, 0.8)], rate=10.0)
    )
    scan = lidar.scan(scene, np.eye(4))
    assert scan.intensity.ravel().tolist() == [1, 0, 0, 1]


def test_texture_coordinates_are_transformed(place: Path) -> None:
    """By the matrices of KHR_texture_transform: translation times rotation times scale."""
    move, angle, scale = (0.25, -0.5), 0.3, (2.0, 0.5)
    transform = {"offset": move, "rotation": angle, "scale": scale, "texCoord": 1}
    other = np.random.default_rng(7).random((4, 2)).astype("f4")
    info = {"extensions": {"KHR_texture_transform": transform}}
    path = square_with_image(np.zeros((2, 2, 3)), info, TEXCOORD_1=other).save(place)
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.array([[1, 0, move[0]], [0, 1, move[1]], [0, 0, 1]])
    matrix = matrix @ [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]] @ np.diag([*scale, 1])
    expected = np.column_stack((other.astype(float), np.ones(4))) @ matrix.T
    found = item.material.texture_coordinates
    assert found is not None
    np.testing.assert_allclose(found, expected[[[0, 1, 2], [0, 2, 3]], :2], rtol=0, atol=16 * ROUNDING * 2)


@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp"])
def test_textures_under_vertex_colors_are_sampled(wrap: Any) -> None:
    """Against a plain loop over the four texels."""
    rng = np.random.default_rng(8)
    pixels = rng.integers(0, 256, (3, 4, 3))
    uv = np.concatenate([rng.uniform(-3, 3, (200, 2)), [[0, 0], [1, 1], [0.125, 0.5], [2, -1]]])
    picture = _pictures.Picture(lambda: png(pixels), (wrap, wrap))

    def texel(k: int, size: int) -> int:
        if wrap == "clamp":
            return min(max(k, 0), size - 1)
        if wrap == "repeat":
            return k % size
        return k % size if k // size % 2 == 0 else size - 1 - k % size

    expected = np.zeros((len(uv), 3))
    for n, (u, v) in enumerate(uv):
        x, y = u * 4 - 0.5, v * 3 - 0.5
        for i in (0, 1):
            for j in (0, 1):
                column, row = int(np.floor(x)) + i, int(np.floor(y)) + j
                weight = (1 - abs(x - column)) * (1 - abs(y - row))
                expected[n] += weight * decode_srgb(pixels[texel(row, 3), texel(column, 4)] / 255)
    # Places of texels up to 4, their weights, and the sum of four texels of at most 1.
    np.testing.assert_allclose(
        _pictures.Textures().sample(picture, uv), expected, rtol=0, atol=(2 * 4 + 2 * 4) * ROUNDING
    )
    nearest = _pictures.Textures().sample(dataclasses.replace(picture, interpolation="nearest"), uv[:200])
    places = [(texel(int(np.floor(v * 3)), 3), texel(int(np.floor(u * 4)), 4)) for u, v in uv[:200]]
    np.testing.assert_array_equal(nearest, [decode_srgb(pixels[place] / 255) for place in places])


def test_a_texture_under_colors_of_vertices(place: Path) -> None:
    colors = np.random.default_rng(9).random((4, 3)).astype("f4")
    path = square_with_image(np.full((2, 2, 3), 128), COLOR_0=colors).save(place)
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    expected = colors.astype(float) * [0.5, 1, 1] * decode_srgb(128 / 255) @ REC_709
    np.testing.assert_allclose(item.material.reflectivity, expected, rtol=8 * ROUNDING)


def test_images_are_checked_before_they_are_decoded(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = square_with_image(np.zeros((2, 2, 3)))
    monkeypatch.setattr(_pictures, "MOST_PIXELS", 3)
    message = "expected a texture of at most 3 pixels, got 2 × 2"
    assert refusal(file.save(place), reflectivity="color") == message
    monkeypatch.undo()
    view = file.tree["bufferViews"][file.tree["images"][0]["bufferView"]]
    file.blob[view["byteOffset"] + 45] ^= 255
    assert "a texture cannot be decoded as" in refusal(file.save(place), reflectivity="color")
    assert len(ls.Scene.from_file(place)) == 1
    file.tree["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    assert refusal(file.save(place), reflectivity="color") == "textures[0]: expected an image in PNG, JPEG or WebP"
    file.tree["textures"] = [{"extensions": {"EXT_texture_webp": {"source": 0}}}]
    file.tree["images"] = [{"uri": "../a.png"}]
    assert "images[0].uri: it names" in refusal(file.save(place), reflectivity="color")
    monkeypatch.setitem(sys.modules, "PIL.Image", None)
    with pytest.raises(MissingExtraError, match=r"reading textures needs PIL\.Image"):
        ls.Scene.from_file(square_with_image(np.zeros((2, 2, 3))).save(place), reflectivity="color")
