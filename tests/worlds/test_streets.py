"""Streets: complete, reproducible, of bounded size, with ways that stay on the road and meet."""

from __future__ import annotations

import copy
import gc
import pickle
import re
import tracemalloc
from collections import Counter
from collections.abc import Callable
from functools import lru_cache
from itertools import combinations, product
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest

import lidarsim as ls
from lidarsim.worlds import _labels as labels
from lidarsim.worlds.streets import STREETS, Plan, StreetKind
from lidarsim.worlds.vehicles import VEHICLES

Floats = npt.NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -1.0])


street = lru_cache(maxsize=32)(ls.worlds.street)
"""Streets of 12 MB each, shared by tests that do not change them."""


@pytest.fixture(scope="module", params=STREETS)
def world(request: pytest.FixtureRequest) -> ls.worlds.Street:
    return street(5, request.param, length=160.0)


@pytest.fixture(scope="module")
def town() -> ls.worlds.Street:
    """A street with junctions of both kinds."""
    return street(3, "residential")


def ground(world: ls.worlds.Street) -> ls.Scene:
    scene = ls.Scene()
    for name in ls.worlds.GROUND:
        for number in world.scene.find(name):
            item = world.scene[number]
            scene.add(item.shape, name=name, label=item.label)
    return scene


def under(scene: ls.Scene, points: Floats) -> tuple[Floats, list[str]]:
    """Height of the ground under points, and the name of what is there."""
    hits = scene.cast(points * (1, 1, 0) + (0, 0, 500), np.broadcast_to(DOWN, points.shape))
    names = [scene[number].name if number >= 0 else "" for number in hits.object_id.tolist()]
    return 500 - hits.t, names


def contents(world: ls.worlds.Street) -> list[Any]:
    found: list[Any] = [line.tobytes() for lines in vars(world.ways).values() for line in lines]
    for item in world.scene:
        points = item.shape._tessellate(None, np.zeros((8, 3)))[0].tobytes()
        place = None if item.transform is None else item.transform.tobytes()
        bright = np.asarray(item.material.reflectivity).tobytes()
        found.append((item.name, item.instance, np.asarray(item.label).tobytes(), points, place, bright))
    return found


