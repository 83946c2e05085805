"""Copies and pickles of all public objects: small, without caches, across processes, and bit-identical."""

import copy
import io
import multiprocessing
import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim import _pickling

POSE = np.array([[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 2.5], [0.0, 0.0, 0.0, 1.0]])
SHEAR = np.array([[1.0, 0.25, 0.0, 3.0], [0.0, 1.0, 0.5, -1.0], [0.0, 0.0, 2.0, 0.1], [0.0, 0.0, 0.0, 1.0]])
DRIVE = ls.Trajectory([0.0, 1.0, 2.0], np.stack([np.eye(4), POSE, POSE]))


def shapes() -> list[ls.Shape]:
    mesh = ls.TriangleMesh.from_heightfield(np.random.default_rng(1).uniform(0, 1, (30, 40)), 0.5)
    return [
        ls.Plane((0.1, 0.2, 1.0), -0.3),
        ls.Plane.from_point((0.1, 0.2, -4.0), (0.0, 0.1, 1.0)),
        ls.Plane.from_points((0.0, 0.0, -5.0), (1.0, 0.1, -5.0), (0.3, 1.0, -5.1), transform=SHEAR),
        ls.Sphere((5.1, 0.2, 1.0), 0.7),
        ls.Ellipsoid((0.0, 6.0, 1.0), (1.0, 0.5, 0.3), np.array(POSE[:3, :3]), transform=SHEAR),
        ls.Box((1.0, 2.0, 3.0), (-6.0, 0.3, 1.0)),
        ls.Cylinder((0.0, -6.0, 0.0), (0.5, -6.0, 3.0), 0.4, capped=False),
        ls.Triangle((3, 3, 0), (4, 3, 0), (3, 4, 2)),
        ls.Polygon([(-3, -3, 0), (-5, -3, 0), (-5, -5, 0), (-4, -4, 0), (-3, -5, 0)]),
        mesh,
        ls.Capsule((0.0, 8.0, 0.0), (0.5, 8.0, 3.0), 0.4, transform=SHEAR),
        ls.Disk((8.0, 8.0, 1.0), (0.1, 0.2, -3.0), 1.5),
        ls.Spheres([(-8.0, 8.0, 1.0), (-8.5, 8.0, 1.5)], [0.5, 0.25], transform=SHEAR),
        ls.Disks([(-8.0, -8.0, 1.0), (-8.5, -8.0, 1.5)], [(0.1, 0.2, -3.0), (1.0, 0.0, 1.0)], 0.5),
    ]


def a_scene() -> ls.Scene:
    scene = ls.Scene(class_names={1: "car", 7: "road"})
    for i, shape in enumerate(shapes()):
        scene.add(shape, name=f"thing {i}", label=i, material=ls.Material(reflectivity=0.1 + 0.05 * i))
    mesh = scene[9].shape
    assert isinstance(mesh, ls.TriangleMesh)
    per_face = ls.Material(reflectivity=np.linspace(0.1, 1.0, len(mesh)), per="face")
    scene.add(mesh, label=np.arange(len(mesh)) % 5, material=per_face, transform=SHEAR, instance=77)
    scene.remove(3)
    return scene


def a_lidar() -> ls.Lidar:
    noise = ls.Measurement(
        range_sigma=0.02, elevation_sigma=1e-3, beam=ls.Beam(3e-3, pulse_length=5e-9), returns="dual"
    )
    pattern = ls.patterns.Spinning(np.linspace(-0.5, 0.3, 16), columns=180)
    return ls.Lidar(pattern, measurement=noise, name="top")


