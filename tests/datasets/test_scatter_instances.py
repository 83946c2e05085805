"""Scattered instances of several parts, along curves, over slopes, at changing speeds: by brute force and by hand."""

from __future__ import annotations

import dataclasses
import functools
import re
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import trimesh
import yaml
from scipy.spatial import ConvexHull

import lidarsim as ls
from lidarsim.config.document import Place
from lidarsim.datasets.draws import Stream
from lidarsim.datasets.recipe import Document, load
from lidarsim.datasets.scatter import Placed
from lidarsim.datasets.scatter._instances import instance_of
from lidarsim.datasets.scatter._outlines import Outline
from lidarsim.datasets.scatter._ways import Way
from lidarsim.errors import ConfigError

Floats = npt.NDArray[np.float64]
CONFIGS = Path(__file__).parents[2] / "configs"
WHEELS = [
    {"shape": "cylinder", "name": f"wheel {x}", "start_m": [x, y - 0.1, 0.3], "end_m": [x, y + 0.1, 0.3],
     "radius_m": 0.3, "label": 1}
    for x in (-1.2, 1.2) for y in (-0.75, 0.75)
]  # fmt: skip
BODY = {"shape": "box", "size_m": [4, 1.7, 1.2], "center_m": [0, 0, 0.8], "label": 1}
CART = {"shape": "compound", "parts": [*WHEELS, BODY], "wheels": "wheel*"}
WALKER = {"shape": "walker", "label": 2}
FLOOR = {"shape": "plane", "normal": [0, 0, 1], "name": "floor"}
HILL = {"shape": "plane", "normal": [-0.2, 0.1, 1], "name": "hill"}
SENSOR = {"pattern": {"type": "grid", "azimuths_deg": [0], "elevations_deg": [0], "rate_hz": 10}}


def recipe(folder: Path, frames: int = 40, ground: dict[str, Any] = FLOOR, **groups: dict[str, Any]) -> Path:
    groups = {name: {"on": [ground["name"]]} | group for name, group in groups.items()}
    run = {"sensor": SENSOR, "scene": [ground], "pose": {"position_m": [0, 0, 2]}}
    path = folder / "recipe.yaml"
    path.write_text(
        yaml.safe_dump({"layout": "shards", "sequences": 9, "frames": frames, "scatter": groups, "run": run})
    )
    return path


def scene_and_objects(path: Path, sequence: int = 0) -> tuple[ls.Scene, list[Placed]]:
    source = load(path).source
    assert isinstance(source, Document)
    run = source.run(sequence)
    return run.scene, source.scatter(sequence)[0]


def instances(scene: ls.Scene) -> list[list[ls.scene.SceneObject]]:
    """The scattered objects, by instance."""
    items = list(scene)[1:]
    return [[item for item in items if item.instance == number] for number in dict.fromkeys(i.instance for i in items)]


def pose(item: ls.scene.SceneObject, time: float) -> Floats:
    """From the shape of an object to the world."""
    inner = np.eye(4) if item.transform is None else item.transform
    return inner if item.motion is None else item.motion.at(time).as_matrix() @ inner


def plan(parts: list[ls.scene.SceneObject], time: float) -> Floats:
    """Points of the parts' surfaces at a time."""
    return np.concatenate([surface(item, time) for item in parts])[:, :2]


def surface(item: ls.scene.SceneObject, time: float) -> Floats:
    """Points of an object's surface at a time, among them those of its convex hull."""
    place = pose(item, time)
    return vertices(item.shape) @ place[:3, :3].T + place[:3, 3]


@functools.cache
def vertices(shape: ls.Shape) -> Floats:
    found: Floats = shape._tessellate(None, np.zeros((8, 3)))[0]
    return found[ConvexHull(found).vertices]


# Assets of worlds


def test_the_wheels_of_a_vehicle_turn_and_the_limbs_of_pedestrians_swing(tmp_path: Path) -> None:
    groups: dict[str, dict[str, Any]] = {
        "cars": {
            "objects": [{"shape": "vehicle", "kind": "estate"}],
            "along_m": [[-90, 0], [90, 0]],
            "speed_m_per_s": 8,
        },
        "people": {
            "objects": [{"shape": "pedestrian", "load": "child", "posture": "walking"}],
            "along_m": [[-20, 9], [20, 9]],
            "speed_m_per_s": 1.3,
        },
    }
    scene, found = scene_and_objects(
        recipe(tmp_path, frames=10, cars={"count": 1} | groups["cars"], people={"count": 1} | groups["people"])
    )
    assert len(found) == 2
    car, people = instances(scene)
    assert {item.name.split(" ")[0] for item in car} >= {"body", "wheel"}
    turned = {item.name: pose(item, 0.5)[:3, :3] for item in car}
    assert all(np.allclose(turn, np.eye(3)) for name, turn in turned.items() if not name.startswith("wheel"))
    assert not any(np.allclose(turn, np.eye(3)) for name, turn in turned.items() if name.startswith("wheel"))
    limbs = [item for item in people if item.name == "left shank"]
    assert len(limbs) == 2
    angles = [[pose(item, time)[2, 0] for time in (0.1, 0.3, 0.5)] for item in limbs]
    assert np.ptp(angles, axis=1).min() > 0.05
    assert max(abs(surface(item, 0.5)[:, 2].min()) for item in limbs) < 0.6


