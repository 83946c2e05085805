"""Scans: measurements, ground truth, coordinate frames of points, motion, and reproducibility to the bit."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import math
import os
import pickle
import re
import sys
import threading
import types
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim import _native
from lidarsim.patterns import Pulses
from lidarsim.scan.columns import ScanColumns
from lidarsim.scan.scan import scan as scan_pulses

ROUNDING = 2.0**-53
"""Largest relative error of a float64 that is rounded once."""

FLOAT32 = 2.0**-24
"""Likewise of a float32."""

Floats = npt.NDArray[np.float64]

ARRAYS = (
    "range", "true_range", "range_error", "intensity", "object_id", "label", "normal", "incidence", "status",
    "return_count",
)  # fmt: skip

EVERYTHING = ls.Measurement(
    range_sigma=0.02,
    range_sigma_slope=1e-3,
    range_bias=0.01,
    range_resolution=1e-3,
    azimuth_sigma=1e-3,
    elevation_sigma=1e-3,
    dropout=0.1,
    detection=ls.Detection(0.1, 30.0),
    extinction=1e-3,
    beam=ls.Beam(5e-3, 3e-3, rays=7),
    returns=2,
)

WHOLE = dataclasses.replace(
    EVERYTHING,
    channel_bias_sigma=0.02,
    range_sigma_limit=0.05,
    power_sigma=0.3,
    crossover=(1.0, 4.0),
    receiver_offset=0.03,
    false_returns=0.1,
    beam=ls.Beam(5e-3, 3e-3, pulse_length=2e-9, rays=7, separation=1.0),
)
"""With each effect that there is; in `shiny_room` with materials that are not Lambert's."""


def room() -> ls.Scene:
    """Ground, a ball, a tilted box, and walls on two sides; open on the others."""
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.5), name="ground", label=40, material=ls.Material(reflectivity=0.3))
    scene.add(ls.Sphere((8, 2, 0), 1.5), name="ball", label=7, material=ls.Material(reflectivity=0.9))
    turned = RigidTransform.from_components([6, -4, 0], Rotation.from_euler("zyx", [0.4, 0.2, 0.1]))
    scene.add(ls.Box((2, 3, 2)), name="box", label=4_000_000_000, transform=turned)
    scene.add(ls.Plane((1, 0.01, 0), 25.0), name="wall", label=50)
    scene.add(ls.Plane((0.01, 1, 0), 18.0), name="side", label=51)
    return scene


def shiny_room() -> ls.Scene:
    """The room with materials that are rough, and have highlights."""
    scene = room()
    scene.update(0, material=ls.Material(reflectivity=0.3, roughness=0.4))
    scene.update(1, material=ls.Material(reflectivity=0.2, specular=5.0, specular_width=0.2))
    scene.update(2, material=ls.Material(reflectivity=0.5, roughness=0.2, specular=1.0))
    return scene


def lidar(measurement: ls.Measurement | None = None, *, columns: int = 180, name: str = "top") -> ls.Lidar:
    pattern = ls.patterns.Spinning(
        np.radians(np.linspace(-25, 15, 16)), columns=columns, rate=10.0, beam_origins=[[0.05, 0.0, 0.04]] * 16
    )
    max_range = 60.0 if measurement and measurement.false_returns else math.inf
    return ls.Lidar(pattern, measurement=measurement or ls.Measurement(), max_range=max_range, name=name)


TURNED = RigidTransform.from_components([1.0, -2.0, 0.5], Rotation.from_euler("zyx", [0.7, -0.1, 0.2]))


def assert_same(a: ls.Scan, b: ls.Scan, index: Any = slice(None)) -> None:
    for name in ARRAYS if a.source is None else (*ARRAYS, "source"):
        assert np.array_equal(getattr(a, name), getattr(b, name)[index], equal_nan=name != "status"), name


# The truth


def test_hits_are_those_of_the_scene() -> None:
    scene, sensor = room(), lidar()
    scan = sensor.scan(scene, TURNED)
    pulses = sensor.pattern.pulses(0)
    rotation, translation = TURNED.rotation.as_matrix(), TURNED.translation
    hits = scene.cast(pulses.origins @ rotation.T + translation, pulses.directions @ rotation.T)
    assert 1000 < hits.hit.sum() < len(scan)
    assert np.array_equal(scan.status, np.where(hits.hit, ls.Status.hit, ls.Status.miss))
    assert np.array_equal(scan.return_count, hits.hit)
    assert np.array_equal(scan.object_id[:, 0], hits.object_id)
    labels = np.array([item.label for item in scene.objects])
    assert np.array_equal(scan.label[hits.hit, 0], labels[hits.object_id[hits.hit]])
    assert not scan.label[~hits.hit].any()
    # The rays above were turned by another multiplication of matrices. Its roundings, some 2⁻⁵³ of direction and
    # position, move a hit by their ratio to the cosine of the incidence.
    bound = 8 * ROUNDING * (hits.t + 10.0)[hits.hit] / np.cos(scan.incidence[hits.hit, 0])
    assert (np.abs(scan.true_range[hits.hit, 0] - hits.t[hits.hit]) < bound).all()
    assert np.allclose(scan.normal[hits.hit, 0], hits.normal[hits.hit], rtol=0, atol=FLOAT32)
    cosines = np.abs(np.einsum("ij,ij->i", pulses.directions @ rotation.T, hits.normal))[hits.hit]
    assert np.allclose(np.cos(scan.incidence[hits.hit, 0].astype(float)), cosines, rtol=0, atol=FLOAT32)


def test_the_true_range_is_the_length_of_the_way_to_1_ulp() -> None:
    scene, sensor = room(), lidar()
    scan = sensor.scan(scene)
    pulses = sensor.pattern.pulses(0)
    t = scene.cast(pulses.origins, pulses.directions).t
    hit = np.flatnonzero(np.isfinite(t))[::7]
    assert len(hit) > 200
    longer = 0
    with mpmath.workdps(50):
        for i in hit.tolist():
            square = sum(Fraction(float(x)) ** 2 for x in pulses.directions[i])
            exact = mpmath.mpf(t[i]) * mpmath.sqrt(mpmath.mpf(square.numerator) / square.denominator)
            assert abs(exact - scan.true_range[i, 0]) <= np.spacing(scan.true_range[i, 0]) * 0.51
            longer += scan.true_range[i, 0] != t[i]
    assert longer > 10


def test_arrays_have_their_shapes_and_types() -> None:
    for returns, k in ((1, 1), ("dual", 2), (4, 4)):
        measurement = ls.Measurement(beam=ls.Beam(1e-3, rays=7), returns=returns)  # type: ignore[arg-type]
        scan = lidar(measurement, columns=10).scan(room())
        assert len(scan) == 160
        for name, dtype in (
            ("range", np.float64), ("true_range", np.float64), ("range_error", np.float64), ("intensity", np.float32),
            ("object_id", np.int32), ("label", np.uint32), ("incidence", np.float32),
        ):  # fmt: skip
            array = getattr(scan, name)
            assert (array.shape, array.dtype) == ((160, k), dtype), name
        assert scan.normal.shape == (160, k, 3)
        assert (scan.status.shape, scan.status.dtype) == ((160,), np.uint8)
        assert (scan.return_count.shape, scan.return_count.dtype) == ((160,), np.uint8)