@pytest.mark.parametrize("kind", STREETS)
def test_the_same_seed_gives_the_same_bits(kind: StreetKind) -> None:
    first, again, other = (contents(ls.worlds.street(seed, kind, length=60.0)) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_all_objects_have_classes_and_things_are_instances(world: ls.worlds.Street) -> None:
    assert set(world.scene.class_names) >= {10, 30, 40, 48, 50, 70, 71, 72, 80, 81}
    parts: dict[int, set[str]] = {}
    for item in world.scene:
        assert set(np.unique(item.label).tolist()) <= set(world.scene.class_names)
        parts.setdefault(item.instance, set()).add(item.name.split("/")[0])
    assert all(len(names) == 1 for names in parts.values())
    assert len(parts) > 50


def test_the_ground_has_no_gaps(world: ls.worlds.Street) -> None:
    rng = np.random.default_rng(0)
    s = rng.uniform(-75, 75, 4000)
    points = np.column_stack([s, rng.uniform(-40, 40, 4000), np.zeros(4000)])
    scene = ground(world)
    heights, names = under(scene, points)
    assert np.isfinite(heights).all()
    assert {"road", "terrain"} <= set(names)
    edges = np.concatenate([item.shape.vertices for item in scene if isinstance(item.shape, ls.TriangleMesh)])
    inside = edges[(np.abs(edges[:, :2]) < (75, 40)).all(axis=1)]
    assert np.isfinite(under(scene, inside)[0]).all()


def test_tiles_of_the_ground_are_one_instance_of_each_kind(town: ls.worlds.Street) -> None:
    """No tile is long or, but for the road, on both sides of the street."""
    kinds = {item.name: item.instance for item in town.scene if item.name in ls.worlds.GROUND}
    assert len(kinds) > 3
    assert len({*kinds.values()}) == len(kinds)
    for item in town.scene:
        assert (item.name in kinds) == (item.instance in kinds.values())
        assert kinds.get(item.name, item.instance) == item.instance
    right, left = (lane[:, None, :2] for lane in town.ways.lanes[:2])
    for item in town.scene:
        if item.name in kinds:
            assert np.ptp(item.bounds[:, 0]) < 100.0
            corners = cast("ls.TriangleMesh", item.shape).vertices[::20, :2]
            corners = corners[np.abs(corners[:, 0]) < 130.0]  # beside the lanes
            to_left, to_right = (np.linalg.norm(corners - lane, axis=2).min(axis=0) for lane in (left, right))
            is_left = to_left < to_right
            assert item.name == "road" or is_left.all() or not is_left.any()


def test_each_ground_has_its_reflectivity_and_roads_are_painted(world: ls.worlds.Street) -> None:
    usual = {"road": (0.2, 0.34), "parking": (0.2, 0.34), "sidewalk": (0.26, 0.4), "terrain": (0.4, 0.55)}
    paint = ls.materials.ROAD_PAINT_WORN.reflectivity
    for name, (least, most) in usual.items():
        for number in world.scene.find(name):
            material = world.scene[number].material
            assert material.per == "face"
            values, counts = np.unique(material.reflectivity, return_counts=True)
            assert least < values[counts.argmax()] < most, name
            assert (paint in values) == (name == "road")


def test_rural_roads_have_lines_along_their_edges() -> None:
    """Outside of both lanes, away from the junction, what is painted is two lines of 12 cm."""
    world = street(5, "rural", length=160.0)
    found = []
    for number in world.scene.find("road"):
        mesh, material = world.scene[number].shape, world.scene[number].material
        assert isinstance(mesh, ls.TriangleMesh)
        found.append(mesh.vertices[mesh.faces[material.reflectivity == ls.materials.ROAD_PAINT_WORN.reflectivity]])
    painted = np.concatenate(found)
    middles = painted.mean(axis=1)
    there, back = (np.linalg.norm(middles[:, None, :2] - lane[:, :2], axis=2).min(axis=1) for lane in world.ways.lanes)
    turns = np.concatenate(world.ways.turns)
    side_road = turns[np.abs(turns[:, 1]).argmax(), 0]
    stretches = [(-75.0, side_road - 15.0), (side_road + 15.0, 75.0)]
    x, aside = middles[:, 0], np.abs(there - back) > 2.0
    area = 0.5 * np.linalg.norm(np.cross(*np.diff(painted, axis=1).swapaxes(0, 1)), axis=1)
    for start, stop in stretches:
        assert stop - start > 20.0
        assert area[aside & (start < x) & (x < stop)].sum() == pytest.approx(2 * (stop - start) * 0.12, rel=0.1)


@pytest.mark.parametrize("kind", sorted({*STREETS} - {"rural"}))
def test_kerbs_do_not_slope_over_the_roadway(kind: StreetKind) -> None:
    """Nor do those of round corners."""
    steep = []
    for seed in range(3):
        world = street(seed, kind, length=200.0)
        for name in ("road", "parking"):
            for number in world.scene.find(name):
                mesh = world.scene[number].shape
                assert isinstance(mesh, ls.TriangleMesh)
                x, y, z = np.cross(*np.diff(mesh.vertices[mesh.faces], axis=1).swapaxes(0, 1)).T
                steep.append(np.hypot(x, y) > 0.12 * np.abs(z))
    of_faces = np.concatenate(steep)
    assert len(of_faces) > 30_000
    assert not of_faces.any()


@pytest.mark.parametrize("kind", sorted({*STREETS} - {"rural"}))
def test_kerbs_of_side_roads_are_steep_and_round(kind: StreetKind) -> None:
    """They rise by over 10 cm within 5 cm, along the road and in the middle of an arc of 5 m at its corners."""
    count = 0
    for seed in (0, 11):
        scene = ground(street(seed, kind, length=160.0))
        plan = Plan.draw(np.random.default_rng(seed), kind, 160.0)
        for junction in plan.junctions:
            for side, way in product(junction.sides, (1, -1)):
                beside = junction.half + np.array([-0.01, 0.04])
                from_centre = 5.0 - (5.0 - np.array([-0.01, 0.04])) / np.sqrt(2.0)
                for s, d in (
                    (beside, np.full(2, plan.sides[side].kerb + 15.0)),
                    (junction.half + from_centre, plan.sides[side].kerb + from_centre),
                ):
                    low, high = under(scene, plan.at(junction.s + way * s, side * d))[0]
                    assert high - low > 0.1, f"seed {seed}, {junction}, side {side}, {way}"
                    count += 1
    assert count > 8


def test_no_bush_reaches_into_a_roadway() -> None:
    count = 0
    for seed in range(8):
        world = street(seed, "rural", length=160.0)
        scene = ground(world)
        for number in world.scene.find("bush/leaves"):
            item = world.scene[number]
            assert isinstance(item.shape, ls.TriangleMesh)
            assert item.transform is not None
            leaves = item.shape.vertices @ item.transform[:3, :3].T + item.transform[:3, 3]
            assert "road" not in under(scene, leaves)[1], f"seed {seed}, object {number}"
            count += 1
    assert count > 500


def test_lanes_are_on_the_road_and_pavements_on_the_pavement(world: ls.worlds.Street) -> None:
    scene = ground(world)
    wanted = {
        "lanes": {"road"},
        "turns": {"road"},
        "pavements": {"sidewalk", "other-ground", *(["terrain"] if len(world.scene.find("sidewalk")) == 0 else [])},
        "crossings": {"road", "parking", "sidewalk", "other-ground", "terrain"},
    }
    for kind, lines in vars(world.ways).items():
        for line in lines:
            heights, names = under(scene, line)
            assert set(names) <= wanted[kind]
            assert np.abs(heights - line[:, 2]).max() < 0.1
            assert np.linalg.norm(np.diff(line, axis=0), axis=1).max() < 1.3


def test_turns_leave_one_lane_and_end_in_another(town: ls.worlds.Street) -> None:
    assert len(town.ways.turns) >= 8
    lanes = np.concatenate([lane[:, :2] for lane in town.ways.lanes])
    for turn in town.ways.turns:
        for end in (turn[0], turn[-1]):
            # Side roads of T junctions have no lane that goes straight on; turns alone lead there.
            near = np.linalg.norm(lanes - end[:2], axis=1).min()
            assert near < 0.6 or abs(end[1]) > 40.0
        sides = np.diff(turn[:, :2], axis=0)
        steps = np.diff(np.unwrap(np.arctan2(sides[:, 1], sides[:, 0])))
        assert 1.2 < abs(steps.sum()) < 2.0
        assert np.abs(steps).max() < 0.35


def test_traffic_keeps_to_the_right(town: ls.worlds.Street) -> None:
    there, back = town.ways.lanes[:2]
    assert there[-1, 0] > there[0, 0]
    middle = len(there) // 2
    nearest = back[np.linalg.norm(back[:, :2] - there[middle, :2], axis=1).argmin()]
    ahead = there[middle + 1] - there[middle]
    left = np.cross(ahead, nearest - there[middle])[2]
    assert left > 0


def test_nothing_stands_in_the_lanes(world: ls.worlds.Street) -> None:
    """A car 2 m wide and 1.5 m high meets nothing."""
    scene = ls.Scene()
    names = []
    for item in world.scene:
        if item.name not in ls.worlds.GROUND:
            scene.add(item.shape, transform=item.transform)
            names.append(item.name)
    for lane in (*world.ways.lanes, *world.ways.turns):
        ahead = np.diff(lane, axis=0)
        left = np.column_stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))])
        left /= np.linalg.norm(left, axis=1, keepdims=True)
        for across in (-1.0, 0.0, 1.0):
            for high in (0.4, 1.0, 1.5):
                hits = scene.cast(lane[:-1] + across * left + (0, 0, high), ahead, t_max=1.0)
                assert not hits.hit.any(), names[hits.object_id[hits.hit][0]]
    street = world.ways.lanes[0]
    beside = [street[:-1] + np.array([0, y, 0.4]) for y in np.arange(-12.0, -2.0, 0.5)]
    assert any(scene.cast(points, np.diff(street, axis=0), t_max=1.0).hit.any() for points in beside)


