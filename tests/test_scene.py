"""Scenes: adding, finding, changing and removing objects, and lines of sight between them."""

import copy
import functools
import threading
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from conformance.samples import SAMPLES, VERTICES, Move
from exact.oracle import Ray, Surd
from numpy.typing import NDArray

import lidarsim as ls
from lidarsim.errors import FileFormatError

DOWN = np.array([[0.0, 0.0, -1.0]])


def at(x: float, y: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, 3] = (x, y, z)
    return matrix


def row_of_spheres(count: int) -> ls.Scene:
    scene = ls.Scene()
    for x in range(count):
        scene.add(ls.Sphere((3.0 * x, 0.0, 0.0), 1.0), name="odd" if x % 2 else "even", label=x)
    return scene


def look_down(scene: ls.Scene, xs: list[float]) -> list[int]:
    """Return what is hit from above at some x."""
    origins = np.array([[x, 0.0, 10.0] for x in xs])
    return scene.cast(origins, np.broadcast_to(DOWN, origins.shape)).object_id.tolist()


def test_objects_are_found_by_id_and_name() -> None:
    scene = row_of_spheres(5)
    assert [item.id for item in scene] == [0, 1, 2, 3, 4]
    assert [scene[i].label for i in range(5)] == [0, 1, 2, 3, 4]
    assert (scene.find("even"), scene.find("odd"), scene.find("")) == ([0, 2, 4], [1, 3], [])
    assert scene.objects == tuple(scene)
    assert len(scene) == 5


def test_ids_stay_and_are_never_used_again() -> None:
    scene = row_of_spheres(4)
    scene.remove(1)
    scene.remove(3)
    assert look_down(scene, [0, 3, 6, 9]) == [0, -1, 2, -1]
    assert scene.add(ls.Sphere((3, 0, 0), 1.0)) == 4
    assert look_down(scene, [0, 3, 6, 9]) == [0, 4, 2, -1]
    assert [item.id for item in scene] == [0, 2, 4]
    with pytest.raises(KeyError, match="object_id: expected the id of an object, got 3, which was removed"):
        scene.remove(3)
    for item in scene.objects:
        scene.remove(item.id)
    assert look_down(scene, [0, 3]) == [-1, -1]
    assert scene.add(ls.Sphere((0, 0, 0), 1.0)) == 5


def test_scans_have_the_ids_of_the_scene() -> None:
    scene = row_of_spheres(3)
    scene.remove(0)
    lidar = ls.Lidar(ls.patterns.Table(DOWN, rate=10.0))
    scan = lidar.scan(scene, at(6, 0, 5))
    assert (scan.object_id[0, 0], scan.instance[0, 0], scan.label[0, 0]) == (2, 3, 2)
    assert scan.point_cloud().instance.tolist() == [3]
    assert lidar.scan(scene, at(0, 0, 5)).object_id.tolist() == [[-1]]


def test_of_equal_hits_the_lowest_id_is_named() -> None:
    scene = ls.Scene()
    for _ in range(6):
        scene.add(ls.Box((2, 2, 2)))
    scene.remove(0)
    scene.update(1, transform=at(50))
    scene.update(1, transform=None)
    assert look_down(scene, [0]) == [1]
    scene.remove(1)
    assert look_down(scene, [0]) == [2]


