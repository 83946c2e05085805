"""Groups along the ways of a street, of assets and of models in folders."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

import lidarsim as ls
from lidarsim.config.starter import STARTER
from lidarsim.datasets.recipe import Document, load
from lidarsim.datasets.scatter import Placed
from lidarsim.errors import ConfigError

SENSOR = {"pattern": {"type": "grid", "azimuths_deg": [0], "elevations_deg": [0], "rate_hz": 10}}
STREET = {"street": {"seed": 3, "length_m": 160.0}}
CARS: dict[str, Any] = {
    "objects": [{"shape": "vehicle", "kind": "hatchback"}, {"shape": "vehicle", "kind": "bicycle"}],
    "on": ["road"],
    "count": 6,
    "along": ["lanes", "turns"],
    "speed_m_per_s": 5,
    "gap_m": 2,
}
PEOPLE: dict[str, Any] = {
    "objects": [{"shape": "pedestrian"}],
    "on": [*ls.worlds.GROUND],
    "count": 5,
    "along": "crossings",
    "speed_m_per_s": 1.2,
}


def recipe(folder: Path, groups: dict[str, Any], *, scene: Any = STREET, **keys: Any) -> Path:
    run = {"sensor": SENSOR, "scene": scene, "pose": {"position_m": [0, 0, 30]}}
    path = folder / "recipe.yaml"
    path.write_text(yaml.safe_dump({"layout": "shards", "frames": 8, "scatter": groups, "run": run, **keys}))
    return path


def scene_and_objects(path: Path, sequence: int = 0) -> tuple[ls.Scene, list[Placed]]:
    source = load(path).source
    assert isinstance(source, Document)
    return source.run(sequence).scene, source.scatter(sequence)[0]


def test_traffic_follows_the_lanes_and_people_cross(tmp_path: Path) -> None:
    world = ls.worlds.street(3, length=160.0)
    scene, found = scene_and_objects(recipe(tmp_path, {"cars": CARS, "people": PEOPLE}))
    assert [item.group for item in found] == ["cars"] * 6 + ["people"] * 5
    assert len(scene) > len(world.scene)
    lines = {
        "cars": np.concatenate([*world.ways.lanes, *world.ways.turns]),
        "people": np.concatenate(world.ways.crossings),
    }
    for item in found:
        assert isinstance(item.motion, ls.Trajectory)
        for place in item.motion.at(item.motion.times).translation:
            assert np.linalg.norm(lines[item.group][:, :2] - place[:2], axis=1).min() < 0.6
        ahead = item.motion.at(item.motion.times[:2]).as_matrix()
        assert ahead[0, :3, 0] @ (ahead[1, :3, 3] - ahead[0, :3, 3]) > 0


def test_ways_that_are_too_short_for_a_sequence_have_no_room(tmp_path: Path) -> None:
    """Crossings are 15 to 30 m long: in 30 s, people would walk 36 m."""
    group = PEOPLE | {"along": ["crossings", "lanes"], "count": 9}
    source = load(recipe(tmp_path, {"people": group}, frames=300)).source
    tally = source.scatter_counts(0).groups["people"]
    assert 0 < tally.placed < tally.asked
    assert tally.refused["no room along the path"] == tally.asked - tally.placed


def test_a_vehicle_moves_along_with_its_sensor_and_is_not_in_its_way(tmp_path: Path) -> None:
    mast = {"shape": "cylinder", "name": "mast", "start_m": [0.5, 0, -0.2], "end_m": [0.5, 0, 0.2], "radius_m": 0.1}
    path = recipe(tmp_path, {"cars": CARS | {"clear_m": 1.0}}, scene=STREET | {"vehicle": [mast | {"label": 7}]})
    way = "run.pose={way: lanes, speed_m_per_s: 8, start_m: 20, position_m: [0, 0, 1.7], rotation_deg: {yaw: 90}}"
    source = load(path, [way]).source
    run = source.run(0)
    (found,) = (item for item in run.scene if item.name == "mast")
    assert found.label == 7
    assert found.motion is run.pose
    scan = run.scan(5)
    assert scan.object_id[0] == found.id
    assert scan.range[0] == pytest.approx(0.4, abs=1e-9)
    assert source.nearby(0) == {}
    standing = mast | {"position_m": run.pose.at(0.5).translation.tolist()}
    assert load(path, [way, f"run.scene.objects=[{standing}]"]).source.nearby(0).keys() == {"mast"}


def test_objects_of_a_vehicle_may_share_an_instance(tmp_path: Path) -> None:
    ball = {"shape": "sphere", "name": "ball", "center_m": [1, 0, 0], "radius_m": 0.1}
    body = {"shape": "vehicle", "kind": "van", "name": "van"}
    scene = STREET | {"vehicle": [ball | {"instance": 900}, body | {"instance": 900}, ball, body]}
    run = load(recipe(tmp_path, {}, scene=scene), ["run.pose={way: lanes, speed_m_per_s: 8}"]).source.run(0)
    (shared, alone), parts = run.scene.find("ball"), [item for item in run.scene if item.name.startswith("van/")]
    assert run.scene[shared].instance == 900
    assert run.scene[alone].instance == alone + 1
    assert {item.instance for item in parts if item.id < alone} == {900}
    assert {item.instance for item in parts if item.id > alone} == {alone + 2}


@pytest.mark.parametrize(
    ("vehicle", "pose", "message"),
    [
        ({}, {"position_m": [0, 0, 30]}, "vehicle: expected none, since the sensor does not move along one trajectory"),
        (
            {"motion": {"linear_m_per_s": [1, 0, 0]}},
            {"way": "lanes", "speed_m_per_s": 8},
            r"vehicle\.0\.motion: expected none, since the object moves along",
        ),
    ],
)
def test_a_vehicle_needs_a_trajectory_and_has_no_motion_of_its_own(
    tmp_path: Path, vehicle: dict[str, Any], pose: dict[str, Any], message: str
) -> None:
    ball = {"shape": "sphere", "center_m": [1, 0, 0], "radius_m": 0.1} | vehicle
    with pytest.raises(ConfigError, match=message):
        load(recipe(tmp_path, {}, scene=STREET | {"vehicle": [ball]}), [f"run.pose={pose}"])


def test_assets_without_a_seed_differ_from_object_to_object_and_from_sequence_to_sequence(tmp_path: Path) -> None:
    path = recipe(tmp_path, {"people": PEOPLE | {"count": 12}}, sequences=2)
    bodies = []
    for sequence in (0, 1):
        _, found = scene_and_objects(path, sequence)
        bodies.append({float(item.parts[0].part.shape.bounds[1, 2]) for item in found})
    assert 3 < len(bodies[0]) <= 8
    assert not bodies[0] & bodies[1]
    fixed = PEOPLE | {"objects": [{"shape": "pedestrian", "seed": 4, "posture": "walking"}]}
    _, found = scene_and_objects(recipe(tmp_path, {"people": fixed}))
    assert len({id(item.parts[0].part.shape) for item in found}) == 1


def test_weights_choose_among_the_objects(tmp_path: Path) -> None:
    _, found = scene_and_objects(recipe(tmp_path, {"cars": CARS | {"count": 12, "weights": [1, 1e9]}}))
    assert {item.index for item in found} == {1}


def test_a_street_without_junctions_has_no_turns(tmp_path: Path) -> None:
    kind = next(seed for seed in range(99) if not ls.worlds.street(seed, "rural", length=60.0).ways.turns)
    scene = {"street": {"seed": kind, "kind": "rural", "length_m": 60.0}}
    path = recipe(tmp_path, {"cars": CARS | {"along": "turns"}}, scene=scene)
    _, found = scene_and_objects(path)
    assert found == []
    assert load(path).source.scatter_counts(0).groups["cars"].asked == 6


def test_every_sequence_may_be_another_street(tmp_path: Path) -> None:
    path = recipe(tmp_path, {}, sequences=2, vary={"scene.street.seed": {"integer": [0, 1000]}})
    source = load(path).source
    assert isinstance(source, Document)
    first, second = (source.run(sequence).scene for sequence in (0, 1))
    assert len(first) != len(second)


def test_models_join_by_folder(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    for name in ("a.glb", "b.glb"):
        shutil.copy(STARTER / "scenes/car.glb", tmp_path / "models" / name)
    cars = CARS | {"objects": {"files": "models/*.glb", "label": "truck", "wheels": "wheel*"}, "count": 8}
    path = recipe(tmp_path, {"cars": cars})
    _, found = scene_and_objects(path)
    assert {item.index for item in found} == {0, 1}
    scene, _ = scene_and_objects(path)
    assert {item.label for item in scene if "wheel" in item.name and "hub" not in item.name} >= {18}
    files = load(path).source.files()
    assert {"models/a.glb", "models/b.glb"} <= set(files)
    (tmp_path / "models" / "c.glb").write_bytes(trimesh.Scene(trimesh.creation.box()).export(file_type="glb"))
    with pytest.raises(ConfigError, match=r"cars\.objects\.wheels: expected the name of a part, .* in 'models/c\.glb'"):
        scene_and_objects(path)


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (
            {"shape": "sphere", "center_m": [0, 0, 0], "radius_m": -1.0},
            "objects.1.radius_m: expected a finite number > 0, got -1.0",
        ),
        ({"files": "*.glb", "wheel": "no"}, "objects.1.wheel: unknown key; did you mean wheels?"),
        ({"files": "*.glb", "wheels": "no"}, "objects.1.wheels: expected the name of a part, of "),
    ],
)
def test_mistakes_beside_files_name_the_item_as_written(tmp_path: Path, second: object, message: str) -> None:
    for name in ("a.glb", "b.glb", "c.glb"):
        shutil.copy(STARTER / "scenes/car.glb", tmp_path / name)
    with pytest.raises(ConfigError) as caught:
        scene_and_objects(recipe(tmp_path, {"cars": CARS | {"objects": [{"files": "*.glb"}, second]}}))
    assert f": scatter.cars.{message}" in str(caught.value)
    assert "more)" not in str(caught.value)


@pytest.mark.parametrize(
    ("group", "scene", "message"),
    [
        (CARS | {"along": "rails"}, STREET, "expected 'lanes', 'turns', 'pavements' or 'crossings', got 'rails'"),
        (
            CARS | {"along_m": [[0, 0], [9, 0]]},
            STREET,
            "expected one of area_m, along_m and along, got along_m and along",
        ),
        (CARS, [{"shape": "plane", "normal": [0, 0, 1], "name": "road"}], "since the scene is not a street"),
        (
            CARS | {"objects": {"files": "none/*.glb"}},
            STREET,
            "expected 1 to 1000 files that match 'none/*.glb', got none",
        ),
        (
            CARS | {"weights": [1, 2, 3]},
            STREET,
            "weights: expected one for each of 2 objects and matches of files, got 3",
        ),
        (CARS | {"weights": [1, 0]}, STREET, "expected a value > 0"),
        *(
            (
                CARS | {"objects": {"files": pattern}},
                STREET,
                f"expected a pattern relative to this file, such as models/*.glb, got {pattern!r}",
            )
            for pattern in (3, "", "/models/*.glb")
        ),
        (
            CARS | {"objects": {"files": "*.yaml", "file": "a.glb"}},
            STREET,
            "objects.file: expected either file or files, got both",
        ),
        (
            CARS | {"objects": {"files": "*.yaml", "shape": "mesh"}},
            STREET,
            "objects.shape: expected none or scene_file beside files, got 'mesh'",
        ),
        (CARS | {"objects": {"files": "*.yaml", "label": "tank"}}, STREET, "got 'tank'"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, group: dict[str, Any], scene: Any, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        scene_and_objects(recipe(tmp_path, {"cars": group}, scene=scene))
    assert message in str(caught.value)
    assert "scatter.cars" in str(caught.value)