def test_columns_are_those_of_the_core() -> None:
    # A scan with each column, and with unused entries in each: of misses, and of pulses with fewer returns.
    moving = ls.Trajectory.from_twist(np.eye(4), (5.0, 0.0, 0.0), (0.0, 0.0, 0.2))
    scene = room()
    scene.update(3, material=ls.Material(reflectivity=0.5, mirror=0.5))
    scan = lidar(dataclasses.replace(WHOLE, depth=3), columns=40).scan(scene, moving)
    returned = np.arange(2) < scan.return_count[:, None]
    assert (scan.source[returned] == ls.Source.false_return).any()
    untold = ~returned & np.isnan(scan.true_range)
    assert untold[:, 0].any()
    assert untold[:, 1].any()
    cloud = scan.point_cloud()
    columns = _native.scan_columns()
    held = [field.name for field in dataclasses.fields(scan) if isinstance(getattr(scan, field.name), np.ndarray)]
    assert columns.keys() == ScanColumns._columns.keys() == {*held}
    for name, (dtype, shape, of_returns, unused) in columns.items():
        array = getattr(scan, name)
        assert (array.dtype, array.shape) == (dtype, (640, 2, *shape) if of_returns else (640,)), name
        if of_returns:
            assert np.array_equal(array[untold], np.broadcast_to(unused, array[untold].shape), equal_nan=True), name
        column = ScanColumns._columns[name]
        assert (column.dtype, column.shape, column.of_returns) == (dtype.type, shape, of_returns), name
        assert np.array_equal(unused, np.full(shape, column.unused, dtype), equal_nan=True), name
        axes = ", ".join(["n", "k", *map(str, shape)]) if of_returns else "n,"
        assert f"\n{name} : ndarray of {dtype}, shape ({axes})" in (ls.Scan.__doc__ or ""), name
        if name in cloud.fields:
            assert getattr(cloud, name).dtype == dtype, name
            assert name in ls.PointCloud.__annotations__, name
    assert columns.keys() - set(cloud.fields) == {"true_direction", "mirrored_point", "status"}


def test_what_is_lost_keeps_its_truth() -> None:
    clean = lidar().scan(room())
    lost = lidar(ls.Measurement(dropout=1.0)).scan(room())
    was_hit = clean.status == ls.Status.hit
    assert (lost.status[was_hit] == ls.Status.dropped).all()
    assert (lost.status[~was_hit] == ls.Status.miss).all()
    assert np.isnan(lost.range).all()
    for name in ("true_range", "object_id", "label", "normal", "incidence"):
        assert np.array_equal(getattr(lost, name), getattr(clean, name), equal_nan=True), name


def test_summary_counts_and_prints() -> None:
    sensor = dataclasses.replace(lidar(EVERYTHING), min_range=5.0, max_range=28.0)
    scan = sensor.scan(room())
    summary = scan.summary()
    assert list(summary) == [status.name for status in ls.Status]
    assert sum(summary.values()) == len(scan) == 2880
    for status in ls.Status:
        assert summary[status.name] == (scan.status == status).sum() > 0, status
    still = lidar(columns=10).scan(ls.Scene())
    assert str(still.summary()) == repr(still.summary())
    assert str(still.summary()).splitlines() == [
        "hit                       0    0.0%",
        "miss                    160  100.0%",
        "below_min_range           0    0.0%",
        "beyond_max_range          0    0.0%",
        "below_threshold           0    0.0%",
        "dropped                   0    0.0%",
        "pulses                  160",
    ]


def test_a_scan_prints_unix_times_to_the_digit() -> None:
    title = repr(lidar(columns=10).scan(ls.Scene(), time=1.7e9 + 0.25)).splitlines()[0]
    assert title.endswith("frame 0 at 1700000000.25 s: 160 pulses")


def test_a_sensor_inside_of_an_object_is_noted() -> None:
    body, far = ls.Sphere((0, 0, 0), 0.4), ls.Box((1, 9, 9), center=(20, 0, 0))
    shell, inside = ls.Scene(), dataclasses.replace(lidar(columns=10), min_range=0.5)
    shell.add(far)
    shell.add(body)
    note = "all hits are on object 1, nearer than {}: is the sensor inside its own body? ignore=[2] hides it"
    summary = inside.scan(shell).summary()
    assert summary.note == note.format("min_range")
    assert str(summary).splitlines()[-2:] == ["pulses                  160", summary.note]
    assert summary.note in repr(inside.scan(shell))
    assert pickle.loads(pickle.dumps(summary)).note == summary.note  # noqa: S301 - our own
    assert not inside.scan(shell, ignore=[2]).summary().note
    # the gate may let the body through
    open_gate = dataclasses.replace(inside, min_range=0.3)
    assert open_gate.scan(shell).summary().note == note.format("0.5 m")
    # not so if anything else is seen, or what is near is the smaller part, is beyond 0.5 m, or is two instances
    away = [[1, 0, 0, 19.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    assert not any(sensor.scan(shell, away).summary().note for sensor in (inside, open_gate))
    assert not any(sensor.scan(ls.Scene()).summary().note for sensor in (inside, open_gate))
    ball = ls.Scene()
    ball.add(ls.Sphere((0, 0, 0), 0.6))
    assert not inside.scan(ball).summary().note
    shell.add(ls.Box((0.2, 0.2, 0.2), center=(0.2, 0, 0)))
    assert not any(sensor.scan(shell).summary().note for sensor in (inside, open_gate))
    shell.update(2, instance=2)
    summary = inside.scan(shell).summary()
    assert summary.note == note.format("min_range").replace("object 1", "the objects of instance 2")


def test_an_empty_scene_is_all_misses() -> None:
    scan = lidar().scan(ls.Scene())
    assert (scan.status == ls.Status.miss).all()
    cloud = scan.point_cloud()
    assert len(cloud) == 0
    assert cloud.xyz.shape == (0, 3)


# Reflectivity of meshes


def square() -> ls.TriangleMesh:
    """A unit square at x = 10, of two triangles."""
    vertices = [[10, 0, 0], [10, 1, 0], [10, 1, 1], [10, 0, 1]]
    return ls.TriangleMesh(vertices, [[0, 1, 2], [0, 2, 3]])


def towards(points: npt.ArrayLike) -> ls.patterns.Table:
    points = np.asarray(points, dtype=float)
    return ls.patterns.Table(points, rate=10.0)


@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_reflectivity_per_vertex_is_linear_over_a_face(offset: float) -> None:
    values = [0.1, 0.5, 2.0, 0.3]
    generator = np.random.default_rng(5)
    v, w = generator.uniform(0.0, 1.0, (2, 500))
    shear = np.array([[1, 0, 0, offset], [0, 2.0, 0.5, offset], [0, 0, 0.7, 0], [0, 0, 0, 1.0]])
    scene = ls.Scene()
    scene.add(square(), material=ls.Material(reflectivity=values, per="vertex"), transform=shear)
    local = np.column_stack([np.full(500, 10.0), v, w, np.ones(500)])
    pose = np.eye(4)
    pose[:2, 3] = offset
    scan = ls.Lidar(towards((local @ shear.T)[:, :3] - pose[:3, 3])).scan(scene, pose)
    assert (scan.status == ls.Status.hit).all()
    got = scan.intensity[:, 0] / np.cos(scan.incidence[:, 0].astype(float))
    lower = 0.1 + v * (0.5 - 0.1) + w * (2.0 - 0.5)
    upper = 0.1 + v * (2.0 - 0.3) + w * (0.3 - 0.1)
    # Intensity and incidence are float32; the ray meets the face within an ulp of 5e6 m.
    assert np.allclose(got, np.where(v > w, lower, upper), rtol=2 * FLOAT32, atol=10 * np.spacing(offset))


def test_reflectivity_per_face() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), 20.0), material=ls.Material(reflectivity=0.05))
    scene.add(square(), material=ls.Material(reflectivity=[0.25, 300.0], per="face"))
    scan = ls.Lidar(towards([[10, 0.8, 0.2], [10, 0.2, 0.8], [10, -0.5, 0.5]])).scan(scene)
    got = scan.intensity[:, 0] / np.cos(scan.incidence[:, 0].astype(float))
    assert np.allclose(got, [0.25, 300.0, 0.05], rtol=2 * FLOAT32, atol=0)


def test_reflectivities_follow_the_scene_as_it_grows() -> None:
    scene, sensor = ls.Scene(), ls.Lidar(towards([[1, 0, 0]]))
    scene.add(ls.Plane((1, 0, 0), 20.0), material=ls.Material(reflectivity=0.5), label=1)
    assert sensor.scan(scene).intensity.tolist() == [[0.5]]
    scene.add(ls.Plane((1, 0, 0), 10.0), material=ls.Material(reflectivity=0.25), label=2)
    scan = sensor.scan(scene)
    assert (scan.intensity.tolist(), scan.label.tolist()) == ([[0.25]], [[2]])


