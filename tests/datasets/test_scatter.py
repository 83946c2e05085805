"""Scattered objects: seen by brute force to be where they are said to be, and apart."""

from __future__ import annotations

import dataclasses
import functools
import re
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import yaml
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.config.document import Place, parse
from lidarsim.datasets import scatter as scattering
from lidarsim.datasets.recipe import Document, load
from lidarsim.datasets.scatter import Placed, Scatter, scatter
from lidarsim.datasets.scatter._outlines import Outline
from lidarsim.datasets.scatter._travel import STEP
from lidarsim.datasets.scatter._ways import Way
from lidarsim.datasets.scattered import Scattered, Tally
from lidarsim.errors import ConfigError

BOX = {"shape": "box", "size_m": [4, 2, 1.5], "center_m": [0.5, 0, 0.75], "label": 10}
RECIPE = {
    "sequences": 5,
    "frames": 20,
    "seed": 3,
    "layout": "shards",
    "scatter": {
        "cars": {
            "objects": [BOX, {"shape": "ellipsoid", "center_m": [0, 0, 1], "radii_m": [2, 1, 1], "label": 11}],
            "on": ["floor"],
            "count": 9,
            "area_m": [[-15, -15], [15, 15]],
            "yaw_deg": {"uniform": [0, 360]},
            "scale": {"uniform": [0.8, 1.3]},
            "gap_m": 0.5,
            "clear_m": 3,
        },
        "boxes": {
            "objects": [{"shape": "box", "size_m": [1, 1, 1], "center_m": [0, 0, 0.5]}],
            "on": ["floor", "dais"],
            "count": {"integer": [3, 6]},
            "along_m": [[-14, 0], [0, 3], [14, 0]],
            "offset_m": {"uniform": [-2, 2]},
            "gap_m": 0.25,
        },
    },
    "run": {
        "sensor": {"pattern": {"type": "grid", "azimuths_deg": [0], "elevations_deg": [0], "rate_hz": 10}},
        "pose": {"position_m": [-10, 0, 1], "linear_m_per_s": [8, 0, 0]},
        "scene": [
            {"shape": "plane", "normal": [0, 0, 1], "distance_m": -0.25, "name": "floor"},
            {"shape": "box", "size_m": [6, 6, 0.5], "center_m": [8, 3, 0], "name": "dais"},
            {"shape": "cylinder", "start_m": [0, 8, -1], "end_m": [0, 8, 4], "radius_m": 1.5, "name": "pillar"},
        ],
    },
}
CONFIGS = Path(__file__).parents[2] / "configs"
SEQUENCES = range(8)


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scatter") / "recipe.yaml"
    path.write_text(yaml.safe_dump(RECIPE, sort_keys=False))
    return path


@functools.cache
def scene_and_objects(path: Path, sequence: int, *overrides: str) -> tuple[ls.Scene, list[Placed]]:
    source = load(path, overrides).source
    assert isinstance(source, Document)
    run = source.run(sequence)
    return run.scene, source.scatter(sequence)[0]


def outline(item: ls.scene.SceneObject, n: int = 24) -> npt.NDArray[np.float64]:
    """Points of the plan of an object, from its corners or its equator, in the world."""
    if isinstance(item.shape, ls.Box):
        low, high = ((-1.5, -1), (2.5, 1)) if item.label == 10 else ((-0.5, -0.5), (0.5, 0.5))
        share = np.linspace(0, 1, n)
        sides = [(share, 0 * share), (share, 0 * share + 1), (0 * share, share), (0 * share + 1, share)]
        xy = np.concatenate([np.stack(side, 1) for side in sides]) * np.subtract(high, low) + low
    elif isinstance(item.shape, ls.Cylinder):
        angle = np.arange(4 * n) * (np.pi / (2 * n))
        return 1.5 * np.stack([np.cos(angle), np.sin(angle)], 1) + (0, 8)
    else:
        angle = np.arange(4 * n) * (np.pi / (2 * n))
        xy = np.stack([2 * np.cos(angle), np.sin(angle)], 1)
    assert item.transform is not None
    return xy @ item.transform[:2, :2].T + item.transform[:2, 3]


