"""Animations of glTF: nodes, skins and morph targets are where the specification's formulas have them."""

from __future__ import annotations

import copy
import itertools
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pygltflib
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

import lidarsim as ls
from lidarsim.errors import FileFormatError
from tests.io.scenes.gltf_files import CORNERS, Gltf

Floats = npt.NDArray[np.float64]

UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from y up to z up
TIMES = np.array([0.25, 0.75, 1.0, 2.0])


def channel(file: Gltf, node: int, path: str, values: npt.ArrayLike, interpolation: str = "LINEAR", **more: Any) -> Any:
    """A channel of a node, and its sampler."""
    times = more.pop("times", TIMES)
    sampler = {
        "input": file.numbers(np.reshape(times, (-1, 1))),
        "output": file.numbers(np.reshape(values, (-1, 1)) if path == "weights" else values, **more),
        "interpolation": interpolation,
    }
    return {"target": {"node": node, "path": path}}, sampler


def animate(file: Gltf, *parts: Any, **more: Any) -> None:
    channels = [{**made, "sampler": k} for k, (made, _) in enumerate(parts)]
    file.put("animations", {"channels": channels, "samplers": [sampler for _, sampler in parts], **more})


def quaternions(rng: np.random.Generator, count: int = len(TIMES)) -> Floats:
    return Rotation.random(count, rng=rng).as_quat()


def figure(rng: np.random.Generator) -> Gltf:
    """Nodes in line that move in all ways, a skin of two joints with five influences, and morph targets."""
    file = Gltf()
    vertices = rng.normal(size=(9, 3))
    faces = np.arange(9)
    targets = [{"POSITION": file.numbers(rng.normal(size=(9, 3)))} for _ in range(2)]
    influence = rng.random((9, 8))
    influence[:, 5:] = 0.0
    joints = rng.integers(0, 2, (9, 8))
    inverse = [np.eye(4), np.eye(4)]
    for matrix in inverse:
        matrix[:3] = rng.normal(size=(3, 4))
    file.put(
        "skins",
        {
            "joints": [1, 2],
            "inverseBindMatrices": file.numbers([matrix.T.ravel() for matrix in inverse]),
        },
    )
    sets = {
        f"{name}_{k}": file.numbers(values[:, 4 * k : 4 * k + 4], dtype)
        for k in range(2)
        for name, values, dtype in (("JOINTS", joints, "u1"), ("WEIGHTS", influence, "f4"))
    }
    rigid = file.mesh(file.primitive(vertices, faces))
    soft = file.mesh(file.primitive(vertices, faces, attributes=sets, targets=targets), weights=[0.5, 0.0])
    morphed = file.mesh(file.primitive(vertices, faces, targets=targets))
    file.node(name="root", children=[1], translation=[1, 2, 3])
    file.node(top=False, name="arm", children=[2, 3], mesh=rigid, rotation=[0, 0, 0, 1], scale=[1, 2, 1])
    file.node(top=False, name="hand", translation=[0, 1, 0], mesh=rigid)
    file.node(top=False, name="ring", mesh=rigid, matrix=[0, 2, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1])
    file.node(name="skin", mesh=soft, skin=0, translation=[100, 0, 0])
    file.node(name="face", mesh=morphed, scale=[3, 3, 3])
    file.node(name="rock", mesh=rigid)
    animate(
        file,
        channel(file, 0, "translation", rng.normal(size=(4, 3))),
        channel(file, 1, "rotation", quaternions(rng)),
        channel(file, 1, "scale", 0.5 + rng.random((4, 3)), "STEP"),
        channel(file, 2, "rotation", quaternions(rng, 12), "CUBICSPLINE"),
        channel(file, 2, "translation", rng.normal(size=(12, 3)), "CUBICSPLINE"),
        channel(file, 4, "weights", rng.random(8)),
        channel(file, 5, "weights", rng.normal(size=24), "CUBICSPLINE"),
        name="walk",
    )
    animate(file, channel(file, 2, "scale", [(0, 0, 0), (1, 1, 1)], times=[0, 4]))
    return file


def floats(file: pygltflib.GLTF2, index: int) -> Floats:
    """The numbers of an accessor, read by pygltflib's documents alone."""
    accessor = file.accessors[index]
    view = file.bufferViews[accessor.bufferView]
    dtype = {5121: "u1", 5123: "<u2", 5126: "<f4"}[accessor.componentType]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor.type]
    blob = file.binary_blob()[view.byteOffset + (accessor.byteOffset or 0) :]
    return np.frombuffer(blob, dtype, accessor.count * width).reshape(-1, width).astype(float)