@pytest.mark.parametrize("kind", sorted({*STREETS} - {"rural"}))
def test_parked_vehicles_stand_on_all_wheels(kind: StreetKind) -> None:
    world = street(5, kind, length=160.0)
    lowest, level = [], 0
    for item in world.scene:
        if "/wheel" in item.name:
            assert isinstance(item.shape, ls.TriangleMesh)
            assert item.transform is not None
            placed = item.shape.vertices @ item.transform[:3, :3].T + item.transform[:3, 3]
            lowest.append(placed[placed[:, 2].argmin()])
            level += item.transform[2, 2] > np.cos(0.01)
    heights, _ = under(ground(world), np.array(lowest))
    # The grade changes by at most 3 · 0.012 · 0.03 per metre. So the ground leaves its tangent by 1.9 mm in half a
    # wheelbase of 3.7 m, and a face 1.5 m long is 0.3 mm off.
    assert np.abs(np.array(lowest)[:, 2] - heights).max() < 0.0022
    assert len(lowest) > 20
    assert level == 0  # the camber alone is 0.025


def places(scene: ls.Scene, name: str) -> Floats:
    """Where objects of a name are placed, (k, 3)."""
    return np.array([scene[number].transform for number in scene.find(name)])[:, :3, 3]


def test_cables_hang_over_city_streets_and_people_sit_on_benches() -> None:
    world = street(0, "city")
    cables = [world.scene[number].bounds for number in world.scene.find("cable/cable")]
    assert len(cables) > 2
    road = np.concatenate(world.ways.lanes)
    for low, high in cables:
        below = road[np.linalg.norm(road[:, :2] - (low + high)[:2] / 2, axis=1).argmin()]
        assert np.linalg.norm(below - (low + high) / 2) < 10.0
        assert low[2] > below[2] + 4.5
    benches, people = places(world.scene, "bench/bench"), places(world.scene, "person/torso")
    apart = np.linalg.norm(benches[:, None, :2] - people[:, :2], axis=-1).min(axis=1)
    assert 0 < np.count_nonzero(apart < 0.1) < len(benches)