@pytest.mark.parametrize(
    ("shape", "material", "message"),
    [
        (
            ls.Sphere((0, 0, 0), 1.0),
            ls.Material(reflectivity=[0.1], per="face"),
            "material: expected a TriangleMesh, Spheres or Disks for a reflectivity per face, got Sphere",
        ),
        (
            square(),
            ls.Material(reflectivity=[0.1, 0.2, 0.3], per="face"),
            "material: expected 2 reflectivities, one per face, got 3",
        ),
        (
            square(),
            ls.Material(reflectivity=[0.1, 0.2, 0.3], per="vertex"),
            "material: expected 4 reflectivities, one per vertex, got 3",
        ),
    ],
)
def test_reflectivities_that_do_not_fit_are_refused(shape: ls.Shape, material: ls.Material, message: str) -> None:
    scene = ls.Scene()
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        scene.add(shape, name="thing", material=material)
    assert len(scene) == 0


def test_an_object_that_is_added_while_another_thread_casts_is_not_forgotten() -> None:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # threads change places inside of a cast that hands the scene to the core
    try:
        scene = ls.Scene()
        for x in range(3000):
            scene.add(ls.Sphere((2.0 * x + 100.0, 0, 0), 0.5))
        for _ in range(40):
            started = threading.Event()

            def cast(started: threading.Event = started) -> None:
                started.set()
                scene.cast([[0, 0, 0]], [[1, 0, 0]])

            thread = threading.Thread(target=cast)
            thread.start()
            started.wait()
            near = scene.add(ls.Sphere((5, 0, 0), 1.0))
            thread.join()
            assert scene.cast([[0, 0, 0]], [[1, 0, 0]]).object_id == [near]
            scene.remove(near)
    finally:
        sys.setswitchinterval(interval)


# Images


def around() -> ls.Scene:
    """A ball ahead to the left, a box ahead to the right, a pole behind and a plate high up ahead."""
    scene = ls.Scene()
    scene.add(ls.Sphere((10, 5, 0), 2.0), name="ball", label=1)
    scene.add(ls.Box((2, 2, 2), center=(10, -5, 0)), name="box", label=2)
    scene.add(ls.Cylinder((-8, 0, -9), (-8, 0, 9), 0.4), name="pole", label=3)
    scene.add(ls.Box((1, 20, 2), center=(30, 0, 5)), name="plate", label=4)
    return scene


def middle_of(image: npt.NDArray[Any], label: int) -> tuple[float, float]:
    """Return the mean row and column of a label, as parts of the image."""
    rows, columns = np.nonzero(image == label)
    assert len(rows) > 5
    return float(rows.mean() / image.shape[0]), float(columns.mean() / image.shape[1])


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("ouster-os1-128", None),
        ("velodyne-vlp16", None),
        ("velodyne-hdl32e", None),
        ("hesai-pandar64", None),
        ("hesai-qt64", None),
        ("robosense-rs32", None),
        ("livox-mid360", (60, 360)),
        ("ouster-os1-64", (40, 500)),
    ],
)
def test_an_image_is_what_the_sensor_sees(name: str, size: tuple[int, int] | None) -> None:
    scan = ls.Lidar.preset(name).scan(around())
    image = scan.image("label", size=size)
    assert image.shape == (size or (scan.lidar.pattern.shape[0], image.shape[1]))
    (ball_row, ball), (_, box), (plate_row, plate) = (middle_of(image, label) for label in (1, 2, 4))
    assert ball < 0.49 < plate < 0.51 < box
    assert plate_row < ball_row
    _, behind = np.nonzero(image == 3)
    assert (np.abs(behind / image.shape[1] - 0.5) > 0.47).all()
    if size is None:
        assert np.isfinite(scan.image("time")).sum() == len(scan)  # each pulse has a pixel of its own
        assert np.array_equal(np.sort(image[image > 0]), np.sort(scan.label[scan.label > 0]))


def test_a_field_of_view_is_seen_from_its_left_to_its_right() -> None:
    for name, size in (
        ("hesai-at128", None),
        ("livox-avia", (60, 60)),
        ("sick-lms111", None),
        ("hokuyo-utm30lx", None),
    ):
        image = ls.Lidar.preset(name).scan(around()).image("label", size=size)
        assert middle_of(image, 1)[1] < 0.49, name
        assert middle_of(image, 2)[1] > 0.51, name


def test_every_field_has_an_image() -> None:
    scan = lidar(EVERYTHING).scan(room(), seed=4)
    row, column = 15 - scan.pulses.ring.astype(int), scan.pulses.column
    for number in (1, 2):
        for name in ("range", "true_range", "range_error", "intensity", "object_id", "label", "normal", "incidence"):
            image, field = scan.image(name, return_number=number), getattr(scan, name)[:, number - 1]
            assert (image.shape, image.dtype) == ((16, 180, *field.shape[1:]), field.dtype), name
            assert np.array_equal(image[row, column], field, equal_nan=image.dtype.kind == "f"), name
    assert 2 < np.isfinite(scan.image(return_number=2)).sum() < np.isfinite(scan.image()).sum() < 16 * 180
    for name in ("status", "return_count"):
        assert np.array_equal(scan.image(name)[row, column], getattr(scan, name))
    for name in ("time", "ring", "column", "directions", "origins"):
        image = scan.image(name)
        assert image.dtype == getattr(scan.pulses, name).dtype
        assert np.array_equal(image[row, column], getattr(scan.pulses, name))


def test_pixels_without_a_pulse() -> None:
    few = scan_pulses(lidar(), room(), indices=[5, 900])
    empty = np.ones((16, 180), bool)
    empty[15 - few.pulses.ring.astype(int), few.pulses.column] = False
    assert empty.sum() == 16 * 180 - 2
    for name, missing in (
        ("range", np.nan), ("normal", np.nan), ("label", 0), ("object_id", -1), ("return_count", 0), ("status", 255),
        ("ring", 65535), ("column", 2**32 - 1),
    ):  # fmt: skip
        pixels = few.image(name)[empty]
        assert np.array_equal(pixels, np.full_like(pixels, missing), equal_nan=name in {"range", "normal"}), name


def test_the_nearest_of_a_pixel_shows() -> None:
    # Azimuths 40, 39 (nearer), 20 and -20 degrees, the last at another elevation, in two rows and three columns.
    angles = np.radians([[40, 10], [39, 10], [20, 10], [-20, -10]])
    directions = np.column_stack(
        [np.cos(angles[:, 1]) * np.cos(angles[:, 0]), np.cos(angles[:, 1]) * np.sin(angles[:, 0]), np.sin(angles[:, 1])]
    )
    scene = ls.Scene()
    for direction, distance in zip(directions, (10.0, 5.0, 7.0, 3.0), strict=True):
        scene.add(ls.Sphere(direction * distance, 0.05))
    scan = ls.Lidar(ls.patterns.Table(directions, rate=10.0)).scan(scene)
    assert scan.image(size=(2, 3)).round(2).tolist()[0][:2] == [4.95, 6.95]
    assert scan.image("object_id", size=(2, 3)).tolist() == [[1, 2, -1], [-1, -1, 3]]
    missed = dataclasses.replace(scan, range=np.where(scan.object_id == 1, np.nan, scan.range))
    assert missed.image("object_id", size=(2, 3)).tolist() == [[0, 2, -1], [-1, -1, 3]]


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"field": "smell"}, ValueError, "field: expected one of range, true_range, "),
        ({"return_number": 2}, ValueError, "return_number: expected an integer from 1 to 1, got 2"),
        ({"size": 5}, TypeError, "size: expected (rows, columns), got 5"),
        ({"size": (0, 5)}, ValueError, "size: expected an integer >= 1, got 0"),
        (
            {},
            ValueError,
            "size: expected (rows, columns) of the image, since the pattern has none of its own, got None",
        ),
    ],
)
def test_images_that_cannot_be_are_refused(arguments: Any, error: type[Exception], message: str) -> None:
    scan = ls.Lidar.preset("livox-mid40").scan(ls.Scene())
    with pytest.raises(error, match=f"^{re.escape(message)}"):
        scan.image(**arguments)