def test_nothing_overlaps(recipe: Path) -> None:
    found = 0
    for sequence in SEQUENCES:
        scene, there = scene_and_objects(recipe, sequence)
        items = [(item, outline(item)) for item in scene.objects[2:]]
        found += len(there)
        for (_, first), (second_item, second) in combinations(items, 2):
            gap = 0.5 if second_item.label else 0.25
            distance = np.linalg.norm(first[:, None] - second[None], axis=2).min()
            assert distance >= gap
    assert found >= 8 * 8


def test_they_stand_on_the_ground(recipe: Path) -> None:
    heights = set()
    for sequence in SEQUENCES:
        scene, _ = scene_and_objects(recipe, sequence)
        for item in scene.objects[3:]:
            assert item.transform is not None
            bottom = float(item.transform[2, 3])
            plan = outline(item)
            on_dais = (np.abs(plan - (8, 3)) <= 3).all(axis=1)
            wanted = 0.25 if on_dais.any() and not item.label else -0.25
            assert abs(bottom - wanted) <= 4 * np.spacing(1e5)  # found from there
            assert not (item.label and on_dais.any())
            heights.add(wanted)
    assert heights == {0.25, -0.25}


def test_the_sensor_is_kept_clear(recipe: Path) -> None:
    track = np.stack([np.linspace(-10, 6, 200), np.zeros(200)], 1)
    for sequence in SEQUENCES:
        scene, _ = scene_and_objects(recipe, sequence)
        for item in scene.objects[3:]:
            if item.label:
                assert np.linalg.norm(outline(item)[:, None] - track[None], axis=2).min() >= 3


def test_places_depend_on_their_own_group(recipe: Path) -> None:
    alone = yaml.safe_dump({"cars": RECIPE["scatter"]["cars"]}, default_flow_style=True, width=10_000)  # type: ignore[index]
    for sequence in (0, 3):
        _, both = scene_and_objects(recipe, sequence)
        _, one = scene_and_objects(recipe, sequence, f"scatter={alone}")
        cars = [item for item in both if item.group == "cars"]
        assert len(cars) == len(one) >= 5
        for first, second in zip(cars, one, strict=True):
            np.testing.assert_array_equal(first.motion, second.motion)
    _, fewer = scene_and_objects(recipe, 0, "scatter.cars.count=3")
    for first, second in zip(scene_and_objects(recipe, 0)[1][:3], fewer, strict=False):
        np.testing.assert_array_equal(first.motion, second.motion)
    assert not np.array_equal(scene_and_objects(recipe, 1)[1][0].motion, scene_and_objects(recipe, 0)[1][0].motion)


def test_along_a_path_they_keep_to_it(recipe: Path) -> None:
    path = np.array([[-14, 0], [0, 3], [14, 0]])
    pieces = list(pairwise(path))
    for sequence in SEQUENCES:
        for item in scene_and_objects(recipe, sequence)[1]:
            if item.group == "boxes":
                pose = np.asarray(item.motion)
                off = [abs(np.linalg.det([b - a, pose[:2, 3] - a]) / np.linalg.norm(b - a)) for a, b in pieces]
                ahead = [np.dot(pose[:2, 0], b - a) / np.linalg.norm(b - a) for a, b in pieces]
                # The cosine of a small angle is 1 but for the roundings of the two vectors.
                assert any(
                    distance <= 2 and cosine >= 1 - 4 * 2.0**-53 for distance, cosine in zip(off, ahead, strict=True)
                )


def moving(path: Path, sequence: int) -> list[Placed]:
    """Where boxes go that meet on a bent road."""
    source = load(path).source
    assert isinstance(source, Document)
    box = {"shape": "box", "size_m": [2, 1, 1], "center_m": [0, 0, 0.5]}
    road = {"on": ["floor"], "count": 4, "along_m": [[-40, 0], [0, 10], [40, 0]], "gap_m": 0.5, "objects": [box]}
    groups = {
        "ahead": Scatter(**road, offset_m=-1.5, speed_m_per_s={"uniform": [2, 12]}),
        "back": Scatter(**road, offset_m=1.0, speed_m_per_s=-9.0),
        "against": Scatter(**road, offset_m=2.5, speed_m_per_s=6.0, yaw_deg=180),
        "across": Scatter(
            on=["floor"], objects=[box], count=4, area_m=[[-20, -20], [20, 20]], yaw_deg=90, gap_m=0.5, speed_m_per_s=5
        ),
        "still": Scatter(on=["floor"], objects=[box], count=10, area_m=[[-20, -20], [20, 20]], gap_m=0.5),
    }
    return scatter(groups, Place(parse("{}", "groups.yaml")), source.run(0), 5, sequence)[0]


