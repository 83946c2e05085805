"""What holds of every generator: pure functions, closed surfaces, classes, sizes."""

from __future__ import annotations

import functools
import re
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest

import lidarsim as ls
from lidarsim.viewers._classes import SEMANTIC_KITTI
from lidarsim.worlds import _labels as labels
from lidarsim.worlds import _walker
from lidarsim.worlds.buildings import BUILDINGS
from lidarsim.worlds.furnishings import FURNITURE
from lidarsim.worlds.pedestrians import LOADS, POSTURES
from lidarsim.worlds.plants import HABITS, TREES
from lidarsim.worlds.vehicles import LABELS, SIZES, VEHICLES

Floats = npt.NDArray[np.float64]
Make = Callable[[np.random.Generator], ls.worlds.Asset]


def generators() -> Iterator[tuple[str, Make]]:
    for kind in VEHICLES:
        yield kind, partial(ls.worlds.vehicle, kind)
    for load in LOADS:
        yield load, partial(ls.worlds.pedestrian, load=load, posture="walking")
    for posture in POSTURES:
        yield posture, partial(ls.worlds.pedestrian, load="nothing", posture=posture)
    for tree in TREES:
        yield tree, partial(ls.worlds.tree, tree)
    for building in BUILDINGS:
        yield building, partial(ls.worlds.building, building)
    for furniture in FURNITURE:
        yield furniture, partial(ls.worlds.furniture, furniture)


GENERATORS = dict(generators())


def contents(asset: ls.worlds.Asset) -> list[Any]:
    """Everything that a scan may see of an asset, as bytes and numbers."""
    found: list[Any] = []
    for part in asset.parts:
        place = None if part.transform is None else part.transform.tobytes()
        points = part.shape._tessellate(None, np.zeros((8, 3)))[0].tobytes()
        looks = [np.asarray(value).tobytes() for value in part.material._contents().values() if value is not None]
        found.append((part.name, type(part.shape), points, place, np.asarray(part.label).tobytes(), *looks))
    return found


def surfaces(asset: ls.worlds.Asset) -> dict[str, tuple[Floats, npt.NDArray[np.int64]]]:
    """Vertices and faces of the meshes but shrubs; glass closes the body that it is part of."""
    found: dict[str, tuple[Floats, npt.NDArray[np.int64]]] = {}
    for part in asset.parts:
        if isinstance(part.shape, ls.TriangleMesh) and part.name != "leaves":
            name = part.name.removesuffix(" glass")
            vertices, faces = found.get(name, (np.empty((0, 3)), np.empty((0, 3), np.int64)))
            own = part.shape.faces.astype(np.int64) + len(vertices)
            found[name] = np.concatenate([vertices, part.shape.vertices]), np.concatenate([faces, own])
    return found


def open_edges(vertices: Floats, faces: npt.NDArray[np.int64]) -> int:
    """Number of edges that are not passed once in each direction for each surface that they are part of."""
    number = np.unique(vertices + 0.0, axis=0, return_inverse=True)[1].ravel()
    corners = number[faces]
    edges = Counter(map(tuple, np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]).tolist()))
    return sum(count != edges[end, start] for (start, end), count in edges.items() if start != end)


def volume(vertices: Floats, faces: npt.NDArray[np.int64]) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("name", GENERATORS)
def test_the_same_generator_gives_the_same_bits(name: str) -> None:
    first, again, other = (contents(GENERATORS[name](np.random.default_rng(seed))) for seed in (1, 1, 2))
    assert first == again
    assert first != other


@pytest.mark.parametrize("name", GENERATORS)
def test_surfaces_are_closed(name: str) -> None:
    for seed in range(5):
        asset = GENERATORS[name](np.random.default_rng(seed))
        meshes = surfaces(asset)
        assert meshes or name in {"hedge", "bed", "bush", "grass"}
        for vertices, faces in meshes.values():
            assert open_edges(vertices, faces) == 0
            assert volume(vertices, faces) > 0