def test_someone_who_sits_keeps_the_posture(tmp_path: Path) -> None:
    instance = {"shape": "pedestrian", "posture": "sitting", "seed": 3}
    people = {"objects": [instance], "count": 1, "area_m": [[-5, -5], [5, 5]]}
    scene, _ = scene_and_objects(recipe(tmp_path, frames=2, people=people))
    heights = np.concatenate([surface(item, 0.0) for item in instances(scene)[0]])[:, 2]
    assert heights.min() == pytest.approx(0.0, abs=0.02)
    assert heights.max() < 1.5


# Walking


@pytest.mark.parametrize("speed", [0.3, 0.9, 1.4, 2.2])
def test_a_walker_takes_strides_of_its_speed(tmp_path: Path, speed: float) -> None:
    group = {"objects": [WALKER], "count": 1, "area_m": [[-1, -1], [1, 1]], "speed_m_per_s": speed}
    ((*parts,),) = instances(scene_and_objects(recipe(tmp_path, people=group))[0])
    hip = 0.53 * 1.75
    cycle = 1.346 * np.sqrt(speed / hip) * hip / speed  # Boulic et al., in their words: RLc = 1.346 √RV
    times = np.linspace(0.0, 4.0, 401)
    torso, *limbs = parts
    assert torso.motion is not None
    for limb in limbs[1:]:
        assert limb.motion is not None
        own = (torso.motion.at(times).inv() * limb.motion.at(times)).as_matrix()
        swing = np.unwrap(np.arctan2(own[:, 0, 2], own[:, 0, 0]))
        half = np.interp(times + cycle / 2, times, swing) - swing
        whole = np.interp(times + cycle, times, swing) - swing
        within = times < 4.0 - cycle
        # Linear interpolation between poses 25 ms apart is off by as much as the swing bends there.
        assert np.abs(whole[within]).max() <= 0.02 + 0.12 * np.ptp(swing) * (0.025 / cycle) ** 2 * 4 * np.pi**2
        assert np.abs(half[within]).max() >= 0.5 * np.ptp(swing)
        assert np.ptp(swing) >= np.radians(3)
        if limb is limbs[1]:  # a thigh: 50 r° + 30 r° up to r = 0.5, then 25° + 15°, at r = 3 31° + 15°
            r = speed / hip
            assert np.degrees(np.ptp(swing)) == pytest.approx(
                80 * r if r < 0.5 else 40 + max(0, 6 * (r - 1.3) / 1.7), rel=0.05
            )


@pytest.mark.parametrize("speed", [0.0, 1.4, 2.2])
def test_limbs_hold_together_and_a_foot_is_on_the_ground(tmp_path: Path, speed: float) -> None:
    group = {"objects": [WALKER], "count": 1, "area_m": [[-1, -1], [1, 1]], "speed_m_per_s": speed, "yaw_deg": 30}
    ((_, _, *parts),) = instances(scene_and_objects(recipe(tmp_path, people=group))[0])
    thigh, shank = 0.245 * 1.75, 0.246 * 1.75
    standing = []
    for time in np.linspace(0, 4, 161):
        for upper, lower, length in ((0, 1, thigh), (1, 2, shank), (5, 6, thigh), (6, 7, shank)):
            end = pose(parts[upper], time) @ (0, 0, -length, 1)
            # Both ends are off by the bulge of an arc that turns by at most 12° from one pose to the next.
            assert np.linalg.norm(end - pose(parts[lower], time)[:, 3]) <= 2 * length * (1 - np.cos(np.radians(6)))
        low = [item.shape._extent(pose(item, time)[:3])[0, 2] for item in (parts[2], parts[7])]
        assert abs(min(low)) <= 0.01
        standing.append(int(np.argmin(low)))
    assert set(standing) == ({0, 1} if speed else set(standing))


def test_the_foot_on_the_ground_stays(tmp_path: Path) -> None:
    """In the middle of a stance, the ankle goes at less than a third of the walker's speed; in swing, much faster."""
    group = {"objects": [WALKER], "count": 1, "area_m": [[-1, -1], [1, 1]], "speed_m_per_s": 1.4}
    ((_, _, *parts),) = instances(scene_and_objects(recipe(tmp_path, people=group))[0])
    times = np.linspace(0, 4, 401)
    for foot in (2, 7):
        x = np.array([pose(parts[foot], time)[0, 3] for time in times])
        speeds = np.diff(x) / 0.01
        assert np.mean(speeds < 0.3 * 1.4) >= 0.3
        assert 2.5 * 1.4 <= speeds.max() <= 4 * 1.4
        assert abs(speeds.mean() - 1.4) <= 0.4