@pytest.mark.parametrize("name", ["leica-als50", "riegl-vq780i", "riegl-vq880g", "livox-avia", "livox-mid360"])
def test_patterns_without_rows_and_columns_need_a_size(name: str) -> None:
    scan = ls.Lidar.preset(name).scan(ls.Scene())
    with pytest.raises(ValueError, match=r"^size: expected \(rows, columns\) of the image"):
        scan.image()
    assert scan.image("status", size=(3, 4)).shape == (3, 4)


# Points


def rounding(cloud: ls.PointCloud) -> Floats:
    """Bound between a surface and a point of the world: eight roundings of the range and of the position, 10 m."""
    return 8 * ROUNDING * (cloud.range + 10.0)


@pytest.mark.parametrize("columns", [1, 180, 700])
@pytest.mark.parametrize(
    "measurement",
    [
        EVERYTHING,
        ls.Measurement(range_sigma=0.01),
        ls.Measurement(dropout=0.6),
        dataclasses.replace(EVERYTHING, returns=5),
    ],
    ids=["two", "one", "few", "five"],
)
def test_points_are_the_returns(measurement: ls.Measurement, columns: int) -> None:
    """Pulses are fewer than one thread takes, and more than two take."""
    scan = lidar(measurement, columns=columns).scan(room(), TURNED, time=5.0)
    cloud = scan.point_cloud()
    most = scan.range.shape[1]
    has_return = np.arange(most) < scan.return_count[:, None]
    assert columns * 2 < has_return.sum() == len(cloud) < scan.range.size
    assert np.array_equal(has_return, np.isfinite(scan.range))
    assert columns == 1 or most == 1 or has_return[:, 1].any()
    pulse, number = np.nonzero(has_return)
    for name in ("range", "true_range", "range_error", "intensity", "object_id", "label", "incidence"):
        assert np.array_equal(getattr(cloud, name), getattr(scan, name)[has_return]), name
    for name in ("time", "ring", "column"):
        assert np.array_equal(getattr(cloud, name), getattr(scan.pulses, name)[pulse]), name
    assert np.array_equal(cloud.return_number, number + 1)
    assert np.array_equal(cloud.return_count, scan.return_count[pulse])
    expected = scan.pulses.origins[pulse] + scan.pulses.directions[pulse] * cloud.range[:, None]
    assert np.array_equal(cloud.xyz, expected)
    assert np.array_equal(cloud.range_error, cloud.range - cloud.true_range)
    back = TURNED.rotation.inv().apply(scan.normal[has_return].astype(float))
    assert np.allclose(cloud.normal, back, rtol=0, atol=2 * FLOAT32)  # both are rounded


def test_world_points_lie_on_the_surfaces() -> None:
    scan = lidar().scan(room(), TURNED)
    cloud = scan.point_cloud("world")
    assert (np.abs(cloud.xyz[:, 2] + 1.5)[cloud.label == 40] < rounding(cloud)[cloud.label == 40]).all()
    ball = cloud.xyz[cloud.label == 7] - (8, 2, 0)
    assert len(ball) > 20
    assert (np.abs(np.linalg.norm(ball, axis=1) - 1.5) < rounding(cloud)[cloud.label == 7]).all()
    assert np.allclose(cloud.normal[cloud.label == 7], ball / 1.5, rtol=0, atol=FLOAT32)
    assert (np.linalg.norm(TURNED.apply(scan.point_cloud().xyz) - cloud.xyz, axis=1) < rounding(cloud)).all()


def test_a_still_sensor_has_nothing_to_deskew() -> None:
    scan = lidar().scan(room(), TURNED)
    raw = scan.point_cloud()
    for moment in (True, "start", "middle", "end", 7.0, -7.0):
        deskewed = scan.point_cloud(deskew=moment)  # type: ignore[arg-type]
        assert raw.fields == deskewed.fields
        for name in raw.fields:
            assert np.array_equal(getattr(raw, name), getattr(deskewed, name)), name
    assert np.array_equal(scan.poses, np.tile(TURNED.as_matrix(), (len(scan), 1, 1)))


def test_poses_may_be_given_in_three_ways() -> None:
    by_transform = lidar().scan(room(), TURNED)
    by_matrix = lidar().scan(room(), TURNED.as_matrix())
    by_list = lidar().scan(room(), TURNED.as_matrix().tolist())
    assert_same(by_transform, by_matrix)
    assert_same(by_transform, by_list)
    assert_same(lidar().scan(room()), lidar().scan(room(), np.eye(4)))


def test_a_pose_kept_in_float32_is_a_rotation_all_the_same() -> None:
    exact, rounded = (lidar().scan(room(), pose) for pose in (TURNED, TURNED.as_matrix().astype(np.float32)))
    ground = rounded.point_cloud("world")
    ground = ground[ground.label == 40]
    assert len(ground) > 500
    assert (np.abs(ground.xyz[:, 2] + 1.5) < rounding(ground)).all()
    both = (exact.object_id == 0) & (rounded.object_id == 0)
    bound = 1e-6 * (exact.true_range + 10.0)[both] / np.cos(exact.incidence[both])
    assert (np.abs(exact.true_range - rounded.true_range)[both] < bound).all()


# Motion


def turn(angle: float) -> Rotation:
    return Rotation.from_euler("z", angle)


def drive() -> ls.Trajectory:
    poses = RigidTransform.concatenate(
        [
            RigidTransform.from_components([0.0, 0.0, 0.0], turn(0.0)),
            RigidTransform.from_components([0.5, 0.1, 0.0], turn(0.1) * Rotation.from_euler("x", 0.05)),
            RigidTransform.from_components([1.5, 0.0, 0.2], turn(-0.1)),
        ]
    )
    return ls.Trajectory([2.0, 2.05, 2.2], poses)


@pytest.mark.parametrize(
    "trajectory",
    [
        drive(),
        ls.Trajectory.from_twist(TURNED, linear=(10, 0, 1), angular=(0, 0.2, 1.0)),
        ls.Trajectory(drive().times, drive().poses, interpolation="spline"),
        drive() @ TURNED,
    ],
    ids=["knots", "twist", "spline", "mounted"],
)
def test_each_pulse_is_fired_from_its_own_pose(trajectory: ls.Trajectory) -> None:
    scene, sensor = room(), lidar()
    scan = sensor.scan(scene, trajectory, time=2.0)
    times, origins, directions = (np.array(getattr(scan.pulses, name)) for name in ("time", "origins", "directions"))
    assert len(np.unique(times)) > 100
    poses = trajectory.at(2.0 + times)
    origins, directions = poses.apply(origins), poses.rotation.apply(directions)
    hits = scene.cast(origins, directions)
    assert hits.hit.sum() > 1000
    assert np.array_equal(scan.object_id[:, 0], hits.object_id)
    bound = 2 * 8 * ROUNDING * (hits.t + 10.0)[hits.hit] / np.cos(scan.incidence[hits.hit, 0])
    assert (np.abs(scan.true_range[hits.hit, 0] - hits.t[hits.hit]) < bound).all()

    world = scan.point_cloud("world")
    at = (origins + directions * hits.t[:, None])[hits.hit]
    assert (np.linalg.norm(world.xyz - at, axis=1) < 2 * bound).all()
    assert (np.abs(world.xyz[:, 2] + 1.5)[world.label == 40] < rounding(world)[world.label == 40]).all()

    raw, straight = scan.point_cloud(), scan.point_cloud(deskew=True)
    start = trajectory.at(2.0)
    assert (np.linalg.norm(straight.xyz - start.inv().apply(world.xyz), axis=1) < 2 * rounding(world)).all()
    assert np.allclose(straight.normal, start.rotation.inv().apply(world.normal), rtol=0, atol=2 * FLOAT32)
    expected = (poses.inv().rotation.apply(scan.normal[:, 0].astype(float)))[hits.hit]
    assert np.allclose(raw.normal, expected, rtol=0, atol=2 * FLOAT32)
    assert np.array_equal(raw.range, straight.range)
    moved = np.linalg.norm(raw.xyz - straight.xyz, axis=1)
    assert moved[0] < 2 * rounding(world)[0]
    assert moved.max() > 0.3