def test_an_open_surface_would_be_found() -> None:
    vertices, faces = surfaces(ls.worlds.vehicle("suv", np.random.default_rng(0)))["body"]
    assert open_edges(vertices, faces[1:]) == 3


@pytest.mark.parametrize("name", GENERATORS)
def test_an_asset_is_one_instance_with_feet_or_wheels_on_the_ground(name: str) -> None:
    asset = GENERATORS[name](np.random.default_rng(4))
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -9.0))
    ids = asset.add_to(scene, name="it")
    assert {scene[number].instance for number in ids} == {2}
    assert len(ids) == len(asset.parts)
    known = set(labels.CLASS_NAMES)
    assert all(set(np.unique(part.label).tolist()) <= known for part in asset.parts)
    assert name == "cable" or asset.bounds[0, 2] == pytest.approx(0.0, abs=0.02)
    assert (scene.bounds[0] <= asset.bounds[0] + 1e-9).all()
    assert (scene.bounds[1] >= asset.bounds[1] - 1e-9).all()
    moved = np.eye(4)
    moved[:3, 3] = 3.0, 4.0, 5.0
    again = asset.add_to(scene, transform=moved, instance=7, label=99)
    assert {(scene[number].instance, scene[number].label) for number in again} == {(7, 99)}
    for before, after in zip(ids, again, strict=True):
        assert np.abs(scene[after].bounds - scene[before].bounds - moved[:3, 3]).max() < 1e-9
    assert all(scene[a].shape is scene[b].shape for a, b in zip(ids, again, strict=True))


@pytest.mark.parametrize("kind", VEHICLES)
def test_vehicles_are_as_large_as_real_models(kind: Any) -> None:
    size = SIZES[kind]
    spans = np.array([size.length, size.width, size.height])
    for seed in range(20):
        found = np.diff(ls.worlds.vehicle(kind, np.random.default_rng(seed), rider=False).bounds, axis=0)[0]
        assert (found >= spans[:, 0] - 0.03).all()
        assert (found <= spans[:, 1] + 0.03).all()


@pytest.mark.parametrize("kind", VEHICLES)
def test_vehicles_have_their_classes(kind: Any) -> None:
    assert {part.label for part in ls.worlds.vehicle(kind, np.random.default_rng(0), rider=False).parts} == {
        LABELS[kind]
    }
    ridden = {"bicycle": labels.BICYCLIST, "motorcycle": labels.MOTORCYCLIST}.get(kind, LABELS[kind])
    assert {part.label for part in ls.worlds.vehicle(kind, np.random.default_rng(0)).parts} == {ridden}


def test_light_passes_the_windows_of_a_car_but_not_its_doors() -> None:
    scene = ls.Scene()
    ls.worlds.vehicle("saloon", np.random.default_rng(0)).add_to(scene)
    through = ls.Lidar(ls.patterns.Table([(0, -1, 0)], rate=10.0), measurement=ls.Measurement(depth=8, returns="last"))
    low, high = (
        through.scan(scene, ls.worlds._asset.translation(-0.1, 5.0, z)).point_cloud(frame="world") for z in (0.6, 1.15)
    )
    assert low.xyz[0, 1] > 0.5
    assert low.xyz[0, 1] > high.xyz[0, 1]