def test_updates_change_what_they_name_and_nothing_else() -> None:
    mesh = ls.TriangleMesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    scene = ls.Scene()
    scene.add(mesh, name="plate", label=3, material=ls.Material(reflectivity=0.5))
    before = scene[0]
    scene.update(0, transform=at(0, 0, 2))
    after = scene[0]
    assert after.shape is mesh
    assert (after.name, after.label, after.instance, after.material) == ("plate", 3, 1, before.material)
    assert before.transform is None
    np.testing.assert_array_equal(after.transform, at(0, 0, 2))
    lidar = ls.Lidar(ls.patterns.Table(DOWN, rate=10.0))
    assert lidar.scan(scene, at(0.2, 0.1, 5)).range[0, 0] == 3.0
    scene.update(0, label=[7, 8], instance=40, material=ls.Material(reflectivity=0.25))
    scan = lidar.scan(scene, at(0.5, -0.5, 5))
    assert (scan.label[0, 0], scan.instance[0, 0], scan.intensity[0, 0]) == (7, 40, 0.25)
    assert lidar.scan(scene, at(-0.5, 0.5, 5)).label[0, 0] == 8
    before = scene[0]
    scene.update(0, transform=at(0, 0, 2))
    assert scene[0].looks_like(before)  # labels of faces are not copied for each step
    assert lidar.scan(scene, at(-0.5, 0.5, 5)).label[0, 0] == 8
    scene.update(0, label=1, shape=ls.Sphere((0, 0, 0), 1.0), material=None, instance=None)
    scan = lidar.scan(scene, at(0, 0, 5))
    assert (scan.range[0, 0], scan.label[0, 0], scan.instance[0, 0], scan.intensity[0, 0]) == (2.0, 1, 1, 1.0)


def test_labels_of_faces_stay_when_the_array_that_gave_them_changes() -> None:
    scene, given = ls.Scene(), np.array([7, 8], np.uint32)
    view = given.view()
    view.setflags(write=False)
    mesh = ls.TriangleMesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    scene.add(mesh, label=view)
    scene.update(0, label=view)
    given[:] = 9
    assert scene[0].label.tolist() == [7, 8]  # type: ignore[union-attr]
    own = scene[0].label
    scene.update(0, transform=at(1))
    assert scene[0].label is own  # they are not copied for each step


