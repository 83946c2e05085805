"""Labels compare with class names, and are arrays in all else."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

import lidarsim as ls

NAMES = {1: "road", 2: "car", 9: "car"}
LABELS = np.array([1, 2, 2, 9, 7], np.uint32)
CARS = np.array([False, True, True, True, False])


def cloud(**more: Any) -> ls.PointCloud:
    return ls.PointCloud(xyz=np.zeros((5, 3)), label=LABELS, class_names=NAMES, **more)


def test_a_class_name_is_compared_with_every_label() -> None:
    label: Any = cloud().label
    for mask in (label == "car", label == np.str_("car"), "car" == label, ~(label != "car")):  # noqa: SIM300
        assert type(mask) is np.ndarray
        np.testing.assert_array_equal(mask, CARS)
    assert len(cloud()[label == "car"]) == 3
    assert not (cloud(ring=range(5))[:1].label == "car").any()  # known, though no point has it


def test_isin_takes_class_names() -> None:
    label: Any = cloud().label
    for names in (["car"], ("car",), {"car"}, "car", np.array(["car"])):
        np.testing.assert_array_equal(np.isin(label, names), CARS)
        np.testing.assert_array_equal(np.isin(label, names, invert=True), ~CARS)
    np.testing.assert_array_equal(np.isin(label, ["car", "road"]), [True, True, True, True, False])
    with pytest.raises(ValueError, match=r"^label: expected one of the class names road, car, got 'van'$"):
        np.isin(label, ["car", "van"])
    for compare in (label.__eq__, label.__ne__):
        for names in (["car", "road"], np.array(["car"] * 5), b"car"):
            with pytest.raises(TypeError, match=r"^label: expected one class name, got .*; np.isin\(label, names\)$"):
                compare(names)


def test_a_status_compares_with_its_names() -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((5, 0, 0), 1.0))
    status: Any = ls.Lidar(ls.patterns.Grid([0.0, 1.0, 2.0], [0.0], rate=10.0)).scan(scene).status
    assert (status == "hit").tolist() == [True, False, False]
    assert (status != "miss").tolist() == np.isin(status, ["hit", "dropped"]).tolist() == [True, False, False]
    with pytest.raises(ValueError, match=r"^status: expected one of the class names hit, miss, .*, got 'missed'$"):
        _ = status == "missed"


def test_scans_boxes_and_what_is_made_of_them_know_the_names() -> None:
    scene = ls.Scene(class_names={40: "road", 10: "car"})
    scene.add(ls.Plane((0, 0, 1), -1.8), label=40)
    scene.add(ls.Box((4, 2, 1.5), center=(8, 0, -1)), label=10, name="car")
    scan = ls.Lidar(ls.patterns.Grid(np.linspace(-0.3, 0.3, 20), np.linspace(-0.3, 0, 20), rate=10.0)).scan(scene)
    points, boxes = scan.point_cloud(), scan.boxes()
    for each in (scan.label, scan.single.label, points.label, points[::2].label, points.copy().label, boxes.label):
        cars = each == "car"
        assert cars.any()
        np.testing.assert_array_equal(cars, np.asarray(each) == 10)
    for each in (scan, points, boxes):
        for other in (copy.deepcopy(each), pickle.loads(pickle.dumps(each, protocol=5))):  # noqa: S301 - our own
            np.testing.assert_array_equal(other.label == "car", np.asarray(each.label) == 10)


def test_the_names_are_those_of_the_cloud() -> None:
    made = cloud()
    made.class_names = {7: "tree"}
    np.testing.assert_array_equal(made.label == "tree", LABELS == 7)
    made.label = [7, 7, 7, 7, 0]
    assert np.count_nonzero(made.label == "tree") == 4
    assert np.count_nonzero((cloud() + cloud()).label == "car") == 6


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (NAMES, "label: expected one of the class names road, car, got 'van'"),
        ({}, "label: expected a number, since there are no class names, got 'van'"),
    ],
)
def test_a_name_of_no_class_is_refused(names: dict[int, str], message: str) -> None:
    label = ls.PointCloud(xyz=[[0, 0, 0]], label=[1], class_names=names).label
    for compare in (label.__eq__, label.__ne__):
        with pytest.raises(ValueError, match=f"^{message}$"):
            compare("van")


def test_all_else_is_as_of_an_array() -> None:
    label = cloud().label
    assert isinstance(label, np.ndarray)
    assert label.dtype == np.uint32
    assert np.shares_memory(label, cloud().label) == np.shares_memory(LABELS, LABELS)  # given arrays are not copied
    for plain in (label == 2, label > 1, label + 1, np.asarray(label), np.isin(label, [2])):
        assert type(plain) is np.ndarray
    np.testing.assert_array_equal(label == np.array([1, 1, 2, 2, 7]), np.array([1, 1, 2, 2, 7]) == LABELS)
    np.testing.assert_array_equal(np.unique(label), [1, 2, 7, 9])
    np.testing.assert_array_equal(np.bincount(label), np.bincount(LABELS))
    assert type(label.max()) is np.uint32
    with pytest.raises(TypeError, match="unhashable"):
        hash(label)
    buffers: list[pickle.PickleBuffer] = []
    alone: Any = pickle.loads(pickle.dumps(label, protocol=5, buffer_callback=buffers.append), buffers=buffers)  # noqa: S301 - our own
    assert len(buffers) == 1  # out of band
    np.testing.assert_array_equal(alone == "car", CARS)
    own = np.array(LABELS)
    mine = ls.PointCloud(xyz=np.zeros((5, 3)), label=own).label
    mine[0] = 5
    assert own[0] == 5