@pytest.mark.parametrize("side", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
def test_a_bus_has_windows_on_all_sides(side: tuple[float, float]) -> None:
    scene = ls.Scene()
    bus = ls.worlds.vehicle("bus", np.random.default_rng(0))
    bus.add_to(scene)
    above, below = np.array([0.65, 0.3]) * bus.bounds[1, 2]
    outside = np.array([(20.0 * side[0], 20.0 * side[1], z) for z in (above, below)])
    hits = scene.cast(outside, np.broadcast_to([-side[0], -side[1], 0.0], outside.shape))
    assert [bool(scene[number].material.transmission) for number in hits.object_id.tolist()] == [True, False]
    assert scene[0].label == 13


def test_classes_are_those_of_semantickitti() -> None:
    assert labels.CLASS_NAMES.items() <= {number: name for number, (name, _) in SEMANTIC_KITTI.items()}.items()


def test_people_are_as_tall_as_they_are_said_to_be() -> None:
    for seed in range(10):
        person = ls.worlds.pedestrian(np.random.default_rng(seed), posture="standing", load="nothing", height=1.8)
        assert np.diff(person.bounds, axis=0)[0, 2] == pytest.approx(1.8, abs=0.03)
    seated = ls.worlds.pedestrian(np.random.default_rng(0), posture="sitting", load="nothing", height=1.8)
    assert 1.2 < np.diff(seated.bounds, axis=0)[0, 2] < 1.45


@pytest.mark.parametrize("posture", ["walking", "standing"])
@pytest.mark.parametrize("height", [1.5, 1.7, 2.0])
@pytest.mark.parametrize("seed", range(4))
def test_hands_hold_the_pram(posture: Any, height: float, seed: int) -> None:
    made = ls.worlds.pedestrian(np.random.default_rng(seed), posture=posture, load="pram", height=height)
    (pram,) = (
        part.shape.vertices for part in made.parts if isinstance(part.shape, ls.TriangleMesh) and part.name == "pram"
    )
    forearms = [part for part in made.parts if part.name.endswith("forearm")]
    assert len(forearms) == 2
    for forearm in forearms:
        limb = cast("ls.Capsule", forearm.shape)
        hand = (cast("Floats", forearm.transform) @ (*limb.end, 1.0))[:3]
        assert np.linalg.norm(pram - hand, axis=1).min() < limb.radius


@pytest.mark.parametrize("kind", ["broadleaf", "conifer", "young"])
def test_trees_are_as_tall_as_they_are_said_to_be_with_gaps_between_their_leaves(kind: Any) -> None:
    low, high = HABITS[cast("Any", kind)].height
    for seed in range(5):
        plant = ls.worlds.tree(kind, np.random.default_rng(seed))
        assert low - 0.5 <= plant.bounds[1, 2] <= high + 0.2
        assert {int(number) for part in plant.parts for number in np.unique(part.label)} == {
            labels.TRUNK,
            labels.VEGETATION,
        }
        scene = ls.Scene()
        plant.add_to(scene)
        foot, top = plant.parts[-1].shape.bounds[:, 2]
        heights = np.linspace(foot + 0.3 * (top - foot), foot + 0.7 * (top - foot), 400)
        origins = np.column_stack([np.full(400, -20.0), np.linspace(-0.4, 0.4, 400), heights])
        hits = scene.cast_all(origins, np.broadcast_to([1.0, 0.0, 0.0], origins.shape), most=8)
        count = np.isfinite(hits.t).sum(axis=1)
        assert (count == 0).any()
        assert (count > 2).any()
    pruned = ls.worlds.tree(kind, np.random.default_rng(1), clearance=3.0)
    assert pruned.parts[-1].shape.bounds[0, 2] >= 3.0


@pytest.mark.parametrize("kind", ["broadleaf", "conifer", "young", "bush"])
@pytest.mark.parametrize("height", [0.05, 0.3, 0.5, 6.0])
@pytest.mark.parametrize("clearance", [0.0, 8.0])
def test_low_and_pruned_plants_are_about_as_tall_as_they_are_said_to_be(
    kind: Any, height: float, clearance: float
) -> None:
    for seed in range(3):
        plant = ls.worlds.tree(kind, np.random.default_rng(seed), height=height, clearance=clearance)
        assert all(np.isfinite(part.bounds).all() for part in plant.parts)
        # Leaves reach by a radius, an eighth of the height times 1.2 at most, above their centres, the highest the top.
        assert 0.5 * height < plant.bounds[1, 2] < 1.16 * height
        assert height < 6.0 or "leaves" in [part.name for part in plant.parts]


@pytest.mark.parametrize("kind", ["hedge", "bed", "bush"])
def test_shrubs_are_rough_hulls_with_gaps(kind: Any) -> None:
    """Some rays enter, most of which end within; ranges along a row scatter by millimetres to centimetres."""
    entered, passed, steps = [], [], []
    for seed in range(4):
        scene = ls.Scene()
        ls.worlds.tree(kind, np.random.default_rng(seed), height=1.2).add_to(scene)
        height, across = np.meshgrid(np.linspace(0.4, 0.7, 30), np.linspace(-0.25, 0.25, 21), indexing="ij")
        origins = np.stack([across, np.full_like(across, -5.0), height], axis=-1).reshape(-1, 3)
        found = scene.cast(origins, np.broadcast_to([0.0, 1.0, 0.0], origins.shape)).t.reshape(height.shape)
        entered.append(found > 5.0)
        passed.append(np.isinf(found))
        near = np.where(entered[-1], np.nan, found)
        steps.append(np.abs(near[:, 2:] - 2 * near[:, 1:-1] + near[:, :-2]) / 2)
    assert 0.01 < np.mean(entered) < 0.2
    assert np.mean(passed) < 0.05
    assert 0.001 < np.nanmedian(steps) < 0.02


@pytest.mark.parametrize(("kind", "wide", "tall"), [("hedge", 1.12, 1.4), ("bed", 2.0, 0.6), ("bed", 2.0, 0.15)])
def test_clipped_shrubs_have_even_surfaces(kind: Any, wide: float, tall: float) -> None:
    """Few rays from above pass the leaves near the top, which rises and falls by less than a tenth of the height."""
    plant = ls.worlds.tree(kind, np.random.default_rng(0), height=tall, length=4.0)
    np.testing.assert_allclose(np.diff(plant.bounds, axis=0)[0], [4.0, wide, tall], atol=0.25)
    scene = ls.Scene()
    plant.add_to(scene)
    x, y = np.meshgrid(np.linspace(-1.8, 1.8, 60), np.linspace(-0.4, 0.4, 20))
    origins = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 5.0)])
    hits = scene.cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
    heights = np.where(hits.hit, 5.0 - hits.t, 0.0)
    assert np.mean(heights > 0.7 * tall) > 0.85
    assert np.subtract(*np.percentile(heights, [75, 25])) < 0.12