def footprints(world: ls.worlds.Street) -> list[tuple[Floats, Floats]]:
    """The place of each building, and a rectangle around the feet of its walls, in its axes: x and y, low and high."""
    found: dict[int, tuple[Floats, Floats]] = {}
    for item in world.scene:
        if item.name.startswith("building/") and isinstance(item.shape, ls.TriangleMesh):
            assert item.transform is not None
            feet = item.shape.vertices[item.shape.vertices[:, 2] == 0.0, :2]
            if len(feet):
                found[item.instance] = item.transform, np.array([feet.min(axis=0), feet.max(axis=0)])
    return [*found.values()]


@pytest.mark.parametrize("kind", STREETS)
def test_no_plant_grows_in_a_building(kind: StreetKind) -> None:
    counts = Counter[str]()
    for seed in range(3):
        world = street(seed, kind, length=200.0)
        buildings = footprints(world)
        counts["building"] += len(buildings)
        for item in world.scene:
            name, _, part = item.name.partition("/")
            if part == "trunk" or (part == "leaves" and name in {"bush", "grass", "hedge", "bed"}):
                points = cast("ls.TriangleMesh", item.shape).vertices if part == "trunk" else np.zeros((1, 3))
                assert item.transform is not None
                placed = points @ item.transform[:3, :3].T + item.transform[:3, 3]
                for place, (low, high) in buildings:
                    at = (placed[:, :2] - place[:2, 3]) @ place[:2, :2]
                    assert not ((low < at) & (at < high)).all(axis=1).any(), f"{item.name}, seed {seed}"
                counts[part] += 1
    assert min(counts[what] for what in ("building", "trunk", "leaves")) > 10