@pytest.mark.parametrize(
    ("deskew", "moment"),
    [(True, 0.0), ("start", 0.0), ("middle", 0.05), ("end", 0.1), (0.03, 0.03), (np.float32(0.125), 0.125), (0, 0.0)],
)
@pytest.mark.parametrize(
    "sensor", [lidar(), dataclasses.replace(lidar(), pattern=ls.patterns.Grid([0.1, -0.1], [0.0], rate=10.0))]
)
def test_points_are_put_in_the_frame_of_any_moment(deskew: Any, moment: float, sensor: ls.Lidar) -> None:
    trajectory = drive()
    scan = sensor.scan(room(), trajectory, time=2.05)
    world, deskewed = scan.point_cloud("world"), scan.point_cloud(deskew=deskew)
    assert len(world) >= 2
    pose = trajectory.at(2.05 + moment)
    # Roundings as above, of another product of matrices.
    bound = 2 * rounding(world)
    assert (np.linalg.norm(pose.apply(deskewed.xyz) - world.xyz, axis=1) < bound).all()
    assert np.allclose(pose.rotation.apply(deskewed.normal), world.normal, rtol=0, atol=2 * FLOAT32)
    again = scan.point_cloud("world", deskew=deskew)
    assert np.array_equal(again.xyz, world.xyz)


@pytest.mark.parametrize(
    ("deskew", "error", "message"),
    [
        ("mid", ValueError, "True, False, 'start', 'middle', 'end' or seconds from the start of the scan, got 'mid'"),
        (None, TypeError, "True, False, 'start', 'middle', 'end' or seconds from the start of the scan, got None"),
        (math.nan, ValueError, "a finite number, got nan"),
        (-0.1, ValueError, "a moment within the trajectory, 2.0 to 2.2 s, got -0.1, at 1.9 s"),
        (0.25, ValueError, "a moment within the trajectory, 2.0 to 2.2 s, got 0.25, at 2.25 s"),
    ],
)
def test_moments_that_cannot_be_are_refused(deskew: Any, error: type[Exception], message: str) -> None:
    scan = lidar().scan(room(), drive(), time=2.0)
    with pytest.raises(error, match=f"^deskew: expected {re.escape(message)}$"):
        scan.point_cloud(deskew=deskew)


def test_each_pulse_has_its_pose() -> None:
    scan = lidar().scan(room(), drive(), time=2.0)
    assert scan.poses.shape == (len(scan), 4, 4)
    # SciPy makes rotations orthonormal anew, which rounds a few times.
    near = 8 * ROUNDING
    assert np.allclose(scan.poses, drive().at(2.0 + scan.pulses.time).as_matrix(), rtol=0, atol=near)
    assert (scan.poses[0] != scan.poses[-1]).any()


def test_a_trajectory_of_one_pose_is_that_pose() -> None:
    still = lidar().scan(room(), TURNED)
    for trajectory in (
        ls.Trajectory([-1.0, 9.0], RigidTransform.concatenate([TURNED, TURNED])),
        ls.Trajectory.from_twist(TURNED),
    ):
        moving = lidar().scan(room(), trajectory)
        assert_same(still, moving)
        assert np.array_equal(still.point_cloud("world").xyz, moving.point_cloud("world").xyz)


def test_a_trajectory_must_cover_all_pulses() -> None:
    sensor = ls.Lidar(ls.patterns.Table(np.tile([1, 0, 0], (5, 1)), times=[0, 0.01, 0.02, 0.03, 0.04], rate=10.0))
    short = ls.Trajectory([0.0, 0.025], np.array([np.eye(4)] * 2))
    message = "pose: expected a trajectory over all pulses, got one from 0 to 0.025 s and pulse 3 at 0.03 s"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        sensor.scan(room(), short)
    remedy = "; Trajectory.load(…, start=0), or start_s: 0 in a configuration, shifts its times"  # as of Unix time
    message = f"pose: expected a trajectory over all pulses, got one from 0 to 0.025 s and pulse 0 at -0.5 s{remedy}"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        sensor.scan(room(), short, time=-0.5)


def straight(end: float, *, until: float | None = None) -> ls.Trajectory:
    """10 m/s ahead and 1 rad/s to the left from 0 to `end` s; known `until` a later time, at that very velocity."""
    times = [0.0, end] if until is None else [0.0, end, until]
    poses = [RigidTransform.from_components([10.0 * time, 0.0, 0.0], turn(time)) for time in times]
    return ls.Trajectory(times, RigidTransform.concatenate(poses))


@pytest.mark.parametrize("name", ["velodyne-vlp16", "velodyne-hdl64e-s3", "robosense-rs32"])
def test_a_trajectory_to_the_end_of_the_frame_is_enough(name: str) -> None:
    sensor = ls.Lidar.preset(name)
    period = 1 / sensor.pattern.rate
    overrun = 0
    for frame in range(5):
        start, end = frame / sensor.pattern.rate, (frame + 1) / sensor.pattern.rate
        held = sensor.scan(room(), straight(end), time=start, frame=frame)
        late = start + held.pulses.time > end
        overrun += late.sum()
        # Within its span the poses are those that they were; after it, those of a trajectory that goes on so.
        known = sensor.scan(room(), straight(end, until=end + period), time=start, frame=frame)
        for field in ("range", "object_id", "intensity", "incidence"):
            assert np.array_equal(getattr(held, field)[~late], getattr(known, field)[~late], equal_nan=True)
        # Either is right to some eight roundings of numbers below 4.
        assert np.allclose(held.poses[late], known.poses[late], rtol=0, atol=2 * 8 * ROUNDING * 4)
        assert np.array_equal(np.isfinite(held.range), np.isfinite(known.range))
        assert len(held.point_cloud(deskew="end")) == len(known.point_cloud())
        part = scan_pulses(sensor, room(), straight(end), time=start, frame=frame, indices=np.flatnonzero(late))
        assert_same(part, held, late)
        # It is held for the pulses after the end of the frame alone.
        short = np.nextafter(start + held.pulses.time[held.pulses.time < period].max(), 0.0)
        with pytest.raises(ValueError, match=r"^pose: expected a trajectory over all pulses, got one from 0 to "):
            sensor.scan(room(), straight(short), time=start, frame=frame)
    assert overrun > 5


@pytest.mark.parametrize("mount", [None, TURNED], ids=["spline", "mounted"])
def test_a_spline_is_held_at_the_velocities_of_its_end(mount: RigidTransform | None) -> None:
    sensor, scene = ls.Lidar.preset("velodyne-hdl64e-s3"), room()
    end = 1 / sensor.pattern.rate
    times = np.linspace(0.0, end, 5)
    # It brakes, and turns about an axis that turns itself.
    poses = [
        RigidTransform.from_components([9 * t - 20 * t * t, t, 0.0], turn(2 * t) * Rotation.from_euler("x", 9 * t * t))
        for t in times
    ]
    body = ls.Trajectory(times, RigidTransform.concatenate(poses), interpolation="spline")
    mounted = RigidTransform.identity() if mount is None else mount
    scan = sensor.scan(scene, body if mount is None else body @ mount)
    late = scan.pulses.time > end
    assert late.sum() >= 20
    linear, angular = body.velocity(end)
    assert np.linalg.norm(linear) > 3
    assert np.linalg.norm(angular) > 2
    after = scan.pulses.time[late] - end
    last = body.at(end)
    at = RigidTransform.from_components(
        last.translation + after[:, None] * linear, last.rotation * Rotation.from_rotvec(after[:, None] * angular)
    )
    at = at * mounted
    off = 2 * 8 * ROUNDING * 4  # either is right to some eight roundings of numbers below 4
    assert np.abs(scan.poses[late] - at.as_matrix()).max() < off
    hits = scene.cast(at.apply(scan.pulses.origins[late]), at.rotation.apply(scan.pulses.directions[late]))
    assert hits.hit.sum() >= 10
    assert np.array_equal(scan.object_id[late, 0], hits.object_id)
    reached, rays = scan.true_range[late, 0][hits.hit], hits.t[hits.hit]
    # The poses are off in position and direction, and so are the ranges, over the cosine of the incidence.
    assert (np.abs(reached - rays) < off * (rays + 10) / np.cos(scan.incidence[late, 0][hits.hit])).all()