@pytest.mark.parametrize("kind", ["hedge", "bed"])
def test_clipped_shrubs_have_four_sides(kind: Any) -> None:
    size = np.array([4.0, 2.0 if kind == "bed" else 1.12])
    scene = ls.Scene()
    ls.worlds.tree(kind, np.random.default_rng(0), height=1.4, length=4.0).add_to(scene)
    for axis in (0, 1):
        for side in (1.0, -1.0):
            across, height = np.meshgrid(np.linspace(-0.35, 0.35, 20) * size[1 - axis], np.linspace(0.2, 1.0, 20))
            origins = np.column_stack([across.ravel(), across.ravel(), height.ravel()])
            origins[:, axis] = 5.0 * side
            ahead = np.zeros(3)
            ahead[axis] = -side
            hits = scene.cast(origins, np.broadcast_to(ahead, origins.shape))
            assert np.mean(hits.t < 5.0 - size[axis] / 2 + 0.15) > 0.85


@pytest.mark.parametrize("kind", BUILDINGS)
def test_buildings_have_the_size_that_is_asked_for(kind: Any) -> None:
    made = ls.worlds.building(kind, np.random.default_rng(3), width=12.0, depth=9.0, storeys=2)
    size = np.diff(made.bounds, axis=0)[0]
    assert 9.0 <= size[0] <= 11.6
    assert 12.0 <= size[1] <= 12.9
    assert 5.4 <= size[2] <= 13.0