def test_no_furniture_stands_in_a_road() -> None:
    counts = Counter[str]()
    for seed in range(6):
        world = street(seed, "city", length=200.0)
        scene = ground(world)
        for name in ("traffic_light", "lamp", "bollard", "bench", "bin", "sign"):
            posts = [
                number for number in world.scene.find(f"{name}/{name}") if world.scene[number].transform is not None
            ]
            at = np.array([world.scene[number].transform for number in posts]).reshape(-1, 4, 4)[:, :3, 3]
            if len(at):
                assert "road" not in under(scene, at)[1], f"{name}, seed {seed}"
            counts[name] += len(at)
    assert min(counts.values()) > 5


def test_crossings_end_before_buildings() -> None:
    count = 0
    for seed in range(6):
        world = street(seed, "city", length=200.0)
        for line in world.ways.crossings:
            hits = world.scene.cast(line[:-1] + np.array([0.0, 0.0, 1.0]), np.diff(line, axis=0), t_max=1.0)
            names = [world.scene[int(number)].name for number in hits.object_id[hits.hit]]
            assert not any(name.startswith("building") for name in names), f"seed {seed}"
            count += 1
    assert count > 20


def test_traffic_lights_and_signs_face_the_traffic_on_their_side() -> None:
    seen = 0
    for seed in range(4):
        world = street(seed, "city", length=200.0)
        lanes = [lane for lane in world.ways.lanes if np.ptp(lane[:, 0]) > 150.0]
        for number in (*world.scene.find("traffic_light/traffic_light"), *world.scene.find("sign/sign")):
            place = world.scene[number].transform
            assert place is not None
            away = [np.linalg.norm(lane[:, :2] - place[:2, 3], axis=1) for lane in lanes]
            nearest = min(range(len(lanes)), key=lambda k: away[k].min())
            at = min(int(away[nearest].argmin()), len(lanes[nearest]) - 2)
            ahead = lanes[nearest][at + 1, :2] - lanes[nearest][at, :2]
            if abs(place[:2, 0] @ ahead) > 0.5 * np.linalg.norm(ahead):  # not one at a side road
                assert place[:2, 0] @ ahead < 0, f"seed {seed}"
                seen += 1
    assert seen > 20


@pytest.mark.parametrize("kind", STREETS)
def test_no_building_floats(kind: StreetKind) -> None:
    for seed in (0, 9):
        world = street(seed, kind)
        scene = ground(world)
        for place, (low, high) in footprints(world):
            x, y = np.meshgrid(*np.linspace(low, high, 5).T)
            feet = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) @ place[:3, :3].T + place[:3, 3]
            heights, _ = under(scene, feet)
            assert (feet[:, 2] < heights + 0.02)[np.isfinite(heights)].all(), f"seed {seed}"


def edges(item: ls.scene.SceneObject) -> Floats:
    """Edges of the triangles of an object, from where to where, (k, 2, 3)."""
    vertices, faces = item.shape._tessellate(None, np.zeros((8, 3)))
    assert item.transform is not None
    placed = np.asarray(vertices) @ item.transform[:3, :3].T + item.transform[:3, 3]
    return placed[np.asarray(faces)[:, [(0, 1), (1, 2), (2, 0)]]].reshape(-1, 2, 3)


@pytest.mark.parametrize("seed", [1, 7])
def test_furniture_and_people_are_in_nothing(seed: int) -> None:
    """No edge of a thing meets a surface of another, but of someone and the bench below."""
    loose = {"lamp", "sign", "traffic_light", "bin", "bench", "bollard", "person"}
    world = street(seed, "city", length=200.0)
    things: dict[int, list[ls.scene.SceneObject]] = {}
    for item in world.scene:
        name, _, part = item.name.partition("/")
        if name in loose | set(VEHICLES) or part == "trunk":
            things.setdefault(item.instance, []).append(item)
    solids = []
    for items in things.values():
        solid = ls.Scene()
        for item in items:
            solid.add(item.shape, transform=item.transform)
        solids.append((items[0].name.split("/")[0], solid, np.concatenate([edges(item) for item in items])))
    low, high = np.array([solid.bounds for _, solid, _ in solids]).transpose(1, 0, 2)
    near = ((low[:, None] < high) & (high[:, None] > low)).all(axis=-1)
    pairs = 0
    for first, second in np.argwhere(near & ~np.eye(len(near), dtype=bool)).tolist():
        (name, solid, _), (other, _, lines) = solids[first], solids[second]
        if not {name, other} & loose or {name, other} == {"bench", "person"}:
            continue
        ahead = lines[:, 1] - lines[:, 0]
        there = ahead.any(axis=1)
        assert not solid.cast(lines[there, 0], ahead[there], t_max=1.0).hit.any(), f"{name}, {other}"
        pairs += 1
    assert len(solids) > 100
    assert pairs > 0