def sample(times: Floats, values: Floats, interpolation: str, path: str, time: float) -> Floats:
    """The specification's value, by SciPy."""
    time = float(np.clip(time, times[0], times[-1]))
    if interpolation == "STEP":
        return values[np.flatnonzero(times <= time)[-1]]
    if interpolation == "CUBICSPLINE":
        entering, points, leaving = values.reshape(len(times), 3, -1).transpose(1, 0, 2)
        k = min(int(np.flatnonzero(times <= time)[-1]), len(times) - 2)
        pair = slice(k, k + 2)
        return CubicHermiteSpline(times[pair], points[pair], [leaving[k], entering[k + 1]])(time)
    if path == "rotation":
        return Slerp(times, Rotation.from_quat(values))(time).as_quat()
    return np.array([np.interp(time, times, column) for column in values.T])


def vertices_at(path: Path, animation: int, time: float) -> dict[str, Floats]:
    """The vertices of each node in the world, evaluated anew from what pygltflib reads."""
    file = pygltflib.GLTF2().load(str(path))
    nodes = copy.deepcopy(file.nodes)
    weights: dict[int, Floats] = {}
    played = file.animations[animation]
    for item in played.channels:
        sampler = played.samplers[item.sampler]
        times, values = floats(file, sampler.input)[:, 0], floats(file, sampler.output)
        if item.target.path == "weights":
            values = values.reshape(len(times) * (3 if sampler.interpolation == "CUBICSPLINE" else 1), -1)
        value = sample(times, values, sampler.interpolation, item.target.path, time)
        if item.target.path == "weights":
            weights[item.target.node] = value
        else:
            setattr(nodes[item.target.node], item.target.path, value)

    def local(node: pygltflib.Node) -> Floats:
        if node.matrix is not None:
            return np.reshape(node.matrix, (4, 4)).T
        parts = np.eye(4), np.eye(4), np.eye(4)
        parts[0][:3, 3] = node.translation if node.translation is not None else 0.0
        if node.rotation is not None:
            parts[1][:3, :3] = Rotation.from_quat(node.rotation).as_matrix()
        parts[2][:3, :3] *= node.scale if node.scale is not None else 1.0
        return parts[0] @ parts[1] @ parts[2]

    parents = {child: k for k, node in enumerate(nodes) for child in node.children or []}

    def place(k: int) -> Floats:
        return (place(parents[k]) if k in parents else np.eye(4)) @ local(nodes[k])

    found = {}
    for k, node in enumerate(nodes):
        if node.mesh is None:
            continue
        mesh = file.meshes[node.mesh]
        (primitive,) = mesh.primitives
        points = floats(file, primitive.attributes.POSITION)
        for number, target in enumerate(primitive.targets or []):
            rest = mesh.weights[number] if mesh.weights else 0.0
            points = points + (weights[k][number] if k in weights else rest) * floats(file, target["POSITION"])
        points = np.column_stack((points, np.ones(len(points))))
        if node.skin is None:
            world = points @ place(k).T
        else:
            skin = file.skins[node.skin]
            inverse = floats(file, skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
            maps = np.array([place(joint) for joint in skin.joints]) @ inverse
            names = [name for name in vars(primitive.attributes) if name.startswith("JOINTS_")]
            world, total = np.zeros((len(points), 4)), 0.0
            for name in filter(lambda name: getattr(primitive.attributes, name) is not None, names):
                joints = floats(file, getattr(primitive.attributes, name)).astype(int)
                share = floats(file, getattr(primitive.attributes, name.replace("JOINTS", "WEIGHTS")))
                total = total + share.sum(axis=1)
                world += np.einsum("vk,vkij,vj->vi", share, maps[joints], points)
            world /= np.reshape(total, (-1, 1))
        found[node.name] = world[:, :3] @ UP.T
    return found


def vertices_of(scene: ls.Scene) -> dict[str, Floats]:
    """The vertices of each object in the world."""
    found = {}
    for item in scene:
        assert isinstance(item.shape, ls.TriangleMesh)
        matrix = np.eye(4) if item.transform is None else item.transform
        found[item.name] = item.shape.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return found


@pytest.fixture(scope="module")
def walker(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return figure(np.random.default_rng(5)).save(tmp_path_factory.mktemp("figure") / "figure.glb")


@pytest.mark.parametrize("time", [-1.0, 0.25, 0.3, 0.74, 0.75, 0.9, 1.0, 1.7, 2.0, 9.0])
def test_nodes_skins_and_targets_are_where_an_independent_evaluation_has_them(walker: Path, time: float) -> None:
    scene = ls.Scene.from_file(walker)
    before = vertices_of(scene)
    scene.animate(time, animation="walk")
    found, right = vertices_of(scene), vertices_at(walker, 0, time)
    assert found.keys() == right.keys() == {"arm", "hand", "ring", "skin", "face", "rock"}
    for name, points in right.items():
        # Sums of products of at most some tens of float64 numbers below 10³, through five maps.
        np.testing.assert_allclose(found[name], points, rtol=0, atol=1e4 * np.finfo(float).eps, err_msg=name)
        assert (name == "rock") == np.array_equal(found[name], before[name])
    again = ls.Scene.from_file(walker, time=time)
    assert all(np.array_equal(points, found[name]) for name, points in vertices_of(again).items())


def test_casts_are_those_of_a_scene_made_anew_at_that_time(walker: Path) -> None:
    scene, rng = ls.Scene.from_file(walker), np.random.default_rng(6)
    for time in (0.4, 1.9):
        scene.animate(time)
        anew = ls.Scene()
        for item in scene:
            assert isinstance(item.shape, ls.TriangleMesh)
            anew.add(ls.TriangleMesh(item.shape.vertices, item.shape.faces), transform=item.transform)
        targets = np.concatenate(list(vertices_of(scene).values())).reshape(-1, 3, 3).mean(axis=1)
        origins = targets + 10.0 * rng.normal(size=targets.shape)
        found, right = (made.cast(origins, targets - origins) for made in (scene, anew))
        assert right.hit.all()
        for name in ("t", "object_id", "primitive_id", "normal"):
            np.testing.assert_array_equal(getattr(found, name), getattr(right, name))


def test_animations_are_listed_and_what_another_one_moved_returns(walker: Path) -> None:
    scene = ls.Scene.from_file(walker)
    rest = vertices_of(scene)
    assert dict(scene.animations) == {"walk": 2.0, "1": 4.0}
    scene.animate(1.0)
    assert not np.array_equal(vertices_of(scene)["arm"], rest["arm"])
    scene.animate(4.0, animation="1")
    np.testing.assert_array_equal(vertices_of(scene)["arm"], rest["arm"])
    scene.animate(0.0, animation="1")  # the hand has the size 0: nothing hits it
    (hand,) = scene.find("hand")
    assert scene[hand].transform is None
    assert np.ptp(vertices_of(scene)["hand"], axis=0).max() == 0.0
    scene.animate(2.0, animation="1")
    assert np.ptp(vertices_of(scene)["hand"], axis=0).max() > 0.0


def test_copies_pickles_and_changed_scenes_go_on_moving(walker: Path) -> None:
    scene = ls.Scene.from_file(walker)
    copies = [copy.copy(scene), pickle.loads(pickle.dumps(scene))]  # noqa: S301 - own pickle
    (arm,) = scene.find("arm")
    scene.remove(arm)
    scene.update(scene.find("hand")[0], label=7)
    ball = scene.add(ls.Sphere((0, 0, 0), 1.0), name="ball")
    for each in (scene, *copies):
        each.animate(0.6)
    assert scene[scene.find("hand")[0]].label == 7
    assert scene[ball].transform is None
    assert not scene.find("arm")
    first, second = map(vertices_of, copies)
    assert all(np.array_equal(points, second[name]) for name, points in first.items())
    np.testing.assert_allclose(first["arm"], vertices_at(walker, 0, 0.6)["arm"], rtol=0, atol=1e-12)


def test_nodes_that_start_with_no_size_appear(tmp_path: Path) -> None:
    file = Gltf()
    file.node(name="pop", mesh=file.mesh(), scale=[0, 0, 0])
    animate(file, channel(file, 0, "scale", [(0, 0, 0), (2, 2, 2)], times=[0, 1]))
    scene = ls.Scene.from_file(file.save(tmp_path / "pop.glb"), time=1.0)
    np.testing.assert_array_equal(vertices_of(scene)["pop"], 2.0 * CORNERS @ UP.T)


def test_copies_of_a_moving_node_move_along(tmp_path: Path) -> None:
    file = Gltf()
    shifts = np.array([[0, 0, 0], [5, 0, 0]])
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": file.numbers(shifts)}}}
    file.node(mesh=file.mesh(), extensions=instancing)
    animate(file, channel(file, 0, "translation", [(0, 0, 0), (0, 3, 0)], times=[0, 1]))
    scene = ls.Scene.from_file(file.save(tmp_path / "copies.glb"), time=1.0)
    places = [item.transform[:3, 3].tolist() for item in scene if item.transform is not None]
    assert places == [[0.0, 0.0, 3.0], [5.0, 0.0, 3.0]]


Change = Callable[[Gltf, dict[str, Any]], object]


def _output(values: npt.ArrayLike, dtype: str = "f4") -> Change:
    return lambda file, made: made["samplers"][0].update(output=file.numbers(values, dtype))


def _input(*times: float) -> Change:
    return lambda file, made: made["samplers"][0].update(input=file.numbers(np.reshape(times, (-1, 1))))


BAD: dict[str, tuple[Change, str]] = {
    "sampler": (lambda _, made: made["channels"][0].update(sampler=9), "channels[0].sampler: expected an index below"),
    "node": (lambda _, made: made["channels"][0]["target"].update(node=5), "target.node: expected an index below 1"),
    "kind": (_output([[1.0]] * 2), ".type: expected VEC3"),
    "count": (_output([[1.0, 2, 3]]), "samplers[0].output: expected 2 values, got 1"),
    "nan": (_output([[1.0, np.nan, 3]] * 2), "samplers[0].output[0]: expected finite numbers, got nan"),
    "times": (_input(1.0, 1.0), "samplers[0].input: expected ascending times, got 1.0 s after 1.0 s"),
    "nan time": (_input(1.0, np.nan), "samplers[0].input[1]: expected finite numbers, got nan"),
    "twice": (
        lambda _, made: made["channels"].append(made["channels"][0]),
        "channels[1]: expected one channel a property, got another of the translation of 0",
    ),
    "interpolation": (lambda _, made: made["samplers"][0].update(interpolation="LOG"), "interpolation: expected"),
    "negative": (lambda _, made: made["samplers"][0].update(input=-1), "input: expected greater than or equal to 0"),
    "matrix": (
        lambda file, _: file.tree["nodes"][0].update(matrix=np.eye(4).ravel().tolist()),
        "channels[0]: expected a node without a matrix, got nodes[0]",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_damaged_animations_are_refused_by_name(tmp_path: Path, name: str) -> None:
    change, message = BAD[name]
    file = Gltf()
    file.node(mesh=file.mesh())
    animate(file, channel(file, 0, "translation", [(0, 0, 0), (1, 0, 0)], times=[0, 1]))
    assert ls.Scene.from_file(file.save(tmp_path / "right.glb"), time=0.5)
    change(file, file.tree["animations"][0])
    with pytest.raises(FileFormatError) as error:
        ls.Scene.from_file(file.save(tmp_path / "wrong.glb"))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_zero_quaternions_and_wrong_numbers_of_weights_are_refused(tmp_path: Path) -> None:
    file = Gltf()
    file.node(mesh=file.mesh())
    animate(file, channel(file, 0, "rotation", [(0, 0, 0, 0)], times=[0]))
    with pytest.raises(FileFormatError, match="output: expected quaternions other than zero, got zero at key 0"):
        ls.Scene.from_file(file.save(tmp_path / "zero.glb"))
    file = Gltf()
    target = {"POSITION": file.numbers(CORNERS)}
    file.node(mesh=file.mesh(file.primitive(targets=[target])))
    animate(file, channel(file, 0, "weights", [0, 1, 2, 3], times=[0, 1]))
    with pytest.raises(FileFormatError, match="expected 2, one a weight, got 1"):
        ls.Scene.from_file(file.save(tmp_path / "weights.glb"))


def test_what_overflows_at_a_time_is_refused_then(tmp_path: Path) -> None:
    file = Gltf()
    parents = [file.node(top=k == 0, children=[k + 1]) for k in range(9)]
    file.node(top=False, mesh=file.mesh())
    huge = [(1, 1, 1), (3e38, 3e38, 3e38)]
    animate(file, *(channel(file, parent, "scale", huge, times=[0, 1]) for parent in parents))
    scene = ls.Scene.from_file(file.save(tmp_path / "huge.glb"))
    before = vertices_of(scene)
    with pytest.raises(FileFormatError, match=r"animation '0', nodes\[9\] at 1.0 s: expected a place within the range"):
        scene.animate(1.0)
    assert all(np.array_equal(points, before[name]) for name, points in vertices_of(scene).items())


def test_unknown_animations_and_times_that_are_none_are_refused(walker: Path) -> None:
    scene = ls.Scene.from_file(walker)
    with pytest.raises(ValueError, match="animation: expected one of walk, 1, got 'run'"):
        scene.animate(0.0, animation="run")
    with pytest.raises(TypeError, match="animation: expected the name of an animation"):
        scene.animate(0.0, animation=1)  # type: ignore[arg-type]
    for time in (np.nan, np.inf):
        with pytest.raises(ValueError, match="time: expected a finite number"):
            scene.animate(time)
    still = ls.Scene()
    assert not still.animations
    with pytest.raises(ValueError, match="animation: expected a scene from a glTF file with animations"):
        still.animate(0.0)


def test_the_many_ways_to_say_the_same_time_agree(walker: Path) -> None:
    made = [ls.Scene.from_file(walker, **options) for options in ({"time": 0.0}, {"animation": "walk"})]
    for first, second in itertools.pairwise(map(vertices_of, made)):
        assert all(np.array_equal(points, second[name]) for name, points in first.items())
