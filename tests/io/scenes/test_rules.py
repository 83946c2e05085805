"""Rules: which part each touches, what they change, and what is checked."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim import config
from lidarsim.errors import ConfigError
from tests.io.scenes.gltf_files import Gltf


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """Two cars of two materials each, each with a wheel, beside a road."""
    file = Gltf(materials=[{"name": "paint"}, {"name": "glass"}, {"name": "asphalt"}])
    car = file.mesh(file.primitive(material=0), file.primitive(material=1))
    wheel, road = file.mesh(), file.mesh(file.primitive(material=2))
    file.node(name="cars", children=[1, 2])
    file.node(top=False, name="car", mesh=car, children=[3])
    file.node(top=False, name="car", mesh=car, translation=[5, 0, 0], children=[4])
    file.node(top=False, name="wheel", mesh=wheel)
    file.node(top=False, name="wheel", mesh=wheel)
    file.node(name="road", mesh=road)
    return file.save(tmp_path / "town.glb")


def read_objects(path: Path, *rules: ls.Rule, **options: Any) -> list[tuple[str, int, int]]:
    return [(item.name, item.label, item.instance) for item in ls.Scene.from_file(path, rules=rules, **options)]  # type: ignore[misc]


def test_without_rules_a_top_node_is_an_instance(town: Path) -> None:
    cars = [("car", 0, 1), ("car", 0, 1), ("wheel", 0, 1)]
    assert read_objects(town) == [*cars, *cars, ("road", 0, 7)]


def test_the_first_rule_that_matches_decides(town: Path) -> None:
    rules = [
        ls.Rule(node="cars/*/wheel", label=3),
        ls.Rule(material="gl?ss", label=2),
        ls.Rule(node="cars/car*", label=1),
    ]
    labels = [label for _, label, _ in read_objects(town, *rules)]
    assert labels == [1, 2, 3, 1, 2, 3, 0]
    assert [label for _, label, _ in read_objects(town, *reversed(rules))] == [1, 1, 1, 1, 1, 1, 0]
    assert [label for _, label, _ in read_objects(town, ls.Rule(node="CARS*", label=1))] == [0] * 7
    assert [label for _, label, _ in read_objects(town, ls.Rule(), ls.Rule(label=1))] == [0] * 7


@pytest.mark.parametrize(
    ("instance", "expected"),
    [
        ("node", [1, 1, 3, 4, 4, 6, 7]),
        ("parent", [1, 1, 3, 1, 1, 6, 7]),
        ("file", [1, 1, 1, 1, 1, 1, 1]),
        (77, [77] * 7),
        (None, [1, 1, 1, 1, 1, 1, 7]),
    ],
)
def test_instances(instance: Any, expected: list[int], town: Path) -> None:
    assert [number for _, _, number in read_objects(town, ls.Rule(instance=instance))] == expected


def test_rules_skip_rename_and_give_materials(town: Path) -> None:
    rules = [
        ls.Rule(node="*/wheel", skip=True),
        ls.Rule(material="glass", name="window", reflectivity=0.05),
        ls.Rule(material="asphalt", reflectivity=ls.materials.ASPHALT),
        ls.Rule(material="paint", reflectivity="color"),
    ]
    scene = ls.Scene.from_file(town, rules=rules, reflectivity=0.5)
    assert [item.name for item in scene] == ["car", "window", "car", "window", "road"]
    assert [item.material.reflectivity for item in scene] == pytest.approx([1, 0.05, 1, 0.05, 0.17])
    assert scene[4].material == ls.materials.ASPHALT
    assert len(ls.Scene.from_file(town, rules=[ls.Rule(skip=True)])) == 0
    assert {item.material.reflectivity for item in ls.Scene.from_file(town, reflectivity=0.5)} == {0.5}


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"node": 1}, TypeError, "node: expected a pattern such as 'cars/*', got 1"),
        ({"material": None}, TypeError, "material: expected a pattern"),
        ({"label": -1}, ValueError, "label: expected an integer from 0 to 4294967295, got -1"),
        ({"label": "car"}, TypeError, "label: expected an integer"),
        ({"reflectivity": -1.0}, ValueError, "reflectivity: expected a finite number >= 0, got -1.0"),
        ({"reflectivity": "red"}, ValueError, "reflectivity: expected a number >= 0, a Material or 'color', got 'red'"),
        ({"instance": "mesh"}, ValueError, "instance: expected one of 'node', 'parent', 'file', or an integer"),
        ({"instance": -1}, ValueError, "instance: expected an integer"),
        ({"name": 7}, TypeError, "name: expected a string, got 7"),
        ({"skip": "yes"}, TypeError, "skip: expected True or False, got 'yes'"),
    ],
)
def test_wrong_rules(arguments: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message.replace("*", r"\*")):
        ls.Rule(**arguments)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"up": "x"}, ValueError, "up: expected 'y', 'z' or None, got 'x'"),
        ({"unit": 0}, ValueError, "unit: expected a finite number > 0, got 0"),
        ({"unit": "mm"}, TypeError, "unit: expected a finite number > 0, got 'mm'"),
        ({"rules": ls.Rule()}, TypeError, "rules: expected a sequence of Rule"),
        ({"rules": [ls.Rule(), "cars"]}, TypeError, r"rules: expected a sequence of Rule, got rules\[1\] = 'cars'"),
        ({"reflectivity": "colour"}, ValueError, "reflectivity: expected a number >= 0, a Material or 'color'"),
    ],
)
def test_wrong_options(options: dict[str, Any], error: type[Exception], message: str, town: Path) -> None:
    with pytest.raises(error, match=message):
        ls.Scene.from_file(town, **options)


def test_scenes_in_yaml_take_no_options(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("[]", encoding="utf-8")
    assert len(ls.Scene.from_file(path, rules=(), up=None)) == 0
    with pytest.raises(TypeError, match=r"unit: expected none, since lidarsim YAML has nothing as options, got 1\.0"):
        ls.Scene.from_file(path, unit=1)


def test_rules_are_values() -> None:
    rule = ls.Rule(node="a", reflectivity=ls.materials.GRASS, instance=np.int64(3), label=np.uint8(7))
    assert rule == copy.deepcopy(rule) == pickle.loads(pickle.dumps(rule))  # noqa: S301 - our own
    assert (rule.instance, rule.label) == (3, 7)
    assert rule != ls.Rule(node="a")


# In YAML

RUN = "sensor: {preset: velodyne-vlp16}\nscene:\n"


def test_rules_in_yaml(town: Path) -> None:
    rules = (
        "[{node: '*/wheel', skip: true}, {material: glass, reflectivity: 0.05, label: 2, instance: node}, "
        "{material: asphalt, reflectivity: asphalt}]"
    )
    ball = "  - {shape: sphere, center_m: [0, 0, 0], radius_m: 1}\n"
    keys = "name: town, label: 9, unit_m: 2, reflectivity: 0.5"
    file = f"  - {{shape: scene_file, file: town.glb, {keys}, rules: {rules}}}\n"
    path = town.with_name("run.yaml")
    path.write_text(f"{RUN}{ball}{file}{file}", encoding="utf-8")
    run = config.load(path)
    objects = list(run.scene)[1:]
    assert [item.name for item in objects] == ["town/car"] * 4 + ["town/road"] + ["town/car"] * 4 + ["town/road"]
    assert [item.label for item in objects[:5]] == [9, 2, 9, 2, 9]
    assert [item.material.reflectivity for item in objects[:5]] == [0.5, 0.05, 0.5, 0.05, 0.17]
    assert [item.instance for item in objects] == [2, 3, 2, 5, 6, 7, 8, 7, 10, 11]
    assert objects[2].transform is not None
    assert objects[2].transform[0, 3] == 10
    assert len(run.imports) == 1
    assert len({id(item.shape) for item in objects}) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("up: x", "scene.0.up: expected 'y' or 'z', got 'x'"),
        ("unit_m: -1", "scene.0.unit_m: expected a finite number > 0, got -1.0"),
        ("rules: [{label: 1}, {node: a, lable: 1}]", "scene.0.rules.1.lable: unknown key; did you mean label?"),
        ("rules: [{label: -1}]", "scene.0.rules.0.label: expected an integer from 0 to 4294967295, got -1"),
        ("rules: [{instance: mesh}]", "scene.0.rules.0.instance: expected 'node', 'parent' or 'file', got 'mesh'"),
        ("rules: [{reflectivity: asfalt}]", "scene.0.rules.0.reflectivity: expected the name of a material, got 'asf"),
        ("reflectivity: red", "scene.0.reflectivity: expected 'color', got 'red'"),
        *(
            (f"reflectivity: color, {key}: {value}", f"scene.0.reflectivity: expected a number beside {key}, got color")
            for key, value in {"material": "asphalt", "specular_width": 0.2, "grain_m": 0.1}.items()
        ),
    ],
)
def test_wrong_yaml(text: str, message: str, town: Path) -> None:
    path = town.with_name("run.yaml")
    path.write_text(f"{RUN}  - {{shape: scene_file, file: town.glb, {text}}}\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        config.load(path)
    assert message in str(caught.value)


@pytest.mark.filterwarnings("default")
def test_check_says_what_came_in(town: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from lidarsim.cli import main

    rules = "[{node: '*/wheel', skip: true}, {material: glass, label: 2}]"
    town.with_name("run.yaml").write_text(
        f"{RUN}  - {{shape: scene_file, file: town.glb, unit_m: 5000, rules: {rules}}}\n", encoding="utf-8"
    )
    with pytest.raises(SystemExit) as ended:
        main(["check", str(town.with_name("run.yaml"))])
    assert ended.value.code == 0
    printed, asked = capsys.readouterr()
    assert f"{town}: 5 objects, 2 instances, 5 triangles, 30,000 × 0 × 5,000 m\n" in printed
    assert "  materials: paint (2), glass (2), asphalt (1)\n" in printed
    assert "  labels: 2 (2)\n" in printed
    assert "  skipped by rules: 2 parts\n" in printed
    assert "  no rule matches 1 node: road\n" in printed
    assert asked == "lidarsim: warning: town.glb: 30,000 × 0 × 5,000 m; mm?\n"