@pytest.mark.parametrize("kind", ["fence", "wall", "cable"])
def test_what_has_a_length_is_as_long(kind: Any) -> None:
    made = ls.worlds.furniture(kind, np.random.default_rng(0), length=4.0)
    assert np.diff(made.bounds, axis=0)[0, 1] == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda rng: ls.worlds.vehicle(cast("Any", "tank"), rng), "kind: expected 'hatchback'"),
        (lambda rng: ls.worlds.pedestrian(rng, posture=cast("Any", "flying")), "posture: expected 'walking'"),
        (
            lambda rng: ls.worlds.pedestrian(rng, posture="sitting", load="pram"),
            "load: expected 'nothing', 'bag'",
        ),
        (lambda rng: ls.worlds.tree(cast("Any", "palm"), rng), "kind: expected 'broadleaf'"),
        (lambda rng: ls.worlds.tree("bush", rng, length=2.0), "length: expected None, but for a hedge or bed, got 2.0"),
        (lambda rng: ls.worlds.tree("young", rng, height=99.0), "height: expected a finite number from 0.05 to 60"),
        (lambda rng: ls.worlds.building("house", rng, width=0.0), "width: expected a finite number from 2 to 100"),
        (lambda rng: ls.worlds.building("house", rng, storeys=0), "storeys: expected an integer from 1 to 40, got 0"),
        (lambda rng: ls.worlds.furniture("bin", rng, length=2.0), "length: expected None, but for fence, wall, cable"),
        (lambda rng: ls.worlds.furniture(cast("Any", "tent"), rng), "kind: expected 'lamp'"),
        (lambda rng: ls.worlds.pedestrian(rng, height=-1.0), "height: expected a finite number"),
    ],
)
def test_bad_arguments_are_named(call: Callable[[np.random.Generator], object], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        call(np.random.default_rng(0))


@pytest.mark.parametrize(
    "make",
    [
        ls.worlds.pedestrian,
        functools.partial(ls.worlds.vehicle, "suv"),
        functools.partial(ls.worlds.tree, "bush"),
        functools.partial(ls.worlds.building, "house"),
        functools.partial(ls.worlds.furniture, "bench"),
    ],
)
@pytest.mark.parametrize("rng", [7, None, np.random])
def test_what_draws_is_a_generator(make: Callable[[Any], object], rng: object) -> None:
    with pytest.raises(TypeError, match=r"rng: expected a numpy\.random\.Generator, got .*default_rng\(0\)"):
        make(rng)


def test_an_asset_is_added_to_a_scene() -> None:
    asset = ls.worlds.furniture("bin", np.random.default_rng(0))
    with pytest.raises(TypeError, match=r"scene: expected a Scene, got 7"):
        asset.add_to(cast("Any", 7))


def test_limbs_hang_from_their_joints() -> None:
    """However fast someone walks, and however someone sits; the right side is the left one, half a cycle later."""
    height, count = 1.8, 40
    phase, speed = np.linspace(0.0, 1.0, count), np.linspace(0.2, 1.6, count)
    bends = {"hip": (75, 20), "knee": (95, 10), "ankle": (5, 0), "shoulder": (30, -10), "elbow": (70, 15), "lean": 15.0}
    names = [name for name, _ in _walker.limbs(height)]
    walking = dict(zip(names, _walker.postures(height, phase, speed), strict=True))
    sitting = dict(zip(names, _walker.figure(height, **bends), strict=True))
    lengths = {("thigh", "shank"): _walker.THIGH, ("shank", "foot"): _walker.SHANK,
               ("upper arm", "forearm"): _walker.UPPER_ARM}  # fmt: skip
    for poses in (walking, sitting):
        for (upper, lower), length in lengths.items():
            for side in ("left", "right"):
                end = poses[f"{side} {upper}"] @ (0.0, 0.0, -length * height, 1.0)
                np.testing.assert_allclose(poses[f"{side} {lower}"][..., :, 3], end, rtol=0, atol=64 * 2.0**-53)
    for upper in ("thigh", "upper arm"):
        left, right = (poses[f"{side} {upper}"] for side in ("left", "right"))
        np.testing.assert_array_equal(left[..., 1, 3], -right[..., 1, 3])
    later = dict(zip(names, _walker.postures(height, phase + 0.5, speed), strict=True))
    for name in ("thigh", "shank", "foot", "upper arm", "forearm"):
        left, right = later[f"left {name}"].copy(), walking[f"right {name}"]
        left[:, 1, 3] *= -1.0
        # The phase rounds by 2⁻⁵³, and no angle changes by 2⁹ rad a cycle.
        np.testing.assert_allclose(left, right, rtol=0, atol=2.0**-44)
