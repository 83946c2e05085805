"""Copies and pickles of all public objects: small, without caches, across processes, and bit-identical."""

import copy
import dataclasses
import multiprocessing
import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest
from conformance.samples import SAMPLES, Move

import lidarsim as ls
from lidarsim._base import pickling
from tests.patterns.families import FAMILIES

POSE = np.array([[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 2.5], [0.0, 0.0, 0.0, 1.0]])
SHEAR = np.array([[1.0, 0.25, 0.0, 3.0], [0.0, 1.0, 0.5, -1.0], [0.0, 0.0, 2.0, 0.1], [0.0, 0.0, 0.0, 1.0]])
DRIVE = ls.Trajectory([0.0, 1.0, 2.0], np.stack([np.eye(4), POSE, POSE]))
CURVE = ls.Trajectory([0.0, 1.0, 2.0], np.stack([np.eye(4), POSE, POSE]), interpolation="spline")


def a_scene() -> ls.Scene:
    scene = ls.Scene(class_names={1: "car", 7: "road"})
    for i, sample in enumerate(SAMPLES):
        shift = np.array([6.0 * (i % 5) - 12.0, 6.0 * (i // 5) - 6.0, 0.0])
        material = ls.Material(reflectivity=0.1 + 0.05 * i)
        scene.add(sample.build(Move(shift=shift)), name=f"object {i}", label=i, material=material)
    mesh = ls.TriangleMesh.from_heightfield(np.random.default_rng(1).uniform(0, 1, (30, 40)), 0.5)
    per_face = ls.Material(reflectivity=np.linspace(0.1, 1.0, len(mesh)), per="face")
    scene.add(mesh, label=np.arange(len(mesh)) % 5, material=per_face, transform=SHEAR, instance=77)
    scene.remove(3)
    return scene


def a_lidar() -> ls.Lidar:
    noise = ls.Measurement(
        range_sigma=0.02,
        elevation_sigma=1e-3,
        beam=ls.Beam(3e-3, pulse_length=5e-9),
        returns="dual",
        response=ls.Response(limit=1.0),
    )
    pattern = ls.patterns.Spinning(np.linspace(-0.5, 0.3, 16), columns=180)
    return ls.Lidar(pattern, measurement=noise, name="top")


def everything() -> dict[str, Any]:
    """Return an object of each public class."""
    scene, lidar = a_scene(), a_lidar()
    scan = lidar.scan(scene, DRIVE, seed=3)
    scan_2d = ls.Lidar.preset("sick-lms111").scan(scene)
    foggy = a_scene()
    foggy.atmosphere = ls.Atmosphere.fog(visibility=80.0)
    return {
        **{f"shape {sample.name}": sample.build(transform=SHEAR) for sample in SAMPLES},
        **{f"pattern {name}": pattern for name, pattern in FAMILIES.items()},
        "Material": ls.Material(reflectivity=[0.1, 0.2], per="face"),
        "Material, textured": ls.Material(reflectivity=ls.Texture([[0.1, 0.2]]), texture_coordinates=np.eye(2)),
        "Texture": ls.Texture([[0.1, 0.2], [0.3, 0.4]], wrap=("clamp", "mirror")),
        "Beam": ls.Beam(1e-3),
        "Detection": ls.Detection(0.1, 100.0),
        "Measurement": lidar.measurement,
        "Atmosphere": foggy.atmosphere,
        "Scene": scene,
        "Scene in fog": foggy,
        "SceneObject": scene[10],
        "Hits": scene.cast([[0, 0, 3]] * 2, [[0, 0, -1], [0, 0, 1]]),
        "Lidar": lidar,
        "Rig": ls.Rig({"left": (lidar, POSE), "right": (lidar, None, 0.05)}),
        "Rig of all kinds": ls.Rig({"top": (lidar, POSE), "imu": (ls.Imu(100.0), POSE), "gnss": (ls.Gnss(5.0), None)}),
        "Georeference": ls.Georeference(origin=(0.8, 0.2, 500.0)),
        "Trajectory": DRIVE @ POSE,
        "Trajectory, spline": CURVE,
        "Trajectory, twist": ls.Trajectory.from_twist(POSE, (1, 2, 3), (0, 0, 1)),
        "Scan": scan,
        "Summary": scan.summary(),
        "PointCloud": scan.point_cloud(),
        "Boxes": scan.boxes(),
        "Waveforms": scan.waveforms(pulses=range(20)),
        "Cells": scan.point_cloud(frame="world").raster(cell=1.0, bounds=(-9, -9, 9, 9)),
        "LaserScan": scan_2d.laser_scan(),
        "ScanBatch": lidar.scan_many(scene, [POSE, POSE]),
        "Comparison": ls.compare(scan.point_cloud(), lidar.scan(scene, DRIVE, seed=4).point_cloud()),
        "OccupancyGrid": ls.occupancy(scene, 0.5, 1.0),
        "ImuSamples": ls.Imu(100.0, gyroscope=ls.ImuErrors(noise_density=1e-4)).measure(CURVE),
        "GnssFixes": ls.Gnss(5.0).measure(DRIVE, ls.Georeference(origin=(0.8, 0.2, 500.0))),
        "Pulses": scan.pulses,
        "preset": ls.Lidar.preset("velodyne-vlp16", noise="datasheet"),
    }


OBJECTS = everything()


def through_pickle(original: object) -> object:
    return pickle.loads(pickle.dumps(original, protocol=5))  # noqa: S301


def out_of_band(original: object) -> object:
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(original, protocol=5, buffer_callback=buffers.append)
    return pickle.loads(data, buffers=[bytearray(buffer.raw()) for buffer in buffers])  # noqa: S301


WAYS = [copy.copy, copy.deepcopy, through_pickle, out_of_band]


def parts(value: object) -> Iterator[object]:
    """Yield what an object is made of, down to numbers, texts and arrays."""
    if isinstance(value, ls.Scene):
        yield from parts([value._next, dict(value.class_names), list(value)])
    elif isinstance(value, pickling.Pickled):
        yield type(value)
        yield from parts(value._contents())
    elif isinstance(value, dict):
        yield list(value)
        yield from parts(list(value.values()))
    elif isinstance(value, list | tuple):
        yield len(value)
        for part in value:
            yield from parts(part)
    elif isinstance(value, np.ndarray):
        yield value.dtype, value.shape, np.ascontiguousarray(value).tobytes()
    elif isinstance(value, float):
        yield value.hex()  # alike for every nan, which does not equal itself
    else:
        yield value


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", OBJECTS)
def test_copies_are_equal_to_the_last_bit(name: str, way: Any) -> None:
    original, other = OBJECTS[name], way(OBJECTS[name])
    assert type(other) is type(original)
    mine = list(parts(original))
    assert mine == list(parts(other))
    assert len(mine) > 1
    assert repr(original) == repr(other)
    if type(original).__eq__ is not object.__eq__ and not isinstance(original, ls.Lidar | ls.Rig | ls.Comparison):
        assert other == original
        if type(original).__hash__ is not None:
            assert hash(other) == hash(original)


@pytest.mark.parametrize("way", WAYS)
def test_lidars_and_patterns_are_equal_by_value(way: Any) -> None:
    lidar = a_lidar()
    assert way(lidar) == lidar == a_lidar()
    assert hash(way(lidar)) == hash(lidar)
    assert lidar.pattern != ls.patterns.Spinning(np.linspace(-0.5, 0.4, 16), columns=180)
    assert ls.Sphere((0, 0, 0), 1.0) == ls.Sphere([0.0, -0.0, 0.0], 1)
    assert hash(ls.Sphere((0, 0, 0), 1.0)) == hash(ls.Sphere([0.0, -0.0, 0.0], 1))
    assert ls.Sphere((0, 0, 0), 1.0) != ls.Sphere((0, 0, 0), 1.0, transform=SHEAR)


@pytest.mark.parametrize("name", [name for name in OBJECTS if name != "Comparison"])  # which shows its whole table
def test_representations_are_short(name: str) -> None:
    text = repr(OBJECTS[name])
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
    expected = list(parts(OBJECTS["Scan"]))
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
    before = [len(pickle.dumps(original)) for original in (lidar, lidar.pattern, scene)]
    lidar.scan(scene)
    assert [len(pickle.dumps(original)) for original in (lidar, lidar.pattern, scene)] == before
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


def pickled_classes() -> set[str]:
    """Return the names of the classes whose objects are in these pickles."""
    found: set[str] = set()
    waiting: list[Any] = list(OBJECTS.values())
    while waiting:
        value = waiting.pop()
        if isinstance(value, pickling.Pickled):
            found.add(type(value).__name__)
            waiting.extend(value._contents().values())
        elif isinstance(value, tuple | list | dict):
            waiting.extend(value.values() if isinstance(value, dict) else value)
    return found


def test_every_public_class_is_pickled_here() -> None:
    public = [getattr(module, name) for module in (ls, ls.patterns) for name in module.__all__]
    classes = {c.__name__ for c in public if isinstance(c, type) and issubclass(c, pickling.Pickled)}
    assert len(classes) > 40
    assert classes - {"Shape"} <= pickled_classes()


def of_format(number: int, original: pickling.Pickled, lacks: set[str], **more: Any) -> bytes:
    """Return the pickle of an object in another format, whose contents lack these names."""
    kept = {name: value for name, value in original._contents().items() if name not in lacks}

    class Older:
        def __reduce__(self) -> tuple[Any, ...]:
            return pickling._restore, (number, type(original), kept | more)

    return pickle.dumps(Older())


GAINED: dict[str, tuple[Any, set[str]]] = {
    "Detection": (ls.Detection(0.1, 100.0), {"sigma"}),
    "Cells": (dataclasses.replace(OBJECTS["Cells"], quantity=""), {"quantity"}),
    "Measurement": (ls.Measurement(range_sigma=0.02), {"near_threshold", "near_range", "response", "receiver_offset"}),
    "Texture": (OBJECTS["Texture"], {"interpolation"}),
    "Rig": (OBJECTS["Rig"], {"_imus", "_receivers"}),
    "ImuErrors": (ls.ImuErrors(noise_density=1e-4), {"bias_instability"}),
    "Scene": (OBJECTS["Scene"], {"atmosphere", "animations"}),
    "Scan": (a_lidar().scan(a_scene()), {"source", "path", "mirrored_point", "ignore"}),
}
"""Objects with only defaults in the names that pickles of format 1 lack."""


@pytest.mark.parametrize("number", [1, pickling.FORMAT])
@pytest.mark.parametrize("name", GAINED)
def test_older_pickles_have_the_defaults_of_what_they_lack(name: str, number: int) -> None:
    original, lacks = GAINED[name]
    assert lacks & original._contents().keys()
    found = pickle.loads(of_format(number, original, lacks))  # noqa: S301
    assert type(found) is type(original)
    assert list(parts(found._contents())) == list(parts(original._contents()))


@pytest.mark.parametrize("name", [name for name, original in OBJECTS.items() if isinstance(original, pickling.Pickled)])
def test_pickles_of_other_versions_say_so(name: str) -> None:
    now, original = pickling.FORMAT, OBJECTS[name]
    refused = (
        rf"^pickle of a {type(original).__name__}: expected format {now} of this version of lidarsim, got format {{}}"
        " of another version; "
    )
    for number, more in ((now + 1, {}), (now, {"wings": 2}), (1, {"wings": 2})):
        with pytest.raises(pickle.UnpicklingError, match=refused.format(number)):
            pickle.loads(of_format(number, original, set(), **more))  # noqa: S301
    needed = {"Scene": "next", "Scan": "range", "Trajectory": "recipe", "shape sphere": "radius", "LaserScan": "ranges"}
    if name in needed:
        with pytest.raises(pickle.UnpicklingError, match=refused.format(now)):
            pickle.loads(of_format(now, original, {needed[name]}))  # noqa: S301


@pytest.mark.parametrize("name", ["Boxes", "Hits", "Lidar", "Pulses", "Scan"])
@pytest.mark.parametrize("attribute", ["time", "note"])
def test_no_attribute_can_be_set_that_a_copy_would_lack(name: str, attribute: str) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError, match=f"^cannot assign to field '{attribute}'$"):
        setattr(OBJECTS[name], attribute, 1.0)


def test_what_is_immutable_stays_so_in_a_copy() -> None:
    for way in WAYS:
        sphere = way(ls.Sphere((1, 2, 3), 1.0))
        with pytest.raises(ValueError, match="read-only"):
            sphere.center[0] = 5.0
        with pytest.raises(AttributeError, match="Sphere is immutable"):
            sphere.radius = 2.0
        with pytest.raises(ValueError, match="read-only"):
            way(OBJECTS["Pulses"]).time[0] = 1.0