def test_a_walker_that_stops_stands(tmp_path: Path) -> None:
    speeds = [[0.5, 1.4], [1.5, 0], [3, 0], [4, 1.4]]
    group = {"objects": [WALKER], "count": 1, "area_m": [[-1, -1], [1, 1]], "speed_m_per_s": speeds}
    ((*parts,),) = instances(scene_and_objects(recipe(tmp_path, people=group))[0])
    for item in parts:
        assert item.motion is not None
        still = item.motion.at(np.linspace(1.6, 2.9, 20)).as_matrix()
        np.testing.assert_allclose(still, np.broadcast_to(still[0], still.shape), rtol=0, atol=2.0**-44)
        way = np.diff(item.motion.at(np.linspace(0, 4, 161)).translation, axis=0)
        assert np.linalg.norm(way, axis=1).max() <= 0.025 * 4.5 * 1.4  # no jump: at most what a foot swings


# Wheels


def spin(item: ls.scene.SceneObject, body: ls.scene.SceneObject, times: Floats) -> Floats:
    assert item.motion is not None
    assert body.motion is not None
    own = (body.motion.at(times).inv() * item.motion.at(times)).as_matrix()
    return np.unwrap(np.arctan2(own[:, 0, 2], own[:, 0, 0]))


@pytest.mark.parametrize("speed", [5.0, 30.0, [[0, 9], [2, 0], [3, 0], [4, 12]]])
def test_wheels_roll(tmp_path: Path, speed: Any) -> None:
    """A wheel of radius 0.3 m turns by the way over the radius; the point on the ground rests."""
    group = {"objects": [CART], "count": 2, "along_m": [[-200, 3], [200, 3]], "speed_m_per_s": speed, "scale": 0.9}
    scene, _ = scene_and_objects(recipe(tmp_path, carts=group))
    assert len(instances(scene)) == 2
    for body, *wheels in instances(scene):
        assert body.motion is not None
        times = np.linspace(0, 4, 41)
        way = np.linalg.norm(body.motion.at(times).translation - body.motion.at(0.0).translation, axis=1)
        for wheel in wheels:
            # Coordinates up to 256 m have steps of 2⁻⁴⁵ m, angles are reduced to a turn.
            np.testing.assert_allclose(
                spin(wheel, body, np.linspace(0, 4, 4001))[::100], way / 0.27, rtol=0, atol=2.0**-38
            )
            middle = [pose(wheel, time) @ [-1.2 if "-" in wheel.name else 1.2, 0, 0.3, 1] for time in (0.0, 0.1)]
            assert abs(middle[0][2] - 0.27) <= 2.0**-30


def test_wheels_roll_backwards_in_reverse(tmp_path: Path) -> None:
    group = {"objects": [CART], "count": 1, "area_m": [[-9, -9], [9, 9]], "speed_m_per_s": -3}
    ((body, wheel, *_),) = instances(scene_and_objects(recipe(tmp_path, carts=group))[0])
    np.testing.assert_allclose(np.diff(spin(wheel, body, np.array([0.0, 0.05]))), [-0.15 / 0.3], rtol=2.0**-38)
    group |= {"along_m": [[-20, 0], [20, 0]], "area_m": None}
    ((body, wheel, *_),) = instances(scene_and_objects(recipe(tmp_path, carts=group))[0])
    np.testing.assert_allclose(np.diff(spin(wheel, body, np.array([0.0, 0.05]))), [0.15 / 0.3], rtol=2.0**-38)


# Ways


def test_speeds_change_as_told_and_places_do_not_jump(tmp_path: Path) -> None:
    speeds = [[1, 8], [2, 0], [2.5, 0], [3.5, 5]]
    group = {"objects": [BODY], "count": 3, "along_m": [[-200, 3], [200, 3]], "speed_m_per_s": speeds}
    for item in scene_and_objects(recipe(tmp_path, cars=group))[1]:
        assert isinstance(item.motion, ls.Trajectory)
        x = item.motion.at([0.0, 1.0, 2.0, 2.5, 3.5, 4.0]).translation[:, 0]
        np.testing.assert_allclose(np.diff(x), [8, 4, 0, 2.5, 2.5], rtol=0, atol=2.0**-44)
        fine = item.motion.at(np.linspace(0, 4, 401)).translation[:, 0]
        assert (np.diff(fine) >= 0).all()
        assert np.diff(fine).max() <= 0.08 + 2.0**-44


@pytest.mark.parametrize("interpolation", ["linear", "spline"])
@pytest.mark.parametrize("offset", [-2.0, 0.0, 2.0])
def test_paths_with_bends_are_followed_without_jumps(tmp_path: Path, interpolation: str, offset: float) -> None:
    points = np.array([[-40.0, 0], [0, 0], [0, 30], [-25, 50]])
    group = {"objects": [BODY], "count": 6, "along_m": points.tolist(), "interpolation": interpolation,
             "offset_m": offset, "speed_m_per_s": 8, "gap_m": 0.5}  # fmt: skip
    bent = 0
    for sequence in range(3):
        for item in scene_and_objects(recipe(tmp_path, cars=group), sequence)[1]:
            assert isinstance(item.motion, ls.Trajectory)
            where = item.motion.at(item.motion.times).as_matrix()
            way = np.linalg.norm(np.diff(where[:, :2, 3], axis=0), axis=1)
            assert way.max() <= 0.8 + 2.0**-40
            heads = where[:-1, :2, 0]
            ahead = np.einsum("ki,ki->k", np.diff(where[:, :2, 3], axis=0), heads) / way
            bent += int((ahead < 0.9999).sum() + (np.ptp(heads[:, 0]) > 0.1))
            if interpolation == "linear":
                assert np.mean(way > 0.8 - 2.0**-40) >= 0.9  # all but those in which it turns
                tangents = np.diff(points, axis=0) / np.linalg.norm(np.diff(points, axis=0), axis=1)[:, None]
                aside = [
                    min(abs(np.linalg.det([t, p - a]) - offset) for t, a in zip(tangents, points[:-1], strict=True))
                    for p in where[:, :2, 3]
                ]
                assert max(aside) <= 2.0**-40
            else:
                assert way.min() >= 0.8 * (1 - 0.8**2 / 24 / 5**2)  # a chord of an arc of at least 5 m radius
                assert ahead.min() >= np.cos(0.8 / 2 / 5)
    assert bent > 0