def test_movers_never_meet(recipe: Path) -> None:
    times = np.linspace(0.0, 2.1, 64)  # between which they move by up to 0.4 m: ends of steps, and in them
    corners = np.array([[-1, -0.5, 0], [1, -0.5, 0], [1, 0.5, 0], [-1, 0.5, 0]])
    share = np.linspace(0, 1, 5)[:, None]
    rim = np.concatenate([a + share * (b - a) for a, b in pairwise([*corners, corners[0]])])
    groups = set()
    for sequence in range(3):
        there = moving(recipe, sequence)
        plans = []
        for item in there:
            poses = item.motion.at(times).as_matrix() if isinstance(item.motion, ls.Trajectory) else item.motion[None]
            plans.append((poses[:, None, :3, :3] @ rim[:, :, None])[..., 0] + poses[:, None, :3, 3])
            np.testing.assert_allclose(poses[:, 2, 3], -0.25, rtol=0, atol=3 * np.spacing(1e5))
            groups.add(item.group)
        for first, second in combinations(plans, 2):
            apart = np.linalg.norm(first[:, :, None, :2] - second[:, None, :, :2], axis=-1).min()
            assert apart >= 0.5
    assert groups == {"ahead", "back", "against", "across", "still"}


def test_movers_go_as_fast_as_said(recipe: Path) -> None:
    for item in moving(recipe, 0):
        if item.group == "still":
            assert not isinstance(item.motion, ls.Trajectory)
            continue
        assert isinstance(item.motion, ls.Trajectory)
        track = item.motion.poses
        step = np.diff(track.translation[:, :2], axis=0)
        speed = np.linalg.norm(step, axis=1)[:5] / np.diff(item.motion.times)[:5]
        wanted = {"back": 9.0, "against": 6.0, "across": 5.0}.get(item.group)
        # Coordinates below 64 are rounded by 2⁻⁴⁸: four in a step, and as much again in the way along the path.
        rounded, way = 8 * 2.0**-48, np.linalg.norm(step[0])
        np.testing.assert_allclose(speed, speed[0] if wanted is None else wanted, rtol=0, atol=rounded / 0.1)
        heading = track[0].rotation.apply([1, 0, 0])[:2]
        np.testing.assert_allclose(step[0] / way, heading, rtol=0, atol=rounded / way)
        assert (heading[0] < -0.9) == (item.group in {"back", "against"})