def everything() -> dict[str, Any]:
    """Return an object of each public class."""
    scene, lidar = a_scene(), a_lidar()
    scan = lidar.scan(scene, DRIVE, seed=3)
    prisms = [ls.patterns.Prism(121.57, exit_tilt=0.3), ls.patterns.Prism(-77.73, entry_tilt=0.3)]
    return {
        **{f"{type(shape).__name__} {i}": shape for i, shape in enumerate(shapes())},
        "Material": ls.Material(reflectivity=[0.1, 0.2], per="face"),
        "Material, textured": ls.Material(reflectivity=ls.Texture([[0.1, 0.2]]), texture_coordinates=np.eye(2)),
        "Texture": ls.Texture([[0.1, 0.2], [0.3, 0.4]], wrap=("clamp", "mirror")),
        "Beam": ls.Beam(1e-3),
        "Detection": ls.Detection(0.1, 100.0),
        "Measurement": lidar.measurement,
        "Scene": scene,
        "SceneObject": scene[10],
        "Hits": scene.cast([[0, 0, 3]] * 2, [[0, 0, -1], [0, 0, 1]]),
        "Lidar": lidar,
        "Rig": ls.Rig({"left": (lidar, POSE), "right": (lidar, None, 0.05)}),
        "Rig of all kinds": ls.Rig({"top": (lidar, POSE), "imu": (ls.Imu(100.0), POSE), "gnss": (ls.Gnss(5.0), None)}),
        "Georeference": ls.Georeference(origin=(0.8, 0.2, 500.0)),
        "Trajectory": DRIVE @ POSE,
        "Trajectory, spline": ls.Trajectory([0, 1, 2], np.stack([np.eye(4), POSE, POSE]), interpolation="spline"),
        "Trajectory, twist": ls.Trajectory.from_twist(POSE, (1, 2, 3), (0, 0, 1)),
        "Scan": scan,
        "Summary": scan.summary(),
        "PointCloud": scan.point_cloud(),
        "Pulses": scan.pulses,
        "Grid": ls.patterns.Grid([0.0, 0.1], [0.0, 0.1], rate=5.0),
        "Table": ls.patterns.Table(np.eye(3), times=[0, 0.01, 0.02], rate=10.0),
        "Risley": ls.patterns.Risley(prisms, refractive_index=1.5, pulse_rate=1e4, rate=10.0),
        "Mid360": ls.patterns.Mid360(),
        "preset": ls.Lidar.preset("velodyne-vlp16", noise="datasheet"),
    }


THINGS = everything()


def through_pickle(thing: object) -> object:
    return pickle.loads(pickle.dumps(thing, protocol=5))  # noqa: S301


def out_of_band(thing: object) -> object:
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(thing, protocol=5, buffer_callback=buffers.append)
    return pickle.loads(data, buffers=[bytearray(buffer.raw()) for buffer in buffers])  # noqa: S301


WAYS = [copy.copy, copy.deepcopy, through_pickle, out_of_band]


def parts(thing: object) -> Iterator[object]:
    """Yield what an object is made of, down to numbers, texts and arrays."""
    if isinstance(thing, ls.Scene):
        yield from parts([thing._next, dict(thing.class_names), list(thing)])
    elif isinstance(thing, _pickling.Pickled):
        yield type(thing)
        yield from parts(thing._contents())
    elif isinstance(thing, dict):
        yield list(thing)
        yield from parts(list(thing.values()))
    elif isinstance(thing, list | tuple):
        yield len(thing)
        for part in thing:
            yield from parts(part)
    elif isinstance(thing, np.ndarray):
        yield thing.dtype, thing.shape, np.ascontiguousarray(thing).tobytes()
    else:
        yield thing


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", THINGS)
def test_copies_are_equal_to_the_last_bit(name: str, way: Any) -> None:
    thing, other = THINGS[name], way(THINGS[name])
    assert type(other) is type(thing)
    mine = list(parts(thing))
    assert mine == list(parts(other))
    assert len(mine) > 1
    assert repr(thing) == repr(other)
    if type(thing).__eq__ is not object.__eq__ and not isinstance(thing, ls.Lidar | ls.Rig):
        assert other == thing
        if type(thing).__hash__ is not None:
            assert hash(other) == hash(thing)


@pytest.mark.parametrize("way", WAYS)
def test_lidars_and_patterns_are_equal_by_value(way: Any) -> None:
    lidar = a_lidar()
    assert way(lidar) == lidar == a_lidar()
    assert hash(way(lidar)) == hash(lidar)
    assert lidar.pattern != ls.patterns.Spinning(np.linspace(-0.5, 0.4, 16), columns=180)
    assert ls.Sphere((0, 0, 0), 1.0) == ls.Sphere([0.0, -0.0, 0.0], 1)
    assert hash(ls.Sphere((0, 0, 0), 1.0)) == hash(ls.Sphere([0.0, -0.0, 0.0], 1))
    assert ls.Sphere((0, 0, 0), 1.0) != ls.Sphere((0, 0, 0), 1.0, transform=SHEAR)


@pytest.mark.parametrize("name", THINGS)
def test_representations_are_short(name: str) -> None:
    text = repr(THINGS[name])
    assert text.count("\n") < 15
    assert len(text) <= 1000
    assert " at 0x" not in text