def test_a_spline_goes_through_its_points(tmp_path: Path) -> None:
    points = [[-40, 0], [-10, 0], [0, 12], [20, 30]]
    group = {"objects": [BODY], "count": 1, "along_m": points, "interpolation": "spline", "speed_m_per_s": 18}
    (item,) = scene_and_objects(recipe(tmp_path, cars=group))[1]
    assert isinstance(item.motion, ls.Trajectory)
    track = item.motion.at(np.linspace(0, 4, 4001)).translation[:, :2]
    for point in points[1:3]:
        assert np.linalg.norm(track - point, axis=1).min() <= 1.8**2 / 8 / 5 + 0.018  # of chords, and of samples


def test_several_paths_are_all_taken(tmp_path: Path) -> None:
    paths = [[[-40, y], [40, y]] for y in (-9, 0, 9)]
    group = {"objects": [BODY], "count": 12, "along_m": paths}
    there = scene_and_objects(recipe(tmp_path, cars=group))[1]
    assert {float(np.asarray(item.motion)[1, 3]) for item in there} == {-9.0, 0.0, 9.0}


# Slopes


@pytest.mark.parametrize("speed", [0, 6])
def test_cars_are_parallel_to_the_ground(tmp_path: Path, speed: float) -> None:
    path = [[-40, 0], [-10, 5], [10, -8], [40, 0]]
    group = {"objects": [CART], "count": 4, "along_m": path, "interpolation": "spline", "speed_m_per_s": speed,
             "tilt": True}  # fmt: skip
    scene, there = scene_and_objects(recipe(tmp_path, ground=HILL, cars=group))
    assert len(there) >= 3
    normal = np.array([-0.2, 0.1, 1]) / np.linalg.norm([-0.2, 0.1, 1])
    for parts, item in zip(instances(scene), there, strict=True):
        for time in (0.0, 1.7, 4.0):
            body = item.motion.at(time).as_matrix() if isinstance(item.motion, ls.Trajectory) else item.motion
            # Heights are found from 1e5 m above, where coordinates have steps of 2⁻³⁶ m; half the width is 0.85 m.
            assert np.linalg.norm(body[:3, 2] - normal) <= 2.0**-32
            ends = [(x, y, 0, 1) for x in (-1.2, 1.2) for y in (-0.75, 0.75)]
            on = [normal @ (body @ end)[:3] for end in ends]
            np.testing.assert_allclose(on, 0, rtol=0, atol=2.0**-32)
            low = min(np.min(surface(part, time) @ normal) for part in parts if part.name)
            assert abs(low) <= 0.01  # a tessellated wheel


def test_people_stand_upright_on_slopes(tmp_path: Path) -> None:
    group = {"objects": [WALKER], "count": 3, "area_m": [[-9, -9], [9, 9]], "speed_m_per_s": 1}
    scene, there = scene_and_objects(recipe(tmp_path, ground=HILL, people=group))
    for parts, item in zip(instances(scene), there, strict=True):
        assert isinstance(item.motion, ls.Trajectory)
        assert (item.motion.at(1.0).as_matrix()[:3, 2] == (0, 0, 1)).all()
        assert parts[0].motion is not None


@pytest.mark.parametrize("size", [1e-3, 0.3, 4.0])
def test_gaps_are_in_metres_whatever_the_size(size: float) -> None:
    """Squares whose sides are a metre apart keep a gap of less, and none of more."""
    square = size * np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    near, far = (Outline(square[None] + [shift, 0.0], 0.0, 1.0) for shift in (0.0, size + 1.0))
    assert near.apart(far, 0.999)
    assert not near.apart(far, 1.001)


# Rotation and scene files


