"""Names from other programs: the error says what lidarsim has instead."""

from __future__ import annotations

import copy
import inspect
import pickle
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim._base import names as _names

POSE = np.eye(4)
BOX = ls.Box((1, 1, 1))


def scene() -> ls.Scene:
    made = ls.Scene()
    made.add(ls.Plane((0, 0, 1), -1.0))
    return made


SCENE: Any = scene()
LIDAR: Any = ls.Lidar(ls.patterns.Grid([0.0], [-0.5], rate=10.0))
SCAN: Any = LIDAR.scan(SCENE)
CLOUD: Any = SCAN.point_cloud()
MESH: Any = ls.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
EXAMPLES: dict[str, Any] = {
    "lidarsim": ls,
    "Labels": CLOUD.label,
    "Boxes": SCAN.boxes(),
    "Hits": SCENE.cast([[0, 0, 0]], [[1, 0, 0]]),
    "TriangleMesh": MESH,
    "Shape": BOX,
    "SceneObject": SCENE[0],
    "Rig": ls.Rig({"top": (LIDAR, POSE)}),
    "PointCloud": CLOUD,
    "Scan": SCAN,
    "Scene": SCENE,
    "Lidar": LIDAR,
    "Trajectory": ls.Trajectory([0.0], [POSE]),
}
LS: Any = ls


@pytest.mark.parametrize("owner", _names._ATTRIBUTES)
def test_each_other_name_of_an_attribute_is_answered_and_free(owner: str) -> None:
    for right, wrong in _names._ATTRIBUTES[owner].items():
        for name in wrong.split():
            with pytest.raises(AttributeError) as caught:
                getattr(EXAMPLES[owner], name)
            assert f"use {right}" in str(caught.value)


@pytest.mark.parametrize("whose", _names._ARGUMENTS)
def test_each_other_name_of_an_argument_is_answered_and_free(whose: str) -> None:
    called: Any = {
        "Scene.add": SCENE.add,
        "Lidar.scan": LIDAR.scan,
        "Scan.point_cloud": SCAN.point_cloud,
        "Grid": ls.patterns.Grid,
        "Table": ls.patterns.Table,
        "Spinning": ls.patterns.Spinning,
    }.get(whose) or getattr(ls, whose)
    known = set(inspect.signature(called).parameters)
    for right, wrong in _names._ARGUMENTS[whose].items():
        for name in wrong.split():
            assert name not in known
            with pytest.raises(TypeError) as caught:
                called(**{name: 1})
            assert str(caught.value).startswith(f"{whose}: expected the arguments ")
            assert str(caught.value).endswith(f", got {name!r}; {right}")


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda: LS.Scene([BOX]), ("Scene: expected the arguments class_names, got too many positional arguments; "
                                  "scene.add(shape) adds an object, Scene.from_file(path) reads a file")),
        (lambda: SCENE.add("car.obj"), ("shape: expected a lidarsim shape, got str; "
                                       "TriangleMesh.from_file(path) reads a mesh")),
        (lambda: SCENE.add(BOX, label="car"), ("label: expected an integer from 0 to 4294967295, got 'car'; "
                                              "names of labels are the class_names of the scene")),
        (lambda: LS.Lidar("velodyne-vlp16"), ("pattern: expected a scan pattern (rate, shape, pulses), "
                                             "got 'velodyne-vlp16'; Lidar.preset(name) makes a sensor")),
        (lambda: LS.Trajectory([0, 1], [(0, 0, 0), (1, 0, 0)]),
         "poses: expected shape (2, 4, 4), one per time, got (2, 3); positions are poses[:, :3, 3]"),
        (lambda: LS.patterns.Table([[0, 0], [1, 0]], rate=10.0),
         ("directions: expected shape (n, 3), got (2, 2); "
         "of azimuth a and elevation e: [cos e · cos a, cos e · sin a, sin e]")),
        (lambda: LS.patterns.Table([[1, 0, 0]]),
         ("Table: expected the arguments directions, times, rings, columns, origins, rate, "
         "got missing a required argument: 'rate'")),
        (lambda: LS.Plane(normal=(0, 0, 1)),
         "Plane: expected the arguments normal, distance, transform, got missing a required argument: 'distance'"),
        (lambda: LS.Spinning, "module 'lidarsim' has no attribute 'Spinning'; it is lidarsim.patterns.Spinning"),
        (lambda: LS.Pointcloud, "module 'lidarsim' has no attribute 'Pointcloud'; did you mean PointCloud?"),
        (lambda: LS.PointCloud.read, "type object 'PointCloud' has no attribute 'read'; use PointCloud.load(path)"),
        (lambda: LS.Scene.from_fle, "type object 'Scene' has no attribute 'from_fle'; did you mean from_file?"),
        (lambda: LS.Rig.__nothing__, "type object 'Rig' has no attribute '__nothing__'"),
        (lambda: BOX.position, "'Box' object has no attribute 'position'; use scene.add(shape, transform=…)"),
        (lambda: LS.Material("asphalt"), ("Material: expected the arguments reflectivity, per, texture_coordinates, "
                                          "roughness, specular, specular_width, transmission, mirror, variation, "
                                          "grain, got too many positional arguments; lidarsim.materials has "
                                          "those of the library, as materials.ASPHALT")),
        (lambda: CLOUD["x"], "index: expected indices, a mask or a slice, got 'x'; use cloud.xyz[:, 0]"),
        (lambda: CLOUD["label"], "index: expected indices, a mask or a slice, got 'label'; a field is cloud.label"),
        (lambda: SCAN.ranges, "'Scan' object has no attribute 'ranges'; did you mean range?"),
        (lambda: SCAN.nonsense, "'Scan' object has no attribute 'nonsense'"),
        (lambda: SCENE.__array_interface__, "'Scene' object has no attribute '__array_interface__'"),
    ],
)  # fmt: skip
def test_mistakes(mistake: Any, message: str) -> None:
    with pytest.raises((AttributeError, TypeError, ValueError)) as caught:
        mistake()
    assert str(caught.value) == message


def test_errors_from_within_are_not_taken_for_mistakes_in_names() -> None:
    @_names.explain_arguments
    def fail(_: object, number: int) -> int:
        return len(number)  # type: ignore[arg-type]

    with pytest.raises(TypeError, match=r"^object of type 'int' has no len\(\)$"):
        fail(None, 1)


def test_an_error_within_a_property_is_shown_as_it_is() -> None:
    class Broken(ls.Scene):
        @property
        def middle(self) -> float:
            return self.bounds.centre  # type: ignore[attr-defined, no-any-return]

    with pytest.raises(AttributeError, match=r"^'numpy.ndarray' object has no attribute 'centre'"):
        _ = Broken().middle


def test_copies_and_pickles_ask_for_nothing_that_is_missing() -> None:
    for value in (SCENE, SCAN, CLOUD, LIDAR, EXAMPLES["Trajectory"]):
        assert type(pickle.loads(pickle.dumps(value))) is type(copy.deepcopy(value)) is type(value)  # noqa: S301 - our own


def test_a_scene_knows_its_objects_by_id_and_name() -> None:
    made = ls.Scene()
    number = made.add(BOX, name="car")
    assert number in made
    assert "car" in made
    assert made[number] in made
    assert not {7, "bus", BOX} & {item for item in (7, "bus", BOX) if item in made}


def test_sum_adds_clouds() -> None:
    np.testing.assert_array_equal(sum([CLOUD, CLOUD, CLOUD]).xyz, np.vstack([CLOUD.xyz] * 3))
    with pytest.raises(TypeError):
        _ = 1 + CLOUD