def test_a_trajectory_is_not_held_for_another_cycle() -> None:
    """A pattern of a user's own that fires a whole column after the end of its frame."""
    pattern = Given(np.tile([1.0, 0.0, 0.0], (3, 1)), np.zeros((3, 3)), np.array([0.0, 0.09, 0.11]))
    with pytest.raises(ValueError, match=r"got one from 0 to 0.1 s and pulse 2 at 0.11 s$"):
        ls.Lidar(pattern).scan(room(), straight(0.1))
    assert len(ls.Lidar(pattern).scan(room(), straight(0.11))) == 3
    one = ls.Trajectory([0.0], [TURNED.as_matrix()])
    with pytest.raises(ValueError, match=r"got one from 0 to 0 s and pulse 1 at 0.09 s$"):
        ls.Lidar(pattern).scan(room(), one)


# The same bits


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    return lambda n: monkeypatch.setenv("LIDARSIM_THREADS", str(n))


MEASUREMENTS = pytest.mark.parametrize(
    "measurement",
    [
        EVERYTHING,
        dataclasses.replace(EVERYTHING, beam=None, returns=1),
        WHOLE,
        *(dataclasses.replace(WHOLE, beam=None, returns=mode) for mode in ("strongest", "first", "last")),
    ],
    ids=["everything", "ray", "whole", "strongest of whole", "first of whole", "last of whole"],
)


@MEASUREMENTS
def test_threads_change_nothing(threads: Callable[[int], None], measurement: ls.Measurement) -> None:
    sensor, path = lidar(measurement, columns=1024), ls.Trajectory.from_twist(TURNED, (3, 0, 0), (0, 0, 1))
    threads(1)
    one = sensor.scan(shiny_room(), path)
    assert (one.status == ls.Status.hit).sum() > 5000
    clouds = [one.point_cloud(deskew=True)]
    for n in (2, 7):
        threads(n)
        again = sensor.scan(shiny_room(), path)
        assert_same(one, again)
        clouds.append(again.point_cloud(deskew=True))
    for name in clouds[0].fields:
        for other in clouds[1:]:
            assert getattr(clouds[0], name).tobytes() == getattr(other, name).tobytes(), name


@MEASUREMENTS
def test_instruction_sets_change_nothing(monkeypatch: pytest.MonkeyPatch, measurement: ls.Measurement) -> None:
    sensor, names = lidar(measurement), ("scalar", "avx2", "avx512")
    best = _native.isa()
    expected = sensor.scan(shiny_room(), TURNED)
    for name in names[: names.index(best) + 1]:
        monkeypatch.setenv("LIDARSIM_ISA", name)
        assert _native.isa() == name
        assert_same(expected, sensor.scan(shiny_room(), TURNED))


@MEASUREMENTS
def test_a_pulse_is_the_same_in_any_company(measurement: ls.Measurement) -> None:
    sensor = lidar(measurement)
    whole = sensor.scan(shiny_room(), seed=5, frame=2)
    generator = np.random.default_rng(3)
    for indices in (
        np.arange(len(whole)),
        generator.permutation(len(whole)),
        np.arange(len(whole))[::-1],
        np.array([17]),
        generator.choice(len(whole), 700, replace=False),
        np.array([3, 3, 3]),
    ):
        part = scan_pulses(sensor, shiny_room(), seed=5, frame=2, indices=indices)
        assert_same(part, whole, indices)
        assert np.array_equal(part.pulses.ring, whole.pulses.ring[indices])
    assert len(scan_pulses(sensor, room(), indices=[]).status) == 0


def test_seed_frame_and_name_each_give_other_noise() -> None:
    def ranges(*, name: str = "top", **keywords: int) -> Floats:
        sensor = lidar(ls.Measurement(range_sigma=0.01), name=name)
        return sensor.scan(room(), **keywords).range[:, 0]

    first = ranges()
    assert np.array_equal(first, ranges(), equal_nan=True)
    for other in (ranges(seed=1), ranges(seed=2**64 - 1), ranges(frame=1), ranges(name="rear")):
        hit = np.isfinite(first)
        assert np.array_equal(hit, np.isfinite(other))
        assert (first[hit] != other[hit]).mean() > 0.999


def test_scans_in_many_python_threads_at_once() -> None:
    sensor, scene = lidar(EVERYTHING), room()
    expected = [lidar(EVERYTHING).scan(room(), seed=seed) for seed in range(8)]
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        for one, other in zip(expected, pool.map(lambda seed: sensor.scan(scene, seed=seed), range(8)), strict=True):
            assert_same(one, other)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this platform does not fork")
def test_a_forked_child_scans() -> None:
    sensor = lidar(EVERYTHING)
    expected = np.nansum(sensor.scan(room()).range)
    child = os.fork()
    if not child:
        os._exit(0 if np.nansum(sensor.scan(room()).range) == expected else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


# Bad input


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"seed": -1}, ValueError, "seed: expected an integer from 0 to 18446744073709551615, got -1"),
        ({"seed": 2**64}, ValueError, f"seed: expected an integer from 0 to {2**64 - 1}, got {2**64}"),
        ({"seed": 1.5}, TypeError, "seed: expected an integer from 0 to 18446744073709551615, got 1.5"),
        ({"frame": -1}, ValueError, "frame: expected an integer from 0 to 4294967295, got -1"),
        ({"frame": 2**32}, ValueError, "frame: expected an integer from 0 to 4294967295, got 4294967296"),
        ({"time": math.nan}, ValueError, "time: expected a finite number, got nan"),
        ({"pose": np.eye(3)}, ValueError, "pose: expected shape (4, 4), got (3, 3); a rotation is pose[:3, :3]"),
        ({"scene": "street"}, TypeError, "scene: expected a Scene, got 'street'"),
    ],
)
def test_arguments_that_cannot_be_are_refused(keywords: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        lidar().scan(**{"scene": room(), **keywords})


def test_a_pose_that_is_not_rigid_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^pose: expected a rigid transform"):
        lidar().scan(room(), np.diag([2.0, 2.0, 2.0, 1.0]))
    with pytest.raises(ValueError, match=r"^pose: expected a rigid transform"):
        lidar().scan(room(), np.diag([1.0, 1.0, -1.0, 1.0]))


@pytest.mark.parametrize(
    ("indices", "message"),
    [
        ([2880], "indices: expected 0 to 2879, got indices[0] = 2880"),
        ([0, -1], "indices: expected 0 to 2879, got indices[1] = -1"),
        ([0.5], "indices: expected integers of shape (m,), got float64 of shape (1,)"),
        ([[1]], "indices: expected integers of shape (m,), got int64 of shape (1, 1)"),
    ],
)
def test_indices_that_cannot_be_are_refused(indices: list[Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        scan_pulses(lidar(), room(), indices=indices)


def test_an_unknown_frame_of_points_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^frame: expected 'sensor' or 'world', got 'map'$"):
        lidar().scan(room()).point_cloud("map")  # type: ignore[arg-type]


@dataclass
class Given:
    """A pattern of a user's own, whatever it holds."""

    directions: Floats
    origins: Floats
    time: Floats
    rate: float = 10.0
    shape: tuple[int, int] = (1, 3)

    def pulses(self, frame: int = 0) -> Pulses:
        n = len(self.directions)
        return Pulses(self.directions, self.origins, self.time, np.zeros(n, np.uint16), np.arange(n, dtype=np.uint32))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"directions": [[1, 0, 0], [0, 2, 0], [0, 0, 1]]},
            "pulses.directions: expected unit vectors, got pulses.directions[1] = (0, 2, 0)",
        ),
        (
            {"directions": [[1, 0, 0], [0, 1, 0], [0, 0, math.nan]]},
            "pulses.directions: expected unit vectors, got pulses.directions[2] = (0, 0, NaN)",
        ),
        (
            {"origins": [[math.inf, 0, 0], [0, 0, 0], [0, 0, 0]]},
            "pulses.origins: expected finite numbers, got pulses.origins[0] = (inf, 0, 0)",
        ),
        (
            {"time": [0.0, 0.0]},
            "time: expected shape (3,), got (2,)",
        ),
        (
            {"time": [0.0, math.nan, 0.0]},
            "time: expected finite numbers, got time[1] = nan",
        ),
    ],
)
@pytest.mark.parametrize(
    "measurement",
    [
        ls.Measurement(),
        ls.Measurement(azimuth_sigma=1e-3),
        ls.Measurement(beam=ls.Beam(1e-3, rays=7)),
        ls.Measurement(elevation_sigma=1e-3, beam=ls.Beam(1e-3, rays=7)),
    ],
    ids=["plain", "jitter", "beam", "both"],
)
def test_pulses_that_cannot_be_fired_are_refused(
    wrong: dict[str, Any], message: str, measurement: ls.Measurement
) -> None:
    parts = {"directions": np.eye(3), "origins": np.zeros((3, 3)), "time": np.zeros(3)}
    parts.update({name: np.array(values, dtype=float) for name, values in wrong.items()})
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Lidar(Given(**parts), measurement=measurement).scan(room())