@pytest.mark.parametrize(("low", "lift"), [(10.0, -10.0), (0.0, 0.0), (0.0, 5.0)])
def test_turned_objects_of_the_scene_are_as_high_as_their_place_makes_them(
    tmp_path: Path, low: float, lift: float
) -> None:
    """People stand beside a block on the floor, wherever its own coordinates begin, and below one that is lifted."""
    block = {"shape": "box", "size_m": [12, 12, 1], "center_m": [0, 0, low + 0.5], "rotation_deg": {"yaw": 30},
             "position_m": [0, 0, lift]}  # fmt: skip
    path = recipe(tmp_path, people={"objects": [WALKER], "count": 12, "area_m": [[-9, -9], [9, 9]]})
    text = yaml.safe_load(path.read_text())
    text["run"] |= {"scene": [FLOOR, block], "pose": {"position_m": [0, 0, 20]}}
    path.write_text(yaml.safe_dump(text))
    scene, found = scene_and_objects(path)
    people = [parts for parts in instances(scene) if parts[0].label == 2]
    assert len(people) == len(found) == 12
    turn = np.array([[np.cos(np.pi / 6), -np.sin(np.pi / 6)], [np.sin(np.pi / 6), np.cos(np.pi / 6)]])
    least = min(np.abs(plan(parts, 0.0) @ turn).max(axis=1).min() for parts in people)
    assert (least > 6.0) == (low + lift == 0.0)


def test_a_rotation_is_obeyed(tmp_path: Path) -> None:
    turned = {"shape": "box", "size_m": [1, 4, 1], "center_m": [0, 0, 0.5], "rotation_deg": {"yaw": 90},
              "position_m": [0.5, 0, 0.1]}  # fmt: skip
    for speed in (0, 5):
        group = {"objects": [turned], "count": 3, "along_m": [[-50, 9], [50, 9]], "speed_m_per_s": speed}
        scene, _ = scene_and_objects(recipe(tmp_path, cars=group))
        for (item,) in instances(scene):
            bounds = np.ptp(plan([item], 0.3), axis=0)
            np.testing.assert_allclose(bounds, [4, 1], rtol=0, atol=2.0**-40)
            assert item.shape._extent(pose(item, 0.3)[:3])[0, 2] == pytest.approx(0.0, abs=2.0**-34)  # on the ground


@functools.cache
def model(folder: Path) -> Path:
    """A car that faces -y, as a glTF that faces z comes in, with a flag that a rule leaves out."""
    scene, up = trimesh.Scene(), trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))
    scene.graph.update("car", "world", matrix=up)
    across = trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0))
    for number, (x, y) in enumerate([(-0.8, -1.3), (0.8, -1.3), (-0.8, 1.3), (0.8, 1.3)]):
        wheel = trimesh.creation.cylinder(0.3, 0.2, sections=64, transform=across)
        place = trimesh.transformations.translation_matrix((x, y, 0.3))
        scene.add_geometry(wheel, f"wheel {number}", f"w{number}", parent_node_name="car", transform=place)
    shell = trimesh.creation.box((1.8, 4.2, 1.2))
    shell.apply_translation((0, 0, 0.8))
    scene.add_geometry(shell, "shell", "shell", parent_node_name="car")
    scene.add_geometry(trimesh.creation.box((9, 9, 9)), "flag", "flag", parent_node_name="car")
    path = folder / "model.glb"
    path.write_bytes(scene.export(file_type="glb"))
    return path


def scene_file(folder: Path) -> dict[str, Any]:
    rules = [{"node": "*flag", "skip": True}, {"node": "*wheel*", "label": 5}, {"node": "*shell", "label": 7}]
    return {"shape": "scene_file", "file": str(model(folder)), "rules": rules, "wheels": "wheel*",
            "rotation_deg": {"yaw": 90}}  # fmt: skip


@pytest.mark.parametrize("speed", [0, 7])
def test_a_scene_file_is_one_instance(tmp_path: Path, speed: float) -> None:
    group = {"objects": [scene_file(tmp_path)], "count": 3, "along_m": [[-50, 9], [50, 19]], "speed_m_per_s": speed}
    scene, _ = scene_and_objects(recipe(tmp_path, cars=group))
    assert len(instances(scene)) == 3
    for parts in instances(scene):
        assert [item.label for item in parts] == [7, 5, 5, 5, 5]
        assert [item.name for item in parts] == ["shell", *(f"wheel {k}" for k in range(4))]
        shell = pose(parts[0], 0.0)
        np.testing.assert_allclose(shell[:2, 1], np.array([-10, -1]) / -np.sqrt(101) * -1, rtol=0, atol=2.0**-46)


# Boxes