@pytest.fixture(params=["spawn", "forkserver", "fork"])
def method(request: pytest.FixtureRequest) -> str:
    """Return a way to start a process."""
    name: str = request.param
    if name not in multiprocessing.get_all_start_methods():
        pytest.skip(f"there is no {name} here")
    return name


def test_other_processes_scan_the_same_bits(method: str) -> None:
    expected = list(parts(THINGS["Scan"]))
    with ProcessPoolExecutor(2, multiprocessing.get_context(method)) as pool:
        futures = [pool.submit(a_lidar().scan, a_scene(), DRIVE, seed=3) for _ in range(3)]
        for future in futures:
            assert list(parts(future.result(timeout=120))) == expected


def test_a_data_loader_of_torch_scans_in_its_workers(method: str) -> None:
    data = pytest.importorskip("torch.utils.data")
    frames = Frames(a_scene(), a_lidar())
    expected = [frames[k] for k in range(len(frames))]  # so the threads of the core have run when a worker is forked
    loader = data.DataLoader(frames, batch_size=None, num_workers=2, multiprocessing_context=method, timeout=120)
    for _ in range(2):  # epochs
        for points, wanted in zip(loader, expected, strict=True):
            np.testing.assert_array_equal(np.asarray(points), wanted)
            assert len(points) > 0


class Frames:
    """A data set of four frames."""

    def __init__(self, scene: ls.Scene, lidar: ls.Lidar) -> None:
        self.scene, self.lidar = scene, lidar

    def __len__(self) -> int:
        return 4

    def __getitem__(self, k: int) -> Any:
        return self.lidar.scan(self.scene, POSE, frame=k).point_cloud().xyz


def test_pickles_hold_no_caches() -> None:
    lidar = ls.Lidar.preset("ouster-os1-64")
    scene = a_scene()
    before = [len(pickle.dumps(thing)) for thing in (lidar, lidar.pattern, scene)]
    lidar.scan(scene)
    assert [len(pickle.dumps(thing)) for thing in (lidar, lidar.pattern, scene)] == before
    assert before[0] < 20_000


def test_a_shared_mesh_is_held_once() -> None:
    mesh = ls.TriangleMesh.from_heightfield(np.zeros((50, 50)), 1.0)
    sizes = []
    for count in (1, 20):
        scene = ls.Scene()
        for i in range(count):
            scene.add(mesh, transform=np.diag([1.0, 1.0, 1.0 + i, 1.0]))
        sizes.append(len(pickle.dumps(scene)))
        restored = through_pickle(scene)
        assert isinstance(restored, ls.Scene)
        assert len({id(item.shape) for item in restored}) == 1
    assert sizes[1] < sizes[0] + 19 * 1000 < 2 * sizes[0]


def test_large_arrays_go_out_of_band_without_a_copy() -> None:
    mesh = ls.TriangleMesh.from_heightfield(np.zeros((100, 100)), 1.0)
    buffers: list[pickle.PickleBuffer] = []
    scene = ls.Scene()
    scene.add(mesh)
    rest = pickle.dumps(scene, protocol=5, buffer_callback=buffers.append)
    assert len(rest) < 2000
    places = {np.frombuffer(buffer.raw(), np.uint8).ctypes.data for buffer in buffers}
    assert places >= {mesh.vertices.ctypes.data, mesh.faces.ctypes.data}


def test_pickles_of_another_version_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for thing in (ls.Sphere((0, 0, 0), 1.0), THINGS["Scene"], THINGS["Scan"], THINGS["Trajectory"]):
        data = pickle.dumps(thing)
        monkeypatch.setattr(_pickling, "FORMAT", _pickling.FORMAT + 1)
        with pytest.raises(pickle.UnpicklingError, match=r"pickle of a .*: expected format 2 .*, got format 1"):
            pickle.load(io.BytesIO(data))  # noqa: S301
        monkeypatch.undo()


def test_what_is_immutable_stays_so_in_a_copy() -> None:
    for way in WAYS:
        sphere = way(ls.Sphere((1, 2, 3), 1.0))
        with pytest.raises(ValueError, match="read-only"):
            sphere.center[0] = 5.0
        with pytest.raises(AttributeError, match="Sphere is immutable"):
            sphere.radius = 2.0
        with pytest.raises(ValueError, match="read-only"):
            way(THINGS["Pulses"]).time[0] = 1.0