def test_points_on_movers_of_the_street_move() -> None:
    """The radial velocity is that of what a point is on, less that of the car, along the pulse."""
    source = load(Path(__file__).parents[2] / "configs" / "recipes" / "street.yaml").source
    assert isinstance(source, Document)
    run = source.run(0)
    (scans,) = dataclasses.replace(run, frames=range(20, 21)).scans()
    scan, cloud = scans["roof"], scans["roof"].point_cloud()
    there = source.scatter(0)[0]
    velocities = np.zeros((len(run.scene.objects), 3))
    for k, item in enumerate(there, start=len(velocities) - len(there)):
        if isinstance(item.motion, ls.Trajectory):
            velocities[k] = np.diff(item.motion.at([2.0, 2.5]).translation, axis=0)[0] / 0.5
    pulses = scan.pulses.directions[
        scan.status == ls.Status.hit
    ]  # in the axes of the world, since the car goes straight
    relative = velocities[cloud.object_id] - np.diff(run.pose.at([2.0, 3.0]).translation, axis=0)
    # float32 has steps of 2**-19 m/s up to 32 m/s.
    np.testing.assert_allclose(cloud.radial_velocity, (relative * pulses).sum(1), rtol=0, atol=2.0**-19)
    moving = velocities[cloud.object_id].any(axis=1)
    for label in (1, 2):
        assert np.count_nonzero(moving & (cloud.label == label)) > 100
        assert len(np.unique(cloud.object_id[moving & (cloud.label == label)])) > 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            "scatter.cars.on=[table]",
            r"scatter\.cars\.on=\[table\]: expected names of objects in the scene, got 'table'",
        ),
        ("scatter.cars.along_m=[[0, 0], [1, 1]]", "expected one of area_m, along_m and along, got area_m and along_m"),
        ("scatter.boxes.along_m=[[0, 0], [0, 0]]", "expected points that differ"),
        ("scatter.boxes.speed_m_per_s=100", r"expected a path as long as the way in a sequence, \d+ m, got 28\.64 m"),
        ("scatter.cars.objects.0.motion={linear_m_per_s: [1, 0, 0]}", "expected no motion, since the group moves its"),
        ("scatter.cars.objects.0={shape: plane, normal: [0, 0, 1]}", "expected a bounded object"),
        ("scatter.cars.objects.0={shape: scene_file, file: a.glb}", r"file: .*a\.glb"),
        ("scatter.cars.scale={choice: [a]}", "expected numbers"),
        ("scatter.cars.offset_m=1", "offset_m=1: expected along_m or along beside it, got area_m"),
        ("scatter.cars.gap_m=-1", "expected a value >= 0.0, got -1"),
        ("scatter.cars.colour=red", "unknown key"),
        *(
            (f"scatter.cars.{key}={value}", rf"scatter\.cars\.{key}={re.escape(value)}: expected a .*, got {got}")
            for key in ("count", "offset_m", "yaw_deg", "scale", "speed_m_per_s", "gap_m", "clear_m")
            for value, got in (
                [(".inf", "inf"), ("-.inf", "-inf"), (".nan", "nan"), ("1.0e+300", r"1e\+300"), ("1.1e+9", "1")]
                + [("0", "0")] * (key == "scale")
                + [("-1", "-1")] * (key in {"count", "scale", "gap_m", "clear_m"})
            )
        ),
        ("scatter.cars.count=4000000000", r"expected a number from 0 to 10000, got 4e\+09"),
        ("scatter.cars.count=2.5", "expected an integer, got 2.5"),
        ("scatter.cars.count=[3]", "expected a number, got a list of 1"),
        ("scatter.cars.count={uniform: [-1, 3]}", r"count=.*: expected a number from 0 to 10000, got -1"),
        ("scatter.cars.count={integer: [1, 10001]}", r"count=.*: expected a number from 0 to 10000, got 10001"),
        ("scatter.cars.count={choice: [1, true]}", r"count\.choice\.1: expected numbers, each finite, got True"),
        ("scatter.cars.count={choice: [1, .inf]}", r"count\.choice\.1: expected numbers, each finite, got inf"),
        ("scatter.cars.count={uniform: [1, 2], per: frame}", r"count\.per: expected sequence"),
        ("scatter.cars.count={normal: [1.0e+6, 1]}", r"count=.*: expected a number from 0 to 10000, got 1e\+06"),
        ("scatter.cars.scale={normal: [0.01, 100]}", r"scale=.*: expected a number from 1e-09 to 1e\+09, got -"),
        ("scatter.cars.scale={log_uniform: [1.0e-300, 1]}", r"expected a number from 1e-09 to 1e\+09, got 1e-300"),
        ("scatter.cars.area_m=[[.nan, 0], [1, 1]]", r"area_m\.0\.0: expected a value <= 1000000000\.0, got nan"),
        ("scatter.cars.area_m=[[0, 0], [1, -.inf]]", r"area_m\.1\.1: expected a value >= -1000000000\.0, got -inf"),
        ("scatter.cars.area_m=[[0, 0], [1, 1], [2, 2]]", "expected at most 2 items, got a list of 3"),
        ("scatter.cars.area_m=all", "expected a list, got 'all'"),
        ("scatter.boxes.along_m=[[0, 0], [1.0e+300, 0]]",
         r"along_m\.1\.0: expected a value <= 1000000000\.0, got 1e\+300"),
        ("scatter.boxes.along_m=[[0, 0], [0, 1], [1.0e-320, 1]]",
         r"along_m\.2: expected points that differ .* 1e-09 m"),
        ("scatter.boxes.along_m=[[0, 0]]", "expected at least 2 items"),
        ("scatter.cars.objects.1.radii_m=[1, 1, -1]", r"objects\.1\.radii_m"),
        ("scatter.cars.objects.1.label=-1", "expected an integer from 0 to 4294967295, got -1"),
        ("scatter.cars.objects.1.scale=0", "expected an invertible matrix"),
        ("scatter.cars.objects.1.scale=1.0e+10",
         r"expected an object within 1e\+09 m of its origin, got one of 2e\+10 m"),
        ("scatter.cars.objects.1.radii_m=[1.0e+300, 1, 1]", "expected an object within 1e[+]09 m of its origin"),
        ("frames=4294967296", r"scatter: expected sequences of at most 100,000 s if anything moves, got 4\.295e\+08 s"),
        ("run.sensor.pattern.rate_hz=1.0e-6", "scatter: expected sequences of at most 100,000 s if anything moves"),
    ],
)  # fmt: skip
def test_mistakes_are_named(recipe: Path, change: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        scene_and_objects(recipe, 0, change)
    assert str(caught.value).startswith((f"{recipe}:", "--set "))


def test_numbers_are_checked_as_they_are_drawn(recipe: Path) -> None:
    """A normal number may be anything: one that is no count is 0, and one out of range is an error of its sequence."""
    counts = [
        sum(
            item.group == "cars"
            for item in scene_and_objects(recipe, sequence, "scatter.cars.count={normal: [0.5, 2]}")[1]
        )
        for sequence in SEQUENCES
    ]
    assert 0 in counts
    assert max(counts) > 0
    source = load(recipe, ["scatter.cars.scale={normal: [1, 0.5]}", "sequences=200"]).source
    with pytest.raises(ConfigError, match=r"cars\.scale=.*: expected a number from 1e-09 to 1e\+09, got -"):
        [source.run(sequence) for sequence in range(200)]


@pytest.mark.parametrize(
    "change",
    [
        "scatter.cars.area_m=[[5, -5], [-5, 5]]",
        "scatter.cars.area_m=[[5, -9], [5, 9]]",
        "scatter.cars.area_m=[[-1.0e+9, -1.0e+9], [1.0e+9, 1.0e+9]]",
        "scatter.cars.speed_m_per_s=-1.0e+9",
        "scatter.cars.objects.0.size_m=[1.0e-300, 1.0e-300, 1.0e-300]",
        "run.pose.position_m=[1.0e+17, 0, 0]",
        "run.pose.position_m=[1.0e+200, 0, 0]",
        "run.scene.2.end_m=[0, 1.0e+300, 4]",
        "scatter.cars.count=0",
        "scatter.cars.yaw_deg=1.0e+9",
    ],
)
def test_unusual_places_are_places(recipe: Path, change: str) -> None:
    _, there = scene_and_objects(recipe, 1, "scatter.boxes.count=0", change)
    wanted = 0 if "count=0" in change.rpartition("boxes")[2] or "1.0e+300, 4" in change else 2
    assert len(there) >= wanted
    for item in there:
        poses = item.motion.poses.as_matrix() if isinstance(item.motion, ls.Trajectory) else item.motion
        assert np.isfinite(poses).all()


def test_outlines_that_are_points_are_apart_only_where_they_are() -> None:
    """Far off, the corners of an outline may be the same numbers, and none of its sides has a direction."""
    square = np.array([[[0.0, 0.0], [1, 0], [1, 1], [0, 1]]])
    point, here, there = (Outline(corners, 0.0, 1.0) for corners in (0 * square, square - 0.5, square + 9))
    for outline in (point, here):
        assert not outline.apart(point, 0.0)
        assert not point.apart(outline, 0.0)
    assert there.apart(point, 1.0)
    assert point.apart(there, 1.0)


@pytest.mark.slow("places do not depend on how many are tried at once")
def test_places_do_not_depend_on_how_many_are_tried_at_once(recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One at a time is what the description says: the first place that has room."""
    streets = CONFIGS / "recipes" / "street.yaml"
    cases = [(recipe, 1, ("scatter.cars.count=40",)), (recipe, 2, ("scatter.boxes.tilt=true",)), (streets, 0, ())]
    tried: list[int] = []
    monkeypatch.setattr(
        scattering, "_stand", lambda *_, of=scattering._stand, **more: tried.append(len(_[0])) or of(*_, **more)
    )
    for path, sequence, changes in cases:
        found = []
        for more in (scattering.MORE, 1):
            monkeypatch.setattr(scattering, "MORE", more)
            tried.clear()
            scene_and_objects.cache_clear()
            found.append(scene_and_objects(path, sequence, *changes)[1])
            assert (max(tried) > 1) == (more > 1)
        assert len(found[0]) > 5
        for one, other in zip(*found, strict=True):
            assert (one.group, one.index, one.scale) == (other.group, other.index, other.scale)
            assert poses_of(one).tobytes() == poses_of(other).tobytes()


def poses_of(item: Placed) -> npt.NDArray[np.float64]:
    return item.motion.poses.as_matrix() if isinstance(item.motion, ls.Trajectory) else item.motion


def test_a_group_ends_when_there_is_no_room(recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []
    monkeypatch.setattr(Way, "poses", lambda *_, of=Way.poses: tried.append(1) or of(*_))
    small = ["scatter.cars.area_m=[[4, -14], [9, -9]]", "scatter.boxes.count=0", "scatter.cars.count=10000"]
    _, there = scene_and_objects(recipe, 0, *small)
    assert 1 <= len(there) < 10
    again = scene_and_objects(recipe, 0, *small[:2], "scatter.cars.count=100")[1]
    assert [np.asarray(item.motion).tolist() for item in there] == [np.asarray(item.motion).tolist() for item in again]
    assert scattering.FULL * scattering.TRIES <= len(tried) < 200 * scattering.TRIES


PACKAGED = sorted((CONFIGS / "recipes").glob("*.yaml"))


@pytest.mark.slow("packaged recipes have all of their groups")
@pytest.mark.parametrize("path", PACKAGED, ids=lambda path: path.stem)
def test_each_group_of_each_packaged_recipe_appears(path: Path, slow: bool) -> None:
    source = load(path).source
    sequences = 1 if path.stem == "traffic" else 4 if slow else 2
    counts = sum((source.scatter_counts(sequence) for sequence in range(sequences)), Scattered())
    assert counts.groups.keys() == yaml.safe_load(path.read_text(encoding="utf-8"))["scatter"].keys()
    for name, tally in counts.groups.items():
        assert tally.placed >= 0.75 * tally.asked > 0, (name, tally)
    if path.stem == "traffic":
        assert counts.groups["green"] == counts.groups["red"] == Tally(36, 36, {})
    assert counts.near == {}
    assert [name for sequence in range(sequences) for name in source.nearby(sequence)] == []


def test_vehicles_of_packaged_recipes_tilt_on_streets() -> None:
    """Generated streets have slopes and camber."""
    tilts = {
        (path.stem, name): group.get("tilt")
        for path in PACKAGED
        for name, group in yaml.safe_load(path.read_text(encoding="utf-8"))["scatter"].items()
        if any(item.get("shape") == "vehicle" for item in group["objects"])
    }
    assert len(tilts) == 5
    assert all(tilts.values()), tilts


def lanes(tmp_path: Path, offset: float, **more: object) -> tuple[list[Placed], Scattered]:
    """Cars 4 m long and 2 m wide on two opposite lanes of a road, a wall beside it, and a sensor that drives along."""
    car = {"shape": "box", "size_m": [4, 2, 1.5], "center_m": [0, 0, 0.75]}
    road = {"on": ["road"], "objects": [car], "gap_m": 2, "speed_m_per_s": 5}
    groups = {
        "east": {**road, "count": 10, "along_m": [[-70, -offset], [70, -offset]], **more},
        "west": {**road, "count": 10, "along_m": [[70, offset], [-70, offset]], **more},
    }
    scene = [
        {"name": "road", "shape": "polygon", "vertices_m": [[-80, -9, 0], [80, -9, 0], [80, 9, 0], [-80, 9, 0]]},
        {"name": "wall", "shape": "box", "size_m": [20, 1, 2], "center_m": [0, 6, 1]},
    ]
    run = {
        "scene": scene,
        "sensor": {"preset": "velodyne-vlp16"},
        "pose": {"position_m": [-30, 5, 1.5], "linear_m_per_s": [20, 0, 0]},
    }
    path = tmp_path / "lanes.yaml"
    path.write_text(yaml.safe_dump({"layout": "shards", "frames": 20, "scatter": groups, "run": run}))
    source = load(path).source
    assert isinstance(source, Document)
    source.run(0)
    return source.scatter(0)[0], source.scatter_counts(0)


def test_gaps_count_along_the_way_between_lanes(tmp_path: Path) -> None:
    """Lanes 2.5 m apart leave half a metre between cars that pass each other; in a lane they are 2 m apart."""
    placed, counts = lanes(tmp_path, 1.25)
    assert counts.groups == {"east": Tally(10, 10, {}), "west": Tally(10, 10, {})}
    for name in counts.groups:
        starts = np.sort([poses_of(item)[0, 0, 3] for item in placed if item.group == name])
        # Coordinates below 128 are rounded by 2⁻⁴⁷, and a box of four corners and two poses by a few of these.
        assert np.diff(starts).min() >= 6 - 16 * 2.0**-47
    meets = [
        np.abs(poses_of(one)[:, 0, 3] - poses_of(other)[:, 0, 3]).min()
        for one, other in combinations(placed, 2)
        if one.group != other.group
    ]
    assert min(meets) < 4  # or nothing was tested


def test_what_refuses_places_is_told(tmp_path: Path) -> None:
    assert lanes(tmp_path, 0.9)[1].groups["west"].refused.keys() == {"gap to east"}
    off_road = lanes(tmp_path, 8.5)[1]
    assert off_road.groups["east"].placed == 0
    assert off_road.groups["east"].refused.keys() == {"no room on road"}
    assert lanes(tmp_path, 6, speed_m_per_s=0, count=40)[1].groups["west"].refused.keys() == {
        "gap to west",
        "meets wall of the scene",
    }
    near = lanes(tmp_path, 5, clear_m=30)[1].groups["west"]
    assert "clear of the sensor" in near.refused
    assert near.rules.count("%") == len(near.refused)


def test_pruned_trees_leave_room(tmp_path: Path) -> None:
    scene = [
        {"shape": "plane", "normal": [0, 0, 1], "name": "floor"},
        {"shape": "tree", "kind": "broadleaf", "height_m": 6, "clearance_m": 8},
    ]
    boxes = {
        "objects": [{"shape": "box", "size_m": [1, 1, 1], "center_m": [0, 0, 0.5]}],
        "on": ["floor"],
        "count": 3,
        "area_m": [[-20, -20], [20, 20]],
        "clear_m": 2,
    }
    run = {"scene": scene, "sensor": {"preset": "velodyne-vlp16"}, "pose": {"position_m": [-9, 9, 1]}}
    path = tmp_path / "recipe.yaml"
    path.write_text(yaml.safe_dump({"layout": "shards", "frames": 1, "scatter": {"boxes": boxes}, "run": run}))
    source = load(path).source
    assert isinstance(source, Document)
    assert source.scatter_counts(0).groups == {"boxes": Tally(3, 3, {})}


def test_a_tilted_object_leaves_the_room_beside_it(tmp_path: Path) -> None:
    """A beam askew, and boxes in a square that is within its bounds but beside it."""
    beam = {"shape": "box", "size_m": [12, 1, 1], "rotation_deg": {"yaw": 45, "pitch": 3}}
    boxes = {
        "objects": [{"shape": "box", "size_m": [0.4, 0.4, 1], "center_m": [0, 0, 0.5]}],
        "on": ["floor"],
        "count": 6,
        "area_m": [[0, -3], [3, 0]],
        "yaw_deg": {"uniform": [0, 360]},
    }
    scene = [{"shape": "plane", "normal": [0, 0, 1], "name": "floor"}, beam]
    run = {"scene": scene, "sensor": {"preset": "velodyne-vlp16"}, "pose": {"position_m": [-9, 9, 1]}}
    path = tmp_path / "recipe.yaml"
    path.write_text(yaml.safe_dump({"layout": "shards", "frames": 1, "scatter": {"boxes": boxes}, "run": run}))
    _, there = scene_and_objects(path, 0)
    assert len(there) == 6
    rim = 0.2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for item in there:
        pose = poses_of(item)
        x, y = (rim @ pose[:2, :2].T + pose[:2, 3]).T
        assert (x - y >= np.sqrt(0.5)).all()  # half a metre to the right of the middle of the beam


def test_the_outline_of_a_tilted_object_is_the_upright_box_around_it() -> None:
    generator = np.random.default_rng(3)
    corners = np.array(list(np.ndindex(2, 2, 2))) * (4, 2, 1) - (1, 1, 0)
    smaller = 0
    for _ in range(100):
        place = np.eye(4)
        angles = generator.uniform(-1, 1, 3) * (180, 30, 30)
        place[:3, :3] = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
        place[:3, 3] = generator.uniform(-9, 9, 3)
        scene = ls.Scene()
        scene.add(ls.Box([4, 2, 1], [1, 0, 0.5]), transform=place)
        outline = scattering._obstacle(scene[0], np.array([0.0, 1.0]))
        points, plan = corners @ place[:3, :3].T + place[:3, 3], outline.corners[0]
        sides = np.diff(plan[:3], axis=0)
        lengths = np.linalg.norm(sides, axis=1)
        # Fewer than 32 roundings of coordinates below 16, of half an ulp each.
        rounded = 32 * 2.0**-50
        assert abs(sides[0] @ sides[1]) < rounded * lengths.sum()
        for axis in sides / lengths[:, None]:
            extents = [(along.min(), along.max()) for along in (points[:, :2] @ axis, plan @ axis)]
            np.testing.assert_allclose(*extents, rtol=0, atol=rounded)
        heights = points[:, 2].min(), points[:, 2].max()
        np.testing.assert_allclose((outline.low, outline.high), heights, rtol=0, atol=rounded)
        smaller += lengths.prod() < 0.8 * np.diff(scene[0].bounds[:, :2], axis=0).prod()
    assert smaller > 30


def test_the_outline_of_a_tilted_speck_is_where_it_is() -> None:
    place = np.eye(4)
    place[:3, :3] = 1e-323 * Rotation.from_euler("ZYX", [30, 40, 50], degrees=True).as_matrix()
    place[:3, 3] = 5, 6, 7
    scene = ls.Scene()
    scene.add(ls.Box([1, 1, 1]), transform=place)
    outline = scattering._obstacle(scene[0], np.array([0.0, 1.0]))
    # A turn there and back: four products and two sums of numbers below 16, and the rounding of its matrix.
    np.testing.assert_allclose(outline.corners, np.full((1, 4, 2), (5.0, 6.0)), rtol=0, atol=8 * 2.0**-50)


def test_empty_shapes_are_no_obstacles() -> None:
    scene = ls.Scene()
    scene.add(ls.Disks(np.zeros((0, 3)), np.zeros((0, 3)), 1.0))
    scene.add(ls.Plane((0, 0, 1), 0.0))
    scene.add(ls.Sphere((0, 0, 0), 1.0))
    assert [scattering._is_solid(item) for item in scene] == [False, False, True]


def test_the_sensor_keeps_clear_of_the_scene_or_it_is_told(tmp_path: Path) -> None:
    assert lanes(tmp_path, 1.25, clear_m=0.4)[1].near == {}
    counts = lanes(tmp_path, 1.25, clear_m=0.6)[1]
    assert counts.near == {"wall": 1}
    assert counts.lines() == ["the sensor comes nearer to wall, of the scene, than clear_m in 1 of 1 sequence"]


def test_what_the_sensor_passes_through_is_told_without_a_clearance(tmp_path: Path) -> None:
    lanes(tmp_path, 1.25)
    path = tmp_path / "lanes.yaml"
    assert load(path).source.nearby(0) == {}
    ((name, moment),) = load(path, ["run.scene.1.center_m=[0, 5, 1]"]).source.nearby(0).items()
    assert name == "wall"
    assert 1.0 - STEP <= moment <= 1.0  # the wall begins 20 m ahead, at 20 m/s