@pytest.mark.parametrize(
    "measurement", [ls.Measurement(range_sigma=0.02), ls.Measurement(azimuth_sigma=1e-3), EVERYTHING]
)
@pytest.mark.parametrize("moves", [False, True])
def test_one_origin_of_all_pulses_is_as_good_as_each(measurement: ls.Measurement, moves: bool) -> None:
    """The bits of a scan and of its points are those of pulses with an origin each, of which only the last differs."""
    given = lidar(columns=100).pattern.pulses()
    count = len(given)
    origins = np.full((count + 1, 3), [0.05, -0.02, 0.04])
    origins[count] = 0.0
    directions, time = np.vstack([given.directions, [1.0, 0.0, 0.0]]), np.append(given.time, 0.099)
    each = ls.Lidar(Given(directions, origins, time, shape=(1, count + 1)), measurement=measurement)
    one = ls.Lidar(Given(directions[:-1], origins[:-1], time[:-1], shape=(1, count)), measurement=measurement)
    pose = (
        ls.Trajectory([0.0, 0.1], RigidTransform.concatenate([RigidTransform.identity(), TURNED])) if moves else TURNED
    )
    found, other = one.scan(room(), pose, seed=3), each.scan(room(), pose, seed=3)
    assert_same(found, other, slice(count))
    views: list[dict[str, Any]] = [{}, {"frame": "world"}, {"deskew": "middle"}]
    for options in views:
        points, others = found.point_cloud(**options), other.point_cloud(**options)
        assert 500 < len(points) <= len(others)
        assert points.xyz.tobytes() == others.xyz[: len(points)].tobytes()
        assert points.normal.tobytes() == others.normal[: len(points)].tobytes()


class Raw:
    """A pattern that knows nothing of lidarsim: what its pulses are like is up to the test."""

    rate = 10
    shape = (1, 3)

    def __init__(self, **arrays: Any) -> None:
        self.arrays = {
            "directions": [[1, 0, 0], [0.8, 0.6, 0], [0.6, 0.8, 0]],
            "origins": [[0, 0, 0]] * 3,
            "time": [0, 1e-3, 2e-3],
            "ring": [0, 0, 0],
            "column": [0, 1, 2],
            **arrays,
        }

    def pulses(self, frame: int = 0) -> Any:
        return types.SimpleNamespace(**self.arrays)


@pytest.mark.parametrize(
    "arrays",
    [
        {},
        {"directions": np.float32([[1, 0, 0], [0.8, 0.6, 0], [0.6, 0.8, 0]])},
        {"directions": np.asfortranarray([[1, 0, 0], [0.8, 0.6, 0], [0.6, 0.8, 0]])},
        {"time": np.array([0, 0, 0]), "ring": np.zeros(3), "column": np.arange(6, dtype=np.uint32)[::2]},
    ],
    ids=["lists", "float32", "Fortran", "other types"],
)
def test_pulses_of_any_kind_are_converted(arrays: dict[str, Any]) -> None:
    scan = ls.Lidar(Raw(**arrays)).scan(room())
    given = Given(np.array([[1, 0, 0], [0.8, 0.6, 0], [0.6, 0.8, 0]]), np.zeros((3, 3)), np.zeros(3))
    # Directions in float32 are off by 2⁻²⁴, which a grazing wall makes at most ten times as much of.
    assert np.allclose(scan.range, ls.Lidar(given).scan(room()).range, rtol=10 * FLOAT32, atol=0)
    assert np.isfinite(scan.range).all()
    assert len(scan.point_cloud()) == np.isfinite(scan.image()).sum() == 3
    assert [getattr(scan.pulses, name).dtype.name for name in ("directions", "ring", "column")] == [
        "float64", "uint16", "uint32",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("arrays", "error", "message"),
    [
        ({"directions": [1, 0, 0]}, ValueError, "directions: expected shape (n, 3), got (3,); of one, [[x, y, z]]"),
        ({"directions": [["x"] * 3]}, TypeError, "directions: expected real numbers of shape (n, 3), got dtype <U1"),
        ({"origins": [0, 0, 0]}, ValueError, "origins: expected shape (3, 3), got (3,)"),
        ({"time": 0.0}, ValueError, "time: expected shape (3,), got ()"),
        ({"ring": np.zeros(2, np.uint16)}, ValueError, "ring: expected shape (3,), got (2,)"),
        ({"ring": [0, -1, 0]}, ValueError, "ring: expected integers from 0 to 65535, got ring[1] = -1"),
        ({"ring": [0, [0], 0]}, ValueError, "ring: expected numbers of shape (3,), got a ragged sequence"),
        ({"ring": [0, 0, 0.5]}, ValueError, "ring: expected integers from 0 to 65535, got ring[2] = 0.5"),
        (
            {"column": [0, 2**32, 0]},
            ValueError,
            "column: expected integers from 0 to 4294967295, got column[1] = 4.29497e+09",
        ),
    ],
)
def test_pulses_that_are_none_are_refused_by_name(arrays: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        ls.Lidar(Raw(**arrays)).scan(room())


def test_a_pattern_must_give_pulses() -> None:
    class Wrong(Raw):
        def pulses(self, frame: int = 0) -> Any:
            return np.zeros((frame + 3, 3))

    message = (
        "pattern.pulses: expected Pulses, with directions, origins, time, ring, column, got ndarray without directions"
    )
    with pytest.raises(TypeError, match=f"^{re.escape(message)}$"):
        ls.Lidar(Wrong()).scan(room())


def test_directions_kept_in_float32_will_do() -> None:
    direction = np.array([[0.6, 0.48, 0.64]], dtype=np.float32).astype(float)
    scan = ls.Lidar(Given(direction, np.zeros((1, 3)), np.zeros(1))).scan(room())
    t = room().cast(np.zeros((1, 3)), direction).t
    length = math.sqrt(math.fsum(x * x for x in direction[0]))
    assert length != 1.0
    assert scan.true_range[0, 0] == pytest.approx(t[0] * length, rel=4 * ROUNDING)


def test_clouds_of_some_fields_are_those_of_all_with_fewer() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -2.0))
    scene.add(ls.Sphere((9, 1, 0), 3.0), motion=ls.Trajectory.from_twist(np.eye(4), (4, 0, 0), (0, 0, 1)))
    drive = ls.Trajectory.from_twist(np.eye(4), linear=(20, 0, 0), angular=(0.1, 0, 0.8))
    seen = dataclasses.replace(ls.Lidar.preset("velodyne-vlp16"), measurement=dataclasses.replace(WHOLE, depth=2))
    options: list[dict[str, Any]] = [
        {},
        {"frame": "world"},
        {"deskew": "middle"},
        {"deskew": "end", "deskew_movers": True},
        {"pose": np.eye(4)},
    ]
    for scan, given in [(seen.scan(scene, drive, seed=3), each) for each in options] + [(seen.scan(ls.Scene()), {})]:
        whole = scan.point_cloud(**given)
        for wanted in ([], ["xyz"], ["label", "intensity"], {"normal", "time"}, *([name] for name in whole.fields)):
            some = scan.point_cloud(**given, fields=wanted)
            assert set(some.fields) == {"xyz", *wanted}
            for name in some.fields:
                np.testing.assert_array_equal(getattr(some, name), getattr(whole, name))
                assert getattr(some, name).dtype == getattr(whole, name).dtype
        assert set(scan._cloud_fields()) == set(whole.fields)
    assert {"radial_velocity", "source", "path"} <= set(seen.scan(scene, drive).point_cloud().fields)
    with pytest.raises(
        ValueError, match=r"^fields: expected fields of this point cloud \(xyz, range, .*\), got 'rang'$"
    ):
        scan.point_cloud(fields=["rang"])
    with pytest.raises(ValueError, match=r"got 'radial_velocity'$"):
        scan.point_cloud(fields=["radial_velocity"])
    with pytest.raises(TypeError, match=r"^fields: expected a sequence of names, got 'label'$"):
        scan.point_cloud(fields="label")