@pytest.mark.parametrize("deskew", ["start", "middle", "end"])
def test_boxes_hold_the_points_and_head_along_the_motion(tmp_path: Path, deskew: Any) -> None:
    groups: dict[str, dict[str, Any]] = {
        "carts": {"objects": [CART, scene_file(tmp_path)], "count": 8, "along_m": [[-80, 6], [0, 9], [80, 6]],
                  "interpolation": "spline", "speed_m_per_s": {"uniform": [10, 15]}, "tilt": True, "gap_m": 1},
        "parked": {"objects": [CART, scene_file(tmp_path)], "count": 8, "along_m": [[-40, 14], [40, 14]], "gap_m": 1},
        "people": {"objects": [WALKER], "count": 14, "area_m": [[-9, -9], [12, 2]], "gap_m": 0.3, "clear_m": 1.5,
                   "yaw_deg": {"uniform": [0, 360]}, "speed_m_per_s": {"choice": [0, 1, 1.6, 2.3]}},
    }  # fmt: skip
    path = recipe(tmp_path, **groups)
    text = path.read_text().replace(yaml.safe_dump({"sensor": SENSOR}), "")
    path.write_text(text)
    source = load(
        path, ["run.sensor={preset: ouster-os1-64}", "run.pose={position_m: [0, 0, 2], linear_m_per_s: [9, 0, 0]}"]
    ).source
    assert isinstance(source, Document)
    run = source.run(0)
    (scans,) = dataclasses.replace(run, frames=range(9, 10)).scans()
    scan = scans[""]
    cloud = scan.point_cloud(deskew=deskew, deskew_movers=True)
    boxes = scan.boxes(deskew=deskew)
    world = scan.boxes(deskew=deskew, frame="world")
    there = {parts[0].instance: item for parts, item in zip(instances(run.scene), source.scatter(0)[0], strict=True)}
    numbers = [number for number in boxes.instance.tolist() if number in there]
    assert len(numbers) == len(set(numbers)) >= 20
    seen = 0
    for number, row in zip(boxes.instance.tolist(), range(len(boxes)), strict=True):
        if number not in there:
            continue
        own = cloud.instance == number
        assert boxes.contain(cloud.xyz[own])[row].mean() >= 0.999 if own.any() else True
        seen += int(own.sum())
        motion = there[number].motion
        moved = isinstance(motion, ls.Trajectory)
        body = motion.at(world.time[row]).as_matrix() if isinstance(motion, ls.Trajectory) else motion
        # The heading is that of the way: exact but for the roundings of a few products.
        np.testing.assert_allclose(world.rotation[row], body[:3, :3], rtol=0, atol=2.0**-45)
        if moved:
            velocity = world.velocity[row] * ((1, 1, 0) if there[number].group == "people" else 1)  # who bob
            assert world.rotation[row, :, 0] @ velocity >= 0.97 * np.linalg.norm(velocity) > 0
        if there[number].group != "people":
            assert (boxes.size[row] > [3.9, 1.6, 1.2]).all()
            assert (boxes.size[row] < [4.3, 1.9, 1.6]).all()
    assert seen > 3000


# At all times


def hull(points: Floats) -> Floats:
    return points[ConvexHull(points).vertices]


def distance(first: Floats, second: Floats) -> float:
    """Least distance of the outlines of two convex polygons, 0 if they overlap: over all pairs of sides and corners."""
    edges = [np.diff(np.vstack([polygon, polygon[:1]]), axis=0) for polygon in (first, second)]
    normals = np.concatenate([np.stack([edge[:, 1], -edge[:, 0]], 1) for edge in edges])
    separated = max(
        max((second @ normal).min() - (first @ normal).max(), (first @ normal).min() - (second @ normal).max())
        for normal in normals / np.linalg.norm(normals, axis=1)[:, None]
    )
    if separated < 0:
        return 0.0
    least = np.inf
    for polygon, other, edge in ((first, second, edges[0]), (second, first, edges[1])):
        share = np.einsum("pi,npi->np", edge, other[:, None] - polygon) / (edge**2).sum(axis=1)
        nearest = polygon + np.clip(share, 0, 1)[..., None] * edge
        least = min(least, float(np.linalg.norm(other[:, None] - nearest, axis=2).min()))
    return least


@pytest.mark.slow("instances of several parts never meet")
def test_instances_of_parts_never_meet(tmp_path: Path) -> None:
    gap = 0.3
    bend = [[-30, 0], [0, 4], [0, 30]]
    groups: dict[str, dict[str, Any]] = {
        "bent": {"objects": [CART], "count": 3, "along_m": bend, "speed_m_per_s": {"uniform": [2, 9]}, "gap_m": gap},
        "back": {"objects": [CART], "count": 3, "along_m": bend, "offset_m": 2.2, "speed_m_per_s": -6, "gap_m": gap},
        "stopping": {"objects": [CART], "count": 3, "along_m": [[-30, 12], [30, 12]], "gap_m": gap,
                     "speed_m_per_s": [[0, 8], [1, 0], [1.5, 0], [2, 8]]},
        "people": {"objects": [WALKER], "count": 16, "area_m": [[-9, -3], [5, 12]], "gap_m": gap,
                   "yaw_deg": {"uniform": [0, 360]}, "speed_m_per_s": {"choice": [0, 1, 2]}},
    }  # fmt: skip
    path = recipe(tmp_path, frames=20, **groups)
    least, pairs = np.inf, 0
    for sequence in range(1):
        scene, there = scene_and_objects(path, sequence)
        assert {item.group for item in there} == set(groups)
        shapes = instances(scene)
        for time in np.linspace(0, 2.1, 36):
            plans = [hull(plan(parts, time)) for parts in shapes]
            middles = np.array([points.mean(axis=0) for points in plans])
            reach = np.array(
                [np.linalg.norm(points - m, axis=1).max() for points, m in zip(plans, middles, strict=True)]
            )
            apart = np.linalg.norm(middles[:, None] - middles[None], axis=2) - reach[:, None] - reach[None]
            for a, b in combinations(range(len(plans)), 2):
                if apart[a, b] < gap:
                    pairs += 1
                    least = min(least, distance(plans[a], plans[b]))
    assert least >= gap
    assert least < 3 * gap  # some come near
    assert pairs > 50