def test_a_refused_change_leaves_the_object_as_it_was() -> None:
    scene = row_of_spheres(2)
    before = scene[1]
    changes = [{"label": -1}, {"transform": np.zeros((4, 4))}, {"shape": 3}, {"label": [1, 2]}, {"colour": 1}]
    for wrong in changes:
        with pytest.raises((TypeError, ValueError)):
            scene.update(1, **wrong)  # type: ignore[arg-type]
    singular = np.diag([1.0, 0.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="transform: expected an invertible matrix"):
        scene.update(1, transform=singular)
    assert scene[1] is before
    with pytest.raises(KeyError, match="got 7"):
        scene.update(7, label=1)


def test_an_update_keeps_the_hierarchy_of_a_mesh() -> None:
    mesh = ls.TriangleMesh.from_heightfield(np.zeros((60, 60)), 1.0)
    scene = ls.Scene()
    scene.add(mesh)
    look_down(scene, [30])
    built = mesh._native.bytes()
    assert built > mesh.vertices.nbytes + mesh.faces.nbytes
    for z in (1.0, 2.0):
        scene.update(0, transform=at(0, 0, z))
        assert scene.cast([[30.5, 30.5, 9]], DOWN).t[0] == 9.0 - z
    assert mesh._native.bytes() == built
    assert scene[0].shape is mesh


def test_casts_after_updates_are_those_of_a_new_scene() -> None:
    rng = np.random.default_rng(5)
    scene = ls.Scene()
    for center in rng.uniform(-10, 10, (300, 3)):
        scene.add(ls.Sphere(center, 0.5) if center[0] < 0 else ls.Box(size=(1, 1, 1), center=center))
    origins, directions = rng.uniform(-12, 12, (4000, 3)), rng.normal(size=(4000, 3))
    moved_hits = 0
    for reach in [0.1, 1.0, 3.0, 10.0, 1e6, 0.1]:
        moved = rng.choice(300, 20, replace=False).tolist()
        for number in moved:
            place = np.eye(4)
            place[:3, 3] = rng.uniform(-reach, reach, 3)
            scene.update(number, transform=place)
        scene.update(7, shape=ls.Plane((0, 0, 1), -11.0) if reach == 3.0 else ls.Sphere((1, 2, 3), reach))
        found, fresh = scene.cast(origins, directions), copy_of(scene).cast(origins, directions)
        for name in ("t", "object_id", "primitive_id", "normal"):
            np.testing.assert_array_equal(getattr(found, name), getattr(fresh, name))
        moved_hits += int(np.isin(found.object_id, moved).sum())
    assert moved_hits > 50


def copy_of(scene: ls.Scene) -> ls.Scene:
    """Return a scene of the same objects that has never been another."""
    fresh = ls.Scene()
    for item in scene:
        fresh.add(item.shape, transform=item.transform)
    return fresh


def test_a_misspelt_attribute_is_refused() -> None:
    with pytest.raises(AttributeError, match="atmospher"):
        ls.Scene().atmospher = ls.Atmosphere.fog(visibility=50.0)  # type: ignore[attr-defined]


def test_copies_share_no_changes() -> None:
    scene = row_of_spheres(3)
    for other in (copy.copy(scene), copy.deepcopy(scene)):
        other.remove(0)
        other.update(1, transform=at(30))
        assert other.add(ls.Sphere((0, 0, 0), 1.0)) == 3
        assert look_down(scene, [0, 3]) == [0, 1]
        assert len(scene) == 3


def test_bounds_are_those_of_what_is_bounded() -> None:
    scene = ls.Scene()
    assert np.isnan(scene.bounds).all()
    scene.add(ls.Plane((0, 0, 1), 0.0))
    scene.add(ls.TriangleMesh(np.empty((0, 3)), np.empty((0, 3), int)))
    assert np.isnan(scene.bounds).all()
    scene.add(ls.Box((2, 4, 6), center=(1, 2, 3)), transform=at(10))
    scene.add(ls.Sphere((0, 0, 0), 0.5))
    low, high = scene.bounds
    exact = np.array([[-0.5, -0.5, -0.5], [12.0, 4.0, 6.0]])
    assert (low <= exact[0]).all()
    assert (high >= exact[1]).all()
    # Rounded outward at each of the few steps, by an ulp of the greatest coordinate at most.
    assert np.abs(scene.bounds - exact).max() <= 8 * np.spacing(12.0)


@pytest.mark.parametrize("level", range(3))
def test_a_line_of_sight_is_blocked_where_a_cast_hits(level: int) -> None:
    rng = np.random.default_rng(level)
    scene = ls.Scene()
    mesh = ls.TriangleMesh.from_heightfield(rng.uniform(0, 2, (12, 12)), 1.0, origin=(-6, -6))
    shapes = [mesh, ls.Plane((0, 0, 1), -3.0), ls.Sphere((2, 0, 3), 1.0), ls.Cylinder((-3, 0, 0), (-3, 0, 4), 0.5)]
    for shape in shapes[: level + 2]:
        scene.add(shape)
    turned = np.eye(4)
    turned[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 2]]
    scene.add(mesh, transform=turned @ at(3, 3, 2))
    count = 20_000
    origins = rng.uniform(-8, 8, (count, 3))
    origins[: count // 2] = (0.0, 0.0, 5.0)
    directions = rng.normal(size=(count, 3)) * 10.0 ** rng.integers(-3, 4, (count, 1))
    hits = scene.cast(origins, directions)
    for low, high in ((0.0, np.inf), (0.5, 2.0), (1.0, 1.0)):
        expected = scene.cast(origins, directions, t_min=low, t_max=high).hit
        np.testing.assert_array_equal(scene.occluded(origins, directions, t_min=low, t_max=high), expected)
    assert 0.1 < hits.hit.mean() < 0.95
    # Both ends are part of the range, and the next numbers on either side are not.
    for i in np.flatnonzero(hits.hit)[:200]:
        ray, t = (origins[i : i + 1], directions[i : i + 1]), float(hits.t[i])
        assert scene.occluded(*ray, t_max=t)[0]
        assert not scene.occluded(*ray, t_max=np.nextafter(t, 0))[0]
        assert scene.occluded(*ray, t_min=t, t_max=t)[0]


def crossings_of(scene: ls.Scene, specs: list[Any], origin: np.ndarray, direction: np.ndarray) -> list[Any]:
    """Return t, object and primitive of every crossing ahead, by the exact oracle, in the order of `cast_all`."""
    ray = Ray.of(origin, direction)
    found = [
        (crossing.t, item.id, min(crossing.faces) if judge.primitives else 0)
        for item, judge in zip(scene, specs, strict=True)
        for crossing in judge.crossings(ray)
        if Surd(0, 1) <= crossing.t
    ]
    by_t = functools.cmp_to_key(lambda a, b: a[0].compare(b[0]) or a[1] - b[1])
    return [(float(t), *ids) for t, *ids in sorted(found, key=by_t)]


def test_all_hits_are_those_of_exact_arithmetic() -> None:
    rng = np.random.default_rng(5)
    scene, specs = ls.Scene(), []
    for step, sample in enumerate(SAMPLES * 2):
        move = Move(shift=np.array([step % 3, step // 3 % 3, step // 9]) / 2.0)
        scene.add(sample.build(move))
        specs.append(sample.spec(move).judge())
    count = 300
    origins = rng.integers(-16, 17, (count, 3)) / 4.0  # rays that meet edges and corners, and start on surfaces
    targets = np.array(VERTICES)[rng.integers(len(VERTICES), size=count)] + rng.integers(0, 3, (count, 3)) / 2.0
    targets[::3] = rng.uniform(-1.5, 2.5, targets[::3].shape)
    directions = targets - origins
    directions[~directions.any(axis=1)] = (1, 0, 0)
    hits = scene.cast_all(origins, directions, most=500)
    first = scene.cast(origins, directions)
    met = 0
    for i in range(count):
        expected = crossings_of(scene, specs, origins[i], directions[i])
        got = hits.hit[i].sum()
        row = list(zip(hits.t[i], hits.object_id[i], hits.primitive_id[i], strict=True))
        assert row[:got] == expected
        assert (hits.t[i, got:] == np.inf).all()
        assert not hits.normal[i, got:].any()
        met += got
    assert met > 1500
    for k in (1, 2, 5):  # the nearest k, however many there are
        fewer = scene.cast_all(origins, directions, most=k)
        for name in ("t", "object_id", "primitive_id", "normal"):
            np.testing.assert_array_equal(getattr(fewer, name), getattr(hits, name)[:, :k])
    for name in ("t", "object_id", "primitive_id"):
        np.testing.assert_array_equal(getattr(hits, name)[:, 0], getattr(first, name))
    # Normals of `cast` and of `cast_all` have up to four roundings each.
    np.testing.assert_allclose(hits.normal[:, 0], first.normal, rtol=0, atol=8 * np.spacing(0.5))


def test_all_hits_of_ranges_times_and_removed_objects() -> None:
    scene = row_of_spheres(9)
    scene.remove(4)
    there = ls.Trajectory.from_twist(at(0, 0, 0), linear=(2.0, 0, 0))
    mover = scene.add(ls.Sphere((0, 0, 0), 0.125), motion=there)
    origins, directions = np.full((3, 3), (-1.0, 0, 0)), np.full((3, 3), (2.0, 0, 0))
    times = np.array([0.0, 1.0, 2.0])
    whole = scene.cast_all(origins, directions, most=100, time=times)
    for i, now in enumerate(times):
        ahead = (whole.t[i][whole.object_id[i] == mover] * 2.0 - 1.0).tolist()
        assert ahead == [2 * now - 0.125, 2 * now + 0.125]
    assert 4 not in whole.object_id
    low, high = whole.t[0, 3], whole.t[0, 7]
    part = scene.cast_all(origins[:1], directions[:1], most=100, t_min=low, t_max=high)
    np.testing.assert_array_equal(part.t[0, :5], whole.t[0, 3:8])
    assert part.hit.sum() == 5
    part = scene.cast_all(
        origins[:1], directions[:1], most=100, t_min=np.nextafter(low, 9), t_max=np.nextafter(high, 0)
    )
    assert part.hit.sum() == 3


def test_all_hits_refuse_what_casts_refuse() -> None:
    scene = row_of_spheres(1)
    assert scene.cast_all(np.empty((0, 3)), np.empty((0, 3)), most=3).t.shape == (0, 3)
    with pytest.raises(ValueError, match=r"directions: expected non-zero vectors, got directions\[1\]"):
        scene.cast_all(np.zeros((2, 3)), [[1, 0, 0], [0, 0, 0]], most=1)
    for most in (0, -1, 2**31):
        with pytest.raises(ValueError, match="most: expected an integer"):
            scene.cast_all([[0, 0, 0]], [[1, 0, 0]], most=most)
    with pytest.raises(MemoryError, match="the hits of 100000 rays"):
        scene.cast_all(np.zeros((100_000, 3)), np.ones((100_000, 3)), most=2**31 - 1)


def test_lines_of_sight_refuse_what_casts_refuse() -> None:
    scene = row_of_spheres(1)
    assert scene.occluded(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)
    with pytest.raises(ValueError, match=r"directions: expected non-zero vectors, got directions\[1\]"):
        scene.occluded(np.zeros((2, 3)), [[1, 0, 0], [0, 0, 0]])
    with pytest.raises(ValueError, match="origins: expected finite numbers"):
        scene.occluded([[np.nan, 0, 0]], [[1, 0, 0]])


def test_a_cast_sees_the_scene_before_or_after_a_change() -> None:
    """Two plates are moved by one step each time in one update: a cast sees either all or nothing of it."""
    corners = [[-9, -1, 0], [9, -1, 0], [9, 1, 0], [-9, 1, 0]]
    plate = ls.TriangleMesh(corners, [[0, 1, 2], [0, 2, 3]])
    scene = ls.Scene()
    scene.add(plate, label=0)
    origins = np.stack([np.linspace(-8, 8, 5000), np.zeros(5000), np.full(5000, 2000.0)], axis=1)
    directions = np.broadcast_to(DOWN, origins.shape)
    heights: list[list[float]] = []
    wrong: list[BaseException] = []
    done = threading.Event()

    def watch() -> None:
        mine: list[float] = []
        heights.append(mine)
        try:
            while not done.is_set():
                found = np.unique(2000.0 - scene.cast(origins, directions).t)
                assert len(found) == 1, found
                mine.append(float(found[0]))
        except BaseException as error:  # noqa: BLE001
            wrong.append(error)

    def count() -> int:
        return sum(map(len, heights))

    watchers = [threading.Thread(target=watch) for _ in range(3)]
    for watcher in watchers:
        watcher.start()
    for step in range(1, 1900):
        scene.update(0, transform=at(0, 0, step))
        assert 2000.0 - scene.cast(origins[:1], directions[:1]).t[0] == step
        if step >= 400 and count() > 30:
            break
        before = count()
        while step % 50 == 0 and count() == before and not wrong:  # on a busy machine changes would outrun all casts
            time.sleep(1e-3)
    done.set()
    for watcher in watchers:
        watcher.join()
    assert not wrong
    assert count() > 30
    for mine in heights:  # no cast sees an older scene than the one before it
        assert all(a <= b for a, b in pairwise(mine))


def test_class_names_reach_the_cloud() -> None:
    scene = ls.Scene(class_names={4: "wall"})
    scene.add(ls.Plane((1, 0, 0), 10.0), label=4)
    scan = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0)).scan(scene)
    assert scan.class_names == scan.point_cloud().class_names == scene.class_names == {4: "wall"}
    with pytest.raises(TypeError):
        scene.class_names[5] = "floor"  # type: ignore[index]


@pytest.mark.parametrize(
    ("names", "error", "message"),
    [
        ([(1, "car")], TypeError, "class_names: expected a mapping from labels to their names"),
        ({"car": 1}, TypeError, "class_names, its keys: expected an integer"),
        ({-1: "car"}, ValueError, "class_names, its keys: expected an integer from 0 to 4294967295, got -1"),
        ({1: 2}, TypeError, r"class_names\[1\]: expected a string, got 2"),
    ],
)
def test_bad_class_names(names: object, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        ls.Scene(class_names=names)  # type: ignore[arg-type]


def test_scene_files_keep_their_instances(tmp_path: Path) -> None:
    file = trimesh.Scene()
    box = trimesh.creation.box((1, 1, 1))
    file.add_geometry(box, node_name="near", geom_name="box", transform=at(3))
    file.graph.update(frame_to="far", geometry="box", matrix=at(7))
    file.export(tmp_path / "two.glb")
    scene = ls.Scene.from_file(tmp_path / "two.glb")
    assert sorted(item.name for item in scene) == ["far", "near"]
    assert scene[0].shape is scene[1].shape
    np.testing.assert_allclose(scene.bounds, [[2.5, -0.5, -0.5], [7.5, 0.5, 0.5]])


def test_scene_files_in_yaml(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("- {shape: sphere, center_m: [5, 0, 0], radius_m: 1, name: ball, label: 2}\n")
    scene = ls.Scene.from_file(path)
    assert (scene[0].name, scene[0].label) == ("ball", 2)
    assert scene.cast([[0, 0, 0]], [[1, 0, 0]]).t[0] == 4.0


def test_other_files_are_no_scenes(tmp_path: Path) -> None:
    path = tmp_path / "scene.docx"
    path.write_text("no scene")
    with pytest.raises(FileFormatError, match=r"scene\.docx: expected a scene of one of these kinds"):
        ls.Scene.from_file(path)
    with pytest.raises(FileNotFoundError):
        ls.Scene.from_file(tmp_path / "none.glb")


def places(rng, count):
    """Transforms that turn, shear and shift."""
    matrices = np.tile(np.eye(4), (count, 1, 1))
    matrices[:, :3] += rng.normal(scale=0.4, size=(count, 3, 4))
    return matrices


def test_transforms_of_many_objects_at_once_are_those_set_one_by_one():
    rng = np.random.default_rng(0)
    mesh = ls.TriangleMesh.from_heightfield(rng.normal(size=(6, 6)), 0.5)
    at_once, one_by_one = ls.Scene(), ls.Scene()
    for scene in (at_once, one_by_one):
        for k in range(40):
            shape = mesh if k % 2 else ls.Sphere((0.1 * k, 0, 0), 0.5)
            scene.add(shape, name=f"{k}", label=k, material=ls.Material(reflectivity=0.01 * k))
        scene.remove(7)
    ids = np.array([k for k in range(40) if k != 7])
    origins, directions = rng.normal(size=(2, 500, 3))
    for step in range(3):
        chosen = rng.permutation(ids)[: 20 + step]
        matrices = places(rng, len(chosen))
        before = at_once.objects
        at_once.update_transforms(chosen if step else chosen.tolist(), matrices)
        for number, matrix in zip(chosen.tolist(), matrices, strict=True):
            one_by_one.update(number, transform=matrix)
        for item, other, old in zip(at_once, one_by_one, before, strict=True):
            assert type(item) is ls.SceneObject
            assert (item.id, item.name, item.label, item.instance) == (
                other.id,
                other.name,
                other.label,
                other.instance,
            )
            assert item.shape is old.shape
            assert item.material is old.material
            assert item.looks_like(old)
            assert (item is old) == (item.id not in chosen)
            np.testing.assert_array_equal(item.transform, other.transform)
        found, right = at_once.cast(origins, directions), one_by_one.cast(origins, directions)
        assert len(np.unique(right.object_id)) > 20
        for name in ("t", "object_id", "primitive_id", "normal"):
            np.testing.assert_array_equal(getattr(found, name), getattr(right, name))


def test_transforms_at_once_keep_motions():
    path = ls.Trajectory([0.0, 1.0], [np.eye(4), translation(0.0, 2.0, 0.0)])
    scene = ls.Scene()
    ball = scene.add(ls.Sphere((0, 0, 0), 1.0), motion=path)
    scene.update_transforms([ball], [translation(5.0, 0.0, 0.0)])
    assert scene[ball].motion is path
    assert scene.cast([[0, 2.0, 0]], [[1, 0, 0]], time=1.0).t.tolist() == [4.0]
    scene.update_transforms([], np.zeros((0, 4, 4)))
    assert scene.cast([[0, 2.0, 0]], [[1, 0, 0]], time=1.0).t.tolist() == [4.0]


def translation(*offset):
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


@pytest.mark.parametrize(
    ("ids", "transforms", "error", "message"),
    [
        ([0, 1], [np.eye(4)], ValueError, r"transforms: expected shape \(2, 4, 4\), got \(1, 4, 4\)"),
        ([0, 1], [np.eye(4), np.diag([1, 0, 1, 1])], ValueError, r"got transforms\[1\] with determinant 0"),
        ([0, 1], [np.eye(4), np.eye(4)[::-1]], ValueError, r"a last row of \(0, 0, 0, 1\), got transforms\[1\] with"),
        ([0], [np.full((4, 4), np.nan)], ValueError, r"transforms: expected finite numbers"),
        ([0, 0], [np.eye(4), np.eye(4)], ValueError, "ids: expected each id once, got 0 twice"),
        ([0, 5], [np.eye(4), np.eye(4)], KeyError, "expected an id below 2, got 5"),
        ([-1], [np.eye(4)], KeyError, "expected an id below 2, got -1"),
        ([0.5], [np.eye(4)], TypeError, r"ids: expected integers of shape \(m,\), got float64"),
        (0, np.eye(4), TypeError, r"ids: expected integers of shape \(m,\)"),
        (["ball"], [np.eye(4)], TypeError, r"ids: expected integers of shape \(m,\)"),
    ],
)
def test_wrong_transforms_at_once_change_nothing(ids, transforms, error, message):
    scene = ls.Scene()
    for _ in range(2):
        scene.add(ls.Sphere((0, 0, 0), 1.0), transform=translation(3.0, 0.0, 0.0))
    before = scene.objects
    with pytest.raises(error, match=message):
        scene.update_transforms(ids, transforms)
    assert scene.objects == before


def test_a_copy_shares_the_hierarchy_until_either_changes() -> None:
    scene = ls.Scene()
    balls = [scene.add(ls.Sphere((3.0 * i, 0, 5), 1.0)) for i in range(1, 9)]
    down = np.array([(3.0 * i, 0, 20) for i in range(1, 9)]), np.tile([0.0, 0, -1], (8, 1))
    before = scene.cast(*down)
    other = copy.copy(scene)
    assert other._snapshot() is scene._snapshot()
    up = np.eye(4)
    up[2, 3] = 2.0
    other.update(balls[2], transform=up)
    assert other._snapshot() is not scene._snapshot()
    expected = before.t.copy()
    expected[2] -= 2.0
    assert np.array_equal(other.cast(*down).t, expected)
    assert np.array_equal(scene.cast(*down).t, before.t)
    scene.remove(balls[0])
    assert np.array_equal(scene.cast(*down).hit, [False] + [True] * 7)
    assert other.cast(*down).hit.all()


def test_a_scene_shows_its_objects_as_text_and_as_a_table() -> None:
    scene = ls.Scene(class_names={3: "<car>"})
    for k in range(1200):
        scene.add(ls.Sphere((k, 0.0, 0.0), 1.0), label=3)
    for label in range(100, 140):
        scene.add(ls.Box((1, 1, 1)), label=label)
    scene.atmosphere = ls.Atmosphere.fog(visibility=80.0)
    title, air, cars, *kinds, others = str(scene).split("\n")
    assert title == "Scene: 1,240 objects, bounds (-1, -1, -1) to (1200, 1, 1) m"
    assert air == f"  {scene.atmosphere}"
    assert cars == "   1,200 × Sphere, <car>"
    assert {line[:14] for line in kinds} == {"       1 × Box,"[:14]}
    assert others == f"  {40 - len(kinds):6} × others"
    table = scene._repr_html_()
    assert table.count("<tr>") == 3 + len(kinds)
    assert "<td>1,200 ×</td><td>Sphere, &lt;car&gt;</td>" in table