def test_points_placed_by_another_trajectory() -> None:
    """Beside the true points, moved from the true pose of their pulse to the other one."""
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -2.0))
    scene.add(ls.Sphere((15, 3, 0), 4.0))
    drive = ls.Trajectory.from_twist(np.eye(4), linear=(20, 0, 0), angular=(0.1, 0, 0.8))
    scan = ls.Lidar.preset("velodyne-vlp16").scan(scene, drive)
    other = drive.perturbed(position_sigma=0.3, boresight=(0.01, 0.02, -0.03), lever_arm=(0.1, 0, 0), seed=2)
    true, raw = scan.point_cloud("world"), scan.point_cloud()
    assert len(raw) > 5000
    moved = other.at(raw.time) * drive.at(raw.time).inv()
    placed = scan.point_cloud("world", pose=other)
    rounding = 32 * 2.0**-46  # some 30 roundings of coordinates below 128
    assert np.abs(true.xyz).max() < 127
    np.testing.assert_allclose(placed.xyz, moved.apply(true.xyz), rtol=0, atol=rounding)
    np.testing.assert_allclose(placed.normal, moved.rotation.apply(true.normal), rtol=0, atol=4 * 2.0**-24)
    assert np.abs(placed.xyz - true.xyz).max() > 0.1
    start = scan.point_cloud(deskew="start", pose=other)
    np.testing.assert_allclose(start.xyz, other.at(0.0).inv().apply(placed.xyz), rtol=0, atol=rounding)
    np.testing.assert_array_equal(scan.point_cloud(pose=other).xyz, raw.xyz)
    np.testing.assert_array_equal(scan.point_cloud("world", pose=drive).xyz, true.xyz)
    still = scan.point_cloud("world", pose=np.eye(4))
    np.testing.assert_array_equal(still.xyz, raw.xyz)
    late = ls.Trajectory([0.05, 1.0], [np.eye(4)] * 2)
    with pytest.raises(ValueError, match=r"^pose: expected a trajectory over all pulses, got one from 0\.05 to 1\.0 s"):
        scan.point_cloud("world", pose=late)
    with pytest.raises(ValueError, match=r"^deskew_movers: expected none with another pose, as motions are the true"):
        scan.point_cloud(deskew=True, deskew_movers=True, pose=other)


def test_a_trajectory_in_unix_time_is_told_how_to_start_at_zero() -> None:
    unix = ls.Trajectory([1.7e9, 1.7e9 + 1.0], [np.eye(4)] * 2)
    with pytest.raises(
        ValueError, match=r"got one from 1700000000\.0 to 1700000001\.0 s .*; Trajectory\.load\(…, start=0\)"
    ):
        lidar().frames(ls.Scene(), unix, 2)
    short = ls.Trajectory([0.0, 0.05], [np.eye(4)] * 2)
    with pytest.raises(ValueError, match=r"got one from 0\.0 to 0\.05 s and pulse \d+ at [0-9.e+-]+ s$"):
        lidar().frames(ls.Scene(), short, 2)


def test_single_returns_are_views_without_the_axis_of_returns() -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((10, 0, 0), 2.0), motion=ls.Trajectory.from_twist(np.eye(4), (1, 0, 0)))
    noise = ls.Measurement(range_sigma=0.01, azimuth_sigma=1e-3)
    scan = dataclasses.replace(lidar(columns=10), measurement=noise).scan(scene)
    single = scan.single
    for name in ScanColumns._columns:
        view, whole = getattr(single, name), getattr(scan, name)
        if whole is None:
            assert view is None
            continue
        assert view.shape == (len(scan), *whole.shape[2:])
        assert np.shares_memory(view, whole)
        assert np.array_equal(view, whole.reshape(view.shape), equal_nan=whole.dtype.kind == "f")
    dual = dataclasses.replace(lidar(columns=10), measurement=ls.Measurement(beam=ls.Beam(0.01), returns="dual"))
    with pytest.raises(
        ValueError, match=r"single: expected a sensor with one return per pulse, got up to 2; scan.range"
    ):
        _ = dual.scan(scene).single


def test_a_scan_keeps_the_pose_that_it_was_given() -> None:
    pose, sensor = np.eye(4), lidar(columns=4)
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -3.0))
    scan = sensor.scan(scene, pose)
    before = scan.point_cloud("world").xyz
    pose[2, 3] = 9.0  # the caller's array goes on to the next step
    assert np.array_equal(scan.point_cloud("world").xyz, before)


def test_nearly_rigid_poses_are_refused_with_the_repair() -> None:
    rotation = Rotation.from_euler("zyx", [0.3, 0.2, 0.1]).as_matrix()
    sensor, pose = lidar(columns=4), np.eye(4)
    hint = "orthonormalise it: Rotation.from_matrix(T[:3, :3]).as_matrix() of scipy.spatial.transform"
    for error, repaired in ((1e-7, None), (1e-5, True), (4e-4, True), (2e-3, False)):
        pose[:3, :3] = rotation * (1.0 + error / 2.0)
        if repaired is None:
            sensor.scan(ls.Scene(), pose)
            continue
        with pytest.raises(ValueError, match="pose: expected a rigid transform") as caught:
            sensor.scan(ls.Scene(), pose)
        assert (hint in str(caught.value)) == repaired
        pose[:3, :3] = Rotation.from_matrix(pose[:3, :3]).as_matrix()
        sensor.scan(ls.Scene(), pose)
    pose[:3, :3] = np.diag([1.0, 1.0, -1.0])
    with pytest.raises(ValueError, match="a reflection, determinant -1"):
        sensor.scan(ls.Scene(), pose)


def test_each_of_neighbouring_pulses_is_measured_on_its_own_object() -> None:
    """Eight are measured together; here the first and the last of them hit the same object, and the others do not."""
    azimuths, scene = 0.2 * np.arange(7), ls.Scene()
    for k, azimuth in enumerate(azimuths):
        center = 10.0 * np.cos(azimuth), 10.0 * np.sin(azimuth), 0.0
        scene.add(ls.Sphere(center, 0.5), label=k + 1, material=ls.Material(reflectivity=(k + 1) / 8))
    lidar = ls.Lidar(ls.patterns.Grid(azimuths, [0.0], rate=10.0))
    found = scan_pulses(lidar, scene, indices=[*range(7), 0]).single
    expected = np.array([*range(7), 0])
    np.testing.assert_array_equal(found.object_id, expected)
    np.testing.assert_array_equal(found.label, expected + 1)
    np.testing.assert_array_equal(found.instance, expected + 1)
    # The incidence is 0 but for roundings, of which its cosine takes the square.
    np.testing.assert_allclose(found.intensity, (expected + 1) / 8, rtol=FLOAT32)