def test_nobody_pushes_a_pram_into_a_wall() -> None:
    world = ls.worlds.street(22, "residential", length=1000.0)
    walls, people = ls.Scene(), []
    for item in world.scene:
        if item.name in {"wall/wall", "fence/fence"}:
            walls.add(item.shape, transform=item.transform)
        elif item.name == "person/pram":
            people.append(edges(item))
    assert len(walls) > 50
    assert len(people) > 1
    lines = np.concatenate(people)
    assert not walls.cast(lines[:, 0], lines[:, 1] - lines[:, 0], t_max=1.0).hit.any()


def overlap(first: Floats, second: Floats) -> float:
    """How far two rectangles, (4, 2), overlap along the side along which they do so least, m; negative if apart."""
    depths = []
    for corners in (first, second):
        for axis in corners[1:3] - corners[:2]:
            a, b = (points @ axis / np.linalg.norm(axis) for points in (first, second))
            depths.append(min(a.max(), b.max()) - max(a.min(), b.min()))
    return float(min(depths))


@pytest.mark.parametrize(("turn", "apart"), [(0.0, 1.0), (45.0, 0.5 + np.sqrt(0.5))])
def test_rectangles_overlap_by_the_least_way_out(turn: float, apart: float) -> None:
    square = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    cosine, sine = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    turned = square @ np.array([[cosine, sine], [-sine, cosine]])
    rounding = 64 * 2.0**-53  # fewer than 32 roundings of numbers below 2, half an ulp each
    for depth in (0.1, -0.1):
        assert overlap(square, turned + np.array([apart - depth, 0.05])) == pytest.approx(depth, abs=rounding)


@pytest.mark.parametrize("kind", STREETS)
def test_buildings_do_not_overlap_each_other(kind: StreetKind) -> None:
    pairs = 0
    for seed in range(4):
        rectangles = []
        for place, ((left, near), (right, far)) in footprints(street(seed, kind)):
            corners = np.array([(left, near), (right, near), (right, far), (left, far)])
            rectangles.append(corners @ place[:2, :2].T + place[:2, 3])
        for first, second in combinations(rectangles, 2):
            if np.linalg.norm(first.mean(axis=0) - second.mean(axis=0)) < 40.0:
                assert overlap(first, second) < 0.0, f"seed {seed}"
                pairs += 1
    assert pairs > 0


def test_copies_share_their_shapes(town: ls.worlds.Street) -> None:
    shapes = [id(item.shape) for item in town.scene]
    assert len(set(shapes)) < 0.6 * len(shapes)
    assert copy.copy(town.scene)[5].shape is town.scene[5].shape


def test_a_street_takes_little_memory() -> None:
    gc.collect()
    tracemalloc.start()
    world = ls.worlds.street(3, "residential")
    size = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert size < 150e6
    assert len(pickle.dumps(world.scene)) < 60e6
    triangles = {id(item.shape): len(cast("Any", item.shape)) for item in world.scene if hasattr(item.shape, "__len__")}
    disks = {id(item.shape): len(item.shape.radii) for item in world.scene if isinstance(item.shape, ls.Disks)}
    assert sum(triangles.values()) * 150 + sum(disks.values()) * 80 < 100e6


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ls.worlds.street(0, cast("Any", "motorway")), "kind: expected 'residential'"),
        (lambda: ls.worlds.street(-1), "seed: expected an integer from 0 to 18446744073709551615, got -1"),
        (lambda: ls.worlds.street(0, length=10.0), "length: expected a finite number from 60 to 1000, got 10.0"),
    ],
)
def test_bad_arguments_are_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        call()
    assert labels.CLASS_NAMES[40] == "road"