def test_what_is_said_to_be_apart_is_apart_within_each_step() -> None:
    """Rectangles that turn and move between two moments, at thirty moments between these."""
    generator = np.random.default_rng(5)
    rim = np.array([[-2.0, -0.2], [2, -0.2], [2, 0.2], [-2, 0.2]])
    near = far = 0
    for number in range(150):
        starts, turns = generator.uniform(-4, 4, (2, 2)), generator.uniform(-np.pi, np.pi, 2)
        moves, spins = generator.uniform(-3, 3, (2, 2)), generator.uniform(-2, 2, 2)
        if number < 20:  # side by side: they reach farthest to each other in between
            starts, turns = np.array([[-2.0, 0], [2.01 + number / 100, 0]]), np.array([np.pi / 2, np.pi / 2])
            moves, spins = np.zeros((2, 2)), np.array([2.0, 2.0])

        def corners(k: int, u: float, of: Any = (starts, turns, moves, spins)) -> Floats:
            start, turn, move, spin = (part[k] for part in of)
            c, s = np.cos(turn + u * spin), np.sin(turn + u * spin)
            moved: Floats = rim @ np.array([[c, s], [-s, c]]) + start + u * move
            return moved

        outlines = [
            Outline(np.concatenate([corners(k, 0.0), corners(k, 1.0)])[None], 0, 1,
                    np.hypot(2, 0.2) * (1 - np.cos(spins[k] / 2)))
            for k in (0, 1)
        ]  # fmt: skip
        least = min(distance(corners(0, u), corners(1, u)) for u in np.linspace(0, 1, 30))
        if outlines[0].apart(outlines[1], 0.2):
            assert least >= 0.2
            far += 1
        near += least < 0.2
    assert far > 10
    assert near > 40


@pytest.mark.slow("crowds of hundreds never meet")
def test_traffic_of_two_hundred_instances() -> None:
    """The town: its instances are apart at moments within its steps, and one instance each."""
    source = load(CONFIGS / "recipes" / "traffic.yaml").source
    assert isinstance(source, Document)
    run = source.run(0)
    there = source.scatter(0)[0]
    assert len(there) >= 200
    items = list(run.scene)[-sum(len(item.parts) for item in there) :]
    shapes = [
        [item for item in items if item.instance == number] for number in dict.fromkeys(i.instance for i in items)
    ]
    assert len(shapes) == len(there)
    pairs = 0
    for time in (0.0, 2.04, 3.35, 6.07, 8.0):
        plans = [plan(parts, time) for parts in shapes]
        low, high = (
            np.array([points.min(axis=0) for points in plans]),
            np.array([points.max(axis=0) for points in plans]),
        )
        near = ((low[:, None] < high[None] + 1) & (low[None] < high[:, None] + 1)).all(axis=2)
        for a, b in zip(*np.nonzero(np.triu(near, 1)), strict=True):
            pairs += 1
            assert distance(hull(plans[a]), hull(plans[b])) >= 0.3
    assert pairs > 20


@pytest.mark.parametrize(
    ("instance", "more", "message"),
    [
        (WALKER, {"speed_m_per_s": 9}, r"people\.speed_m_per_s: expected at most 2\.78 m/s of a walker 1\.75 m"),
        (WALKER, {"speed_m_per_s": [[0, 9]]}, r"speed_m_per_s: expected at most 2\.78 m/s of a walker"),
        (WALKER | {"height_m": 0}, {}, r"objects\.0\.height_m: expected a value >= 0.1, got 0"),
        (WALKER | {"scale": 2.0}, {}, r"objects\.0\.scale: expected no scale of a walker: use height_m"),
        (WALKER | {"rotation_deg": {"yaw": 3}}, {}, r"rotation_deg: expected no rotation_deg of a walker"),
        (BODY | {"instance": 7}, {}, r"instance: expected none, since each copy is an instance of its own"),
        (BODY | {"motion": {"linear_m_per_s": [1, 0, 0]}}, {}, r"motion: expected no motion, since the group"),
        (CART | {"wheels": "tyre*"}, {}, r"wheels: expected the name of a part, of .*'wheel 1\.2', got 'tyre\*'"),
        (CART | {"wheels": "*"}, {}, r"wheels: expected a part that is no wheel, got '\*'"),
        (CART | {"parts": []}, {}, r"objects\.0\.parts: expected at least 1 item"),
        (CART | {"parts": [FLOOR]}, {}, r"wheels: expected the name of a part"),
        ({"shape": "compound", "parts": [FLOOR]}, {}, r"objects\.0: expected a bounded object, got an unbounded one"),
        ({"shape": "compound", "parts": [CART]}, {}, r"objects\.0\.parts\.0"),
        (BODY | {"wheels": "*"}, {}, r"objects\.0\.wheels: unknown key"),
        ({"shape": "person"}, {}, r"objects\.0\.shape: .*'walker'"),
        (BODY, {"interpolation": "spline"}, r"people\.interpolation: expected along_m beside it, got area_m"),
        (BODY, {"speed_m_per_s": []}, r"speed_m_per_s: expected at least 1 item"),
        (BODY, {"speed_m_per_s": [[0, 1], [0, 2]]}, r"speed_m_per_s\.1\.0: expected rising times, got 0\.0 after 0\.0"),
        (BODY, {"speed_m_per_s": [[0, -1]]}, r"speed_m_per_s\.0\.1: expected a value >= 0"),
        (BODY, {"speed_m_per_s": [[0, float("nan")]]}, r"speed_m_per_s\.0\.1: "),
        (BODY, {"area_m": None, "along_m": [[[0, 0], [9, 9]], [[0, 0]]]}, r"along_m\.1: expected at least 2 items"),
        (BODY, {"area_m": None, "along_m": [[[0, 0], [0, 0]]]}, r"along_m\.0\.1: expected points that differ"),
        (BODY, {"tilt": 1}, r"people\.tilt: "),
    ],
)  # fmt: skip
def test_mistakes_are_named(tmp_path: Path, instance: dict[str, Any], more: dict[str, Any], message: str) -> None:
    group = {"objects": [instance], "count": 1, "area_m": [[-1, -1], [1, 1]]} | more
    with pytest.raises(ConfigError, match=message) as caught:
        scene_and_objects(recipe(tmp_path, people=group))
    assert re.match(r".*recipe\.yaml:\d+: ", str(caught.value))


def test_scattered_objects_share_no_instance_with_the_scene(tmp_path: Path) -> None:
    groups = {"objects": [BODY, CART], "weights": [1, 1], "count": 6, "area_m": [[-30, -30], [30, 30]]}
    path = recipe(tmp_path, ground=FLOOR | {"instance": 2}, things=groups)
    scene, placed = scene_and_objects(path)
    assert 2 not in {item.instance for item in scene if item.name != "floor"}
    assert [len(own) for own in instances(scene)] == [len(own.parts) for own in placed]


def test_a_scene_file_has_no_instances_of_its_own(tmp_path: Path) -> None:
    instance = scene_file(tmp_path) | {"rules": [{"node": "*", "instance": 3}]}
    group = {"objects": [instance], "count": 1, "area_m": [[-1, -1], [1, 1]]}
    with pytest.raises(ConfigError, match=r"rules\.0\.instance: expected none, since the file is one instance"):
        load(recipe(tmp_path, cars=group))
    group = {"objects": [instance | {"rules": [{"skip": True}]}], "count": 1, "area_m": [[-1, -1], [1, 1]]}
    with pytest.raises(ConfigError, match=r"objects\.0\.file: expected a file with objects, got none"):
        load(recipe(tmp_path, cars=group))


def test_an_offset_that_a_bend_has_no_room_for(tmp_path: Path) -> None:
    hook = [[-20, 0], [0, 0], [0.5, 0.5], [0, 1], [-20, 1]]
    group = {"objects": [BODY], "count": 2, "along_m": hook, "offset_m": 3}
    assert scene_and_objects(recipe(tmp_path, cars=group))[1] == []
    assert len(scene_and_objects(recipe(tmp_path, cars=group | {"offset_m": -3}))[1]) == 2


def test_the_outline_holds_what_turns(tmp_path: Path) -> None:
    """A square wheel that sticks out ahead reaches as far as its corners."""
    wheel = {"shape": "box", "name": "wheel", "size_m": [1, 0.2, 1], "center_m": [2.5, 0, 0.5]}
    path = recipe(tmp_path, cars={"objects": [CART | {"parts": [BODY, wheel]}], "count": 1, "area_m": [[0, 0], [1, 1]]})
    source = load(path, ["scatter.cars.speed_m_per_s=3"]).source
    assert isinstance(source, Document)
    group = source.settings.scatter["cars"]
    way = Way(group, Stream(0, "", 0), np.linspace(0, 4, 41), Place(source.root, ()))
    bounds = (
        instance_of(group.objects[0], Place(source.root, ())).swing(2.0, way.travel, 0.0, Place(source.root, ())).bounds
    )
    np.testing.assert_allclose(bounds, [[-4, -1.7, 0], [2 * (2.5 + np.sqrt(0.5)), 1.7, 2.8]], rtol=0, atol=2.0**-44)


def test_movers_of_the_scene_are_kept_clear_of(tmp_path: Path) -> None:
    """A tram that crosses the area: what is scattered is where it never comes, but may be where it is not yet."""
    tram = {"shape": "box", "size_m": [8, 2, 3], "center_m": [0, 0, 1.5], "name": "tram",
            "motion": [{"time_s": 0, "position_m": [-30, 0, 0]}, {"time_s": 5, "position_m": [30, 0, 0]}]}  # fmt: skip
    group = {"objects": [BODY], "on": ["floor"], "count": 25, "area_m": [[-8, -6], [8, 6]]}
    run = {"sensor": SENSOR, "scene": [FLOOR, tram], "pose": {"position_m": [0, 0, 2]}}
    path = tmp_path / "recipe.yaml"
    path.write_text(yaml.safe_dump({"layout": "shards", "frames": 40, "scatter": {"cars": group}, "run": run}))
    y = [float(np.asarray(item.motion)[1, 3]) for item in scene_and_objects(path)[1]]
    assert len(y) >= 4
    assert np.abs(y).min() >= 1 + 0.85
