"""Common mistakes: each error names the argument, the expectation and the value."""

import contextlib
import dataclasses
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.errors import ArgumentError
from lidarsim.io import npz
from lidarsim.io.scenes import mjcf
from lidarsim.io.trajectories import tum
from lidarsim.scan.columns import ScanColumns
from lidarsim.scan.formats import FORMATS

T = np.eye(4)
T[:3, 3] = (1, 2, 3)
BALL = ls.Sphere((5, 0, 0), 1.0)
MESH = ls.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
LIDAR = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0))
CLOUD = ls.PointCloud(xyz=np.zeros((3, 3)), label=[1, 2, 3])
DRIVE = ls.Trajectory([0.0, 1.0], np.stack([np.eye(4), T]))
SCENE = ls.Scene()
SCENE.add(BALL)
ALWAYS = [name for name, column in ScanColumns._columns.items() if not column.condition]


def read_only(batch: ls.ScanBatch) -> ls.ScanBatch:
    batch.range.setflags(write=False)
    return batch


def register_trajectories(**changes: Any) -> None:
    given = {"recognise": tum.recognise, "read": tum.read, "suffixes": (".mine",), "write": tum.write}
    ls.register_trajectory_format("mine", "a line", **given | changes)


def takes_a_path(_: object) -> bool:
    return True


MISTAKES: dict[str, tuple[Callable[[], Any], type[Exception], str]] = {
    "a suffix without its dot": (
        lambda: ls.register_format("mine", save=npz.save, load=npz.load),
        ValueError,
        "suffix: expected a suffix with its dot, in lower case, such as .pcd, got 'mine'",
    ),
    "a suffix in upper case": (
        lambda: ls.register_format(".MINE", save=npz.save, load=npz.load),
        ValueError,
        "suffix: expected a suffix with its dot, in lower case, such as .pcd, got '.MINE'",
    ),
    "a format that saves to a path alone": (
        lambda: ls.register_format(".mine", save=takes_a_path, load=npz.load),
        TypeError,
        "save: expected a function of fields and a file, got one of (_: object) -> bool",
    ),
    "a format without a function": (
        lambda: ls.register_format(".mine", save=npz.save, load=None),
        TypeError,
        "load: expected a function of a file, got None",
    ),
    "a signature in text": (
        lambda: ls.register_format(".mine", save=npz.save, load=npz.load, signature="PK"),
        TypeError,
        "signature: expected bytes, got 'PK'",
    ),
    "a format of trajectories with one suffix": (
        lambda: register_trajectories(suffixes=".mine"),
        TypeError,
        "suffixes: expected a tuple of suffixes, got '.mine'",
    ),
    "a format of trajectories whose suffix has no dot": (
        lambda: register_trajectories(suffixes=(".mine", "mine")),
        ValueError,
        "suffixes[1]: expected a suffix with its dot, in lower case, such as .pcd, got 'mine'",
    ),
    "a format of trajectories that writes no times": (
        lambda: register_trajectories(write=takes_a_path),
        TypeError,
        "write: expected a function of times, poses and a file, got one of (_: object) -> bool",
    ),
    "a reader of sensors that recognises paths alone": (
        lambda: ls.register_lidar_reader("mine", takes_a_path, takes_a_path),
        TypeError,
        "recognise: expected a function of a path and a text, got one of (_: object) -> bool",
    ),
    "a reader of scenes that reads nothing": (
        lambda: ls.register_scene_reader("mine", mjcf.recognise, lambda: SCENE),
        TypeError,
        "read: expected a function of a path, got one of ()",
    ),
    "elevations in degrees": (
        lambda: ls.patterns.Spinning(np.linspace(-15, 15, 16)),
        ValueError,
        "elevations: expected numbers from -1.5708 to 1.5708, got elevations[0] = -15; degrees?",
    ),
    "fov in degrees": (
        lambda: ls.patterns.Spinning([0.0], field_of_view=360),
        ValueError,
        "field_of_view: expected a finite number > 0 and <= 6.28319, got 360.0; degrees?",
    ),
    "azimuths in degrees": (
        lambda: ls.patterns.Grid([-45.0, 0, 45], [0.0], rate=10),
        ValueError,
        "azimuths: expected numbers from -6.28319 to 6.28319, got azimuths[0] = -45; degrees?",
    ),
    "divergence in mrad": (
        lambda: ls.Beam(3.0),
        ValueError,
        "divergence_azimuth: expected a finite number from 0 to 0.1, got 3.0; mrad?",
    ),
    "jitter in degrees": (
        lambda: ls.Measurement(azimuth_sigma=2.0),
        ValueError,
        "azimuth_sigma: expected a finite number from 0 to 1, got 2.0; degrees?",
    ),
    "dropout in percent": (
        lambda: ls.Measurement(dropout=5),
        ValueError,
        "dropout: expected a finite number from 0 to 1, got 5.0",
    ),
    "reflectivity in percent of detection": (
        lambda: ls.Detection(10, 150),
        ValueError,
        "reflectivity: expected a finite number > 0 and <= 1, got 10.0; percent?",
    ),
    "negative range of detection": (
        lambda: ls.Detection(0.1, -150),
        ValueError,
        "range: expected a finite number > 0, got -150.0",
    ),
    "negative reflectivity": (
        lambda: ls.Material(reflectivity=-0.1),
        ValueError,
        "reflectivity: expected a finite number >= 0, got -0.1",
    ),
    "colour as reflectivity": (
        lambda: ls.Material(reflectivity=(0.5, 0.5, 0.5)),
        TypeError,
        "reflectivity: expected one number, or an array with per='face' or per='vertex', got (0.5, 0.5, 0.5)",
    ),
    "sphere, radius first": (
        lambda: ls.Sphere(1.0, (0, 0, 0)),
        ValueError,
        "center: expected shape (3,), got ()",
    ),
    "sphere without radius": (
        lambda: ls.Sphere((0, 0, 0)),
        TypeError,
        "Sphere: expected the arguments center, radius, transform, got missing a required argument: 'radius'",
    ),
    "negative radius": (
        lambda: ls.Sphere((0, 0, 0), -1.0),
        ValueError,
        "radius: expected a finite number > 0, got -1.0",
    ),
    "center of two numbers": (
        lambda: ls.Sphere((0, 0), 1.0),
        ValueError,
        "center: expected shape (3,), got (2,)",
    ),
    "center as text": (
        lambda: ls.Sphere("0 0 0", 1.0),
        TypeError,
        "center: expected real numbers of shape (3,), got '0 0 0'",
    ),
    "box by min and max swapped sign": (
        lambda: ls.Box((-1, 2, 3)),
        ValueError,
        "size: expected numbers > 0, got size[0] = -1.0",
    ),
    "box of one size": (
        lambda: ls.Box(2.0),
        ValueError,
        "size: expected shape (3,), got ()",
    ),
    "plane arguments swapped": (
        lambda: ls.Plane(0.0, (0, 0, 1)),
        ValueError,
        "normal: expected shape (3,), got ()",
    ),
    "zero normal": (
        lambda: ls.Plane((0, 0, 0), 1.0),
        ValueError,
        "normal: expected non-zero vectors, got normal = (0, 0, 0)",
    ),
    "points on one line": (
        lambda: ls.Plane.from_points((0, 0, 0), (1, 0, 0), (2, 0, 0)),
        ValueError,
        (
            "a, b, c: expected three points that are not on one line, "
            "got [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]"
        ),
    ),
    "cylinder with a height": (
        lambda: ls.Cylinder((0, 0, 0), 2.0, 0.5),
        ValueError,
        "end: expected shape (3,), got ()",
    ),
    "cylinder of no length": (
        lambda: ls.Cylinder((0, 0, 0), (0, 0, 0), 0.5),
        ValueError,
        "end: expected a point other than start, got (0.0, 0.0, 0.0) for both",
    ),
    "polygon that crosses itself": (
        lambda: ls.Polygon([(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0)]),
        ValueError,
        "vertices: expected a polygon with an area, got area 0",
    ),
    "polygon not planar": (
        lambda: ls.Polygon([(0, 0, 0), (1, 0, 0), (1, 1, 1), (0, 1, 0)]),
        ValueError,
        "vertices: expected points of one plane to within rounding (5.33e-15 m), got a deviation of 0.204 m",
    ),
    "1-based faces": (
        lambda: ls.TriangleMesh(np.eye(3), [[1, 2, 3]]),
        ValueError,
        "faces: expected indices from 0 to 2, got faces[0][2] = 3; counted from 1?",
    ),
    "faces of floats": (
        lambda: ls.TriangleMesh(np.eye(3), [[0.0, 1.0, 2.0]]),
        TypeError,
        "faces: expected integers of shape (m, 3), got dtype float64",
    ),
    "quads": (
        lambda: ls.TriangleMesh(np.zeros((4, 3)), [[0, 1, 2, 3]]),
        ValueError,
        "faces: expected shape (m, 3), got (1, 4)",
    ),
    "vertices transposed": (
        lambda: ls.TriangleMesh(np.zeros((3, 8)), [[0, 1, 2]]),
        ValueError,
        "vertices: expected shape (n, 3), got (3, 8); transposed?",
    ),
    "faces and vertices swapped": (
        lambda: ls.TriangleMesh([[0, 1, 2]], np.eye(3)),
        TypeError,
        "faces: expected integers of shape (m, 3), got dtype float64",
    ),
    "mesh file missing": (
        lambda: ls.TriangleMesh.from_file("car.obj"),
        FileNotFoundError,
        "car.obj: no such mesh file",
    ),
    "transposed pose": (
        lambda: LIDAR.scan(SCENE, T.T),
        ValueError,
        "pose: expected a last row of (0, 0, 0, 1), got (1.0, 2.0, 3.0, 1.0); transposed?",
    ),
    "3x4 pose": (
        lambda: LIDAR.scan(SCENE, T[:3]),
        ValueError,
        "pose: expected shape (4, 4), got (3, 4); its last row is (0, 0, 0, 1)",
    ),
    "position as pose": (
        lambda: LIDAR.scan(SCENE, (0, 0, 2)),
        ValueError,
        "pose: expected shape (4, 4), got (3,); a position is the last column, pose[:3, 3]",
    ),
    "rotation as pose": (
        lambda: LIDAR.scan(SCENE, Rotation.identity()),
        TypeError,
        "pose: expected a RigidTransform or an array of shape (4, 4), got a Rotation",
    ),
    "scaled pose": (
        lambda: LIDAR.scan(SCENE, np.diag([2.0, 2, 2, 1])),
        ValueError,
        "pose: expected a rigid transform (orthonormal rotation), got one 3 away from it, determinant 8",
    ),
    "mirrored pose": (
        lambda: LIDAR.scan(SCENE, np.diag([1.0, -1, 1, 1])),
        ValueError,
        "pose: expected a rigid transform (orthonormal rotation), got a reflection, determinant -1",
    ),
    "nan pose": (
        lambda: LIDAR.scan(SCENE, np.full((4, 4), np.nan)),
        ValueError,
        "pose: expected finite numbers, got pose[0][0] = nan",
    ),
    "pose and scene swapped": (
        lambda: LIDAR.scan(T, SCENE),
        TypeError,
        "scene: expected a Scene, got an array of shape (4, 4); scan(scene, pose)",
    ),
    "forgotten time on a trajectory": (
        lambda: LIDAR.scan(SCENE, DRIVE, time=5.0),
        ValueError,
        "pose: expected a trajectory over all pulses, got one from 0 to 1 s and pulse 0 at 5 s",
    ),
    "time in ns": (
        lambda: LIDAR.scan(SCENE, DRIVE, time=1_700_000_000_000_000_000),
        ValueError,
        "pose: expected a trajectory over all pulses, got one from 0 to 1 s and pulse 0 at 1700000000000000000 s",
    ),
    "frame as float": (
        lambda: LIDAR.scan(SCENE, frame=1.5),
        TypeError,
        "frame: expected an integer from 0 to 4294967295, got 1.5",
    ),
    "negative seed": (
        lambda: LIDAR.scan(SCENE, seed=-1),
        ValueError,
        "seed: expected an integer from 0 to 18446744073709551615, got -1",
    ),
    "frames without pose": (
        lambda: list(LIDAR.frames(SCENE, 10)),
        TypeError,
        "Lidar.frames() missing 1 required positional argument: 'count'",
    ),
    "min and max range swapped": (
        lambda: ls.Lidar(LIDAR.pattern, min_range=100, max_range=1),
        ValueError,
        "max_range: expected a real number >= 100, got 1.0",
    ),
    "t_min over t_max": (
        lambda: SCENE.cast([[0, 0, 0]], [[1, 0, 0]], t_min=5, t_max=1),
        ValueError,
        "t_max: expected a real number >= 5, got 1.0",
    ),
    "ranges in mm as text": (
        lambda: ls.Lidar(LIDAR.pattern, max_range="120 m"),
        TypeError,
        "max_range: expected a real number >= 0, got '120 m'",
    ),
    "pulse length in ns": (
        lambda: ls.Beam(3e-3, pulse_length=5),
        ValueError,
        "pulse_length: expected a finite number > 0 and <= 1e-06, got 5.0",
    ),
    "one prism, not in a list": (
        lambda: ls.patterns.Risley(ls.patterns.Prism(100.0), refractive_index=1.5, pulse_rate=1e5, rate=10.0),
        TypeError,
        "prisms: expected a sequence of Prism objects, got Prism(rotatio...exit_tilt=0.0)",
    ),
    "description of a sensor": (
        lambda: ls.patterns.describe("ouster-os1-128"),
        TypeError,
        (
            "pattern: expected a scan pattern (rate, shape, pulses), got 'ouster-os1-128'; "
            "Lidar.preset(name) makes a sensor"
        ),
    ),
    "measurement as dict": (
        lambda: ls.Lidar(LIDAR.pattern, measurement={"range_sigma": 0.01}),
        TypeError,
        "measurement: expected a Measurement, got {'range_sigma': 0.01}",
    ),
    "preset spelled otherwise": (
        lambda: ls.Lidar.preset("Ouster OS1-128"),
        ValueError,
        "preset: expected the name of a sensor, got 'Ouster OS1-128'; did you mean ouster-os1-128?",
    ),
    "preset without a name": (
        lambda: ls.Lidar.preset(None),
        TypeError,
        "preset: expected the name of a sensor, got None",
    ),
    "mode unknown": (
        lambda: ls.Lidar.preset("ouster-os1-128", mode="4096x10"),
        ValueError,
        "mode: expected one of 512x10, 512x20, 1024x10, 1024x20, 2048x10, got '4096x10'",
    ),
    "noise unknown": (
        lambda: ls.Lidar.preset("ouster-os1-128", noise="gaussian"),
        ValueError,
        "noise: expected none, datasheet or measured, got 'gaussian'",
    ),
    "returns unknown": (
        lambda: ls.Measurement(returns="all"),
        ValueError,
        "returns: expected 'strongest', 'first', 'last', 'dual' or a number, got 'all'",
    ),
    "one ray, flat": (
        lambda: SCENE.cast([0, 0, 0], [1, 0, 0]),
        ValueError,
        "origins: expected shape (n, 3), got (3,); of one, [[x, y, z]]",
    ),
    "rays transposed": (
        lambda: SCENE.cast(np.zeros((3, 7)), np.ones((3, 7))),
        ValueError,
        "origins: expected shape (n, 3), got (3, 7); transposed?",
    ),
    "one origin, many directions": (
        lambda: SCENE.cast([[0, 0, 0]], np.ones((5, 3))),
        ValueError,
        "origins, directions: expected arrays of equal length, got 1 and 5",
    ),
    "zero direction": (
        lambda: SCENE.cast(np.zeros((2, 3)), [[1, 0, 0], [0, 0, 0]]),
        ValueError,
        "directions: expected non-zero vectors, got directions[1] = (0, 0, 0)",
    ),
    "nan in origins": (
        lambda: SCENE.cast([[0, 0, np.nan]], [[1, 0, 0]]),
        ValueError,
        "origins: expected finite numbers, got origins[0][2] = nan",
    ),
    "mesh object instead of shape": (
        lambda: SCENE.add(np.zeros((3, 3))),
        TypeError,
        "shape: expected a lidarsim shape, got ndarray",
    ),
    "scene in a scene": (
        lambda: SCENE.add(ls.Scene()),
        TypeError,
        "shape: expected a lidarsim shape, got Scene",
    ),
    "label as name": (
        lambda: SCENE.add(BALL, label="car"),
        TypeError,
        "label: expected an integer from 0 to 4294967295, got 'car'; names of labels are the class_names of the scene",
    ),
    "negative label": (
        lambda: SCENE.add(BALL, label=-1),
        ValueError,
        "label: expected an integer from 0 to 4294967295, got -1",
    ),
    "labels by vertex": (
        lambda: SCENE.add(MESH, label=[1, 2, 3]),
        ValueError,
        "label: expected one integer, or 1, one per face, got int64 of shape (3,)",
    ),
    "labels by face of a sphere": (
        lambda: SCENE.add(BALL, label=[1, 2]),
        TypeError,
        "label: expected one integer, or a TriangleMesh, Spheres or Disks for one each, got Sphere",
    ),
    "material as number": (
        lambda: SCENE.add(BALL, material=0.5),
        TypeError,
        "material: expected a Material, got float",
    ),
    "position as transform": (
        lambda: SCENE.add(BALL, transform=(1, 2, 3)),
        ValueError,
        "transform: expected shape (4, 4), got (3,); a position is the last column, transform[:3, 3]",
    ),
    "flat transform": (
        lambda: SCENE.add(BALL, transform=np.diag([1.0, 1, 0, 1])),
        ValueError,
        "transform: expected an invertible matrix, got determinant 0",
    ),
    "transform transposed": (
        lambda: SCENE.add(BALL, transform=T.T),
        ValueError,
        "transform: expected a last row of (0, 0, 0, 1), got (1.0, 2.0, 3.0, 1.0); transposed?",
    ),
    "object by name": (
        lambda: SCENE["ball"],
        TypeError,
        "object_id: expected an integer, got 'ball'; scene.find gives the ids of a name",
    ),
    "an id that is gone": (
        lambda: SCENE.remove(9),
        KeyError,
        "object_id: expected an id below 1, got 9",
    ),
    "update of a typo": (
        lambda: SCENE.update(0, transfrom=T),
        TypeError,
        "transfrom: expected a keyword of shape, name, label, instance, material, transform, motion, got 'transfrom'",
    ),
    "update by name": (
        lambda: SCENE.update("ball", transform=T),
        TypeError,
        "object_id: expected an integer, got 'ball'; scene.find gives the ids of a name",
    ),
    "class names swapped": (
        lambda: ls.Scene(class_names={"car": 1}),
        TypeError,
        "class_names, its keys: expected an integer from 0 to 4294967295, got 'car'",
    ),
    "setting an attribute of a shape": (
        lambda: setattr(BALL, "radius", 2.0),
        AttributeError,
        "Sphere is immutable: cannot set 'radius'",
    ),
    "times not rising": (
        lambda: ls.Trajectory([0, 1, 1], np.stack([np.eye(4)] * 3)),
        ValueError,
        "times: expected rising times, got times[2] = 1.0 after 1.0",
    ),
    "times and poses swapped": (
        lambda: ls.Trajectory(np.stack([np.eye(4)] * 2), [0, 1]),
        ValueError,
        "times: expected shape (n,), got (2, 4, 4)",
    ),
    "one pose too few": (
        lambda: ls.Trajectory([0, 1, 2], np.stack([np.eye(4)] * 2)),
        ValueError,
        "poses: expected shape (3, 4, 4), one per time, got (2, 4, 4)",
    ),
    "quaternion poses": (
        lambda: ls.Trajectory([0, 1], np.zeros((2, 7))),
        ValueError,
        "poses: expected shape (2, 4, 4), one per time, got (2, 7)",
    ),
    "interpolation unknown": (
        lambda: ls.Trajectory([0, 1], np.stack([np.eye(4)] * 2), interpolation="slerp"),
        ValueError,
        "interpolation: expected 'linear' or 'spline', got 'slerp'",
    ),
    "at outside": (
        lambda: DRIVE.at(2.0),
        ValueError,
        "times: expected times from 0.0 to 1.0 s, got times = 2.0",
    ),
    "cloud of four columns": (
        lambda: ls.PointCloud(np.zeros((5, 4))),
        ValueError,
        (
            "PointCloud: expected an array of shape (n, 3), or fields by name, got shape (5, 4); "
            "PointCloud(xyz=a[:, :3], intensity=a[:, 3]) takes its columns apart"
        ),
    ),
    "cloud transposed": (
        lambda: ls.PointCloud(np.zeros((3, 5))),
        ValueError,
        "PointCloud: expected an array of shape (n, 3), or fields by name, got shape (3, 5); transposed?",
    ),
    "cloud of text": (
        lambda: ls.PointCloud(np.full((3, 3), "1.5")),
        TypeError,
        "PointCloud: expected an array of shape (n, 3), or fields by name, got <U3 of shape (3, 3)",
    ),
    "cloud without xyz": (
        lambda: ls.PointCloud(points=np.zeros((5, 3))),
        TypeError,
        "PointCloud: expected a field 'xyz', got points",
    ),
    "field of another length": (
        lambda: setattr(CLOUD, "ring", [1, 2]),
        ValueError,
        "ring: expected one entry for each of the 3 points, got 2",
    ),
    "label of a fraction": (
        lambda: ls.PointCloud(xyz=[[0, 0, 0]], label=[0.5]),
        ValueError,
        "label: expected integers from 0 to 4294967295, got label[0] = 0.5",
    ),
    "field by key": (
        lambda: CLOUD["label"],
        TypeError,
        "index: expected indices, a mask or a slice, got 'label'; a field is cloud.label",
    ),
    "mask of another length": (
        lambda: CLOUD[np.array([True, False])],
        IndexError,
        "index: expected a mask of shape (3,), one entry for each of the points, got (2,)",
    ),
    "absent field": (
        lambda: CLOUD.intensity,
        AttributeError,
        "this point cloud has no 'intensity'; its fields are xyz, label",
    ),
    "point beyond": (
        lambda: CLOUD[3],
        IndexError,
        "index: expected one of 3 points, got 3",
    ),
    "concatenate as arguments": (
        lambda: ls.PointCloud.concatenate(CLOUD),
        TypeError,
        "clouds: expected a sequence of clouds, got one",
    ),
    "concatenate of different fields": (
        lambda: ls.PointCloud.concatenate([CLOUD, ls.PointCloud(np.zeros((1, 3)))]),
        ValueError,
        "clouds: expected the same fields in all, got clouds[1], which has no 'label'",
    ),
    "transformed by a position": (
        lambda: CLOUD.transformed((0, 0, 1)),
        ValueError,
        "transform: expected shape (4, 4), got (3,); a position is the last column, transform[:3, 3]",
    ),
    "unknown suffix": (
        lambda: CLOUD.save("scan.pcb"),
        ls.errors.FileFormatError,
        f"scan.pcb: unknown extension '.pcb', expected {' or '.join(', '.join(sorted(FORMATS)).rsplit(', ', 1))}",
    ),
    "fields as text": (
        lambda: CLOUD.save("scan.npz", fields="label"),
        TypeError,
        "fields: expected a sequence of names, got 'label'",
    ),
    "load of nothing": (
        lambda: ls.PointCloud.load("none.pcd"),
        FileNotFoundError,
        "none.pcd: no such file",
    ),
    "frame of a cloud": (
        lambda: LIDAR.scan(SCENE).point_cloud("map"),
        ValueError,
        "frame: expected 'sensor' or 'world', got 'map'",
    ),
    "frames of a cloud": (
        lambda: LIDAR.scan(SCENE).point_cloud(["sensor", "world"]),
        ValueError,
        "frame: expected 'sensor' or 'world', got ['sensor', 'world']",
    ),
    "deskew to a word": (
        lambda: LIDAR.scan(SCENE).point_cloud(deskew="now"),
        ValueError,
        "deskew: expected True, False, 'start', 'middle', 'end' or seconds from the start of the scan, got 'now'",
    ),
    "image of an unknown field": (
        lambda: LIDAR.scan(SCENE).image("depth"),
        ValueError,
        f"field: expected one of {', '.join(ALWAYS)}, directions, origins, time, ring, column, got 'depth'",
    ),
    "rig of lidars alone": (
        lambda: ls.Rig({"top": LIDAR}),
        TypeError,
        "sensors['top']: expected (lidar, mount) or (lidar, mount, offset), got Lidar",
    ),
    "pose by name": (
        lambda: LIDAR.scan(SCENE, "origin"),
        TypeError,
        "pose: expected real numbers of shape (4, 4), got 'origin'",
    ),
    "span of no frames": (
        lambda: ls.Rig({"top": (LIDAR, None)}).span(0),
        ValueError,
        "count: expected an integer >= 1, got 0",
    ),
    "integer beyond float64": (
        lambda: ls.Sphere((0, 0, 0), 10**400),
        ValueError,
        "radius: expected a finite number > 0, got a number beyond float64",
    ),
    "angle beyond float64": (
        lambda: ls.Beam(10**400),
        ValueError,
        "divergence_azimuth: expected a finite number from 0 to 0.1, got a number beyond float64",
    ),
    "fraction beyond float64": (
        lambda: ls.Sphere((0, 0, 0), Fraction(10**400)),
        ValueError,
        "radius: expected a finite number > 0, got a number beyond float64",
    ),
    "complex number": (
        lambda: ls.Sphere((0, 0, 0), np.complex128(1 + 5j)),
        TypeError,
        "radius: expected a finite number > 0, got np.complex128(1+5j)",
    ),
    "truth value of NumPy": (
        lambda: ls.Measurement(range_sigma=np.True_),
        TypeError,
        "range_sigma: expected a finite number >= 0, got np.True_",
    ),
    "array of one number": (
        lambda: ls.Sphere((0, 0, 0), np.array([1.0])),
        TypeError,
        "radius: expected a finite number > 0, got an array of shape (1,)",
    ),
    "time span as a number": (
        lambda: ls.Sphere((0, 0, 0), np.timedelta64(5, "s")),
        TypeError,
        "radius: expected a finite number > 0, got np.timedelta64(5,'s')",
    ),
    "no decimal number": (
        lambda: ls.Sphere((0, 0, 0), Decimal("NaN")),
        ValueError,
        "radius: expected a finite number > 0, got nan",
    ),
    "first frame beyond all": (
        lambda: LIDAR.frames(SCENE, None, 1, first=10**400),
        ValueError,
        "first: expected an integer from 0 to 4294967295, got an integer of 1,329 bits",
    ),
    "more frames than there are": (
        lambda: ls.Rig({"top": (LIDAR, None)}).span(10**400),
        ValueError,
        "count: expected at most 4294967296 frames, got an integer of 1,329 bits",
    ),
    "frame of a cloud as an array": (
        lambda: LIDAR.scan(SCENE).point_cloud(np.zeros(3)),
        ValueError,
        "frame: expected 'sensor' or 'world', got an array of shape (3,)",
    ),
    "options as an array": (
        lambda: ls.Trajectory([0, 1], np.stack([np.eye(4), T]), interpolation=np.array(["spline", "linear"])),
        ValueError,
        "interpolation: expected 'linear' or 'spline', got an array of shape (2,)",
    ),
    "huge rotation": (
        lambda: LIDAR.scan(SCENE, 1e308 * np.eye(4)),
        ValueError,
        "pose: expected a last row of (0, 0, 0, 1), got (0.0, 0.0, 0.0, 1e+308)",
    ),
    "terrain beyond float64": (
        lambda: ls.TriangleMesh.from_heightfield(np.zeros((3, 3)), 1e308),
        ValueError,
        "origin, spacing: expected a grid within the range of float64, got one beyond it",
    ),
    "masked vertices": (
        lambda: ls.TriangleMesh(np.ma.masked_equal(np.eye(3), 0.0), [[0, 1, 2]]),
        ValueError,
        "vertices: expected numbers of shape (n, 3), got a masked array; fill it",
    ),
    **{
        f"a masked {name}": (use, ValueError, f"{name}: expected numbers of shape {shape}, got a masked array; fill it")
        for name, shape, use in (
            ("center", "(3,)", lambda: ls.Sphere(np.ma.masked_equal([1.0, 2.0, 3.0], 2.0), 1.0)),
            ("rotation", "(3, 3)", lambda: ls.Ellipsoid((0, 0, 0), (1, 2, 3), np.ma.masked_equal(np.eye(3), 0.0))),
            ("transform", "(4, 4)", lambda: ls.Sphere((0, 0, 0), 1.0, transform=np.ma.masked_equal(np.eye(4), 0.0))),
            ("pose", "(4, 4)", lambda: LIDAR.scan(SCENE, np.ma.masked_equal(np.eye(4), 0.0))),
        )
    },
    "masked points": (
        lambda: ls.PointCloud(np.ma.masked_equal(np.eye(3), 0.0)),
        ValueError,
        "fields: expected an array of shape (n, 3), or fields by name, got a masked array; fill it",
    ),
    "ragged times": (
        lambda: DRIVE.at([[0.0], [0.1, 0.2]]),
        ValueError,
        "times: expected numbers of shape (n,), got a ragged sequence",
    ),
    "ragged labels": (
        lambda: SCENE.add(MESH, label=[[1], [2, 3]]),
        ValueError,
        "label: expected one integer, or one per face, got a ragged sequence",
    ),
    "overrides as a text": (
        lambda: ls.config.load("run.yaml", "frames=2"),
        TypeError,
        "overrides: expected a sequence of assignments, got 'frames=2'",
    ),
    "clouds as a number": (
        lambda: ls.PointCloud.concatenate(3),
        TypeError,
        "clouds: expected a sequence of clouds, got 3",
    ),
    "text for deskew_movers": (
        lambda: LIDAR.scan(SCENE).point_cloud(deskew=True, deskew_movers="no"),
        TypeError,
        "deskew_movers: expected True or False, got 'no'",
    ),
    "a rate that firing times do not allow": (
        lambda: ls.Lidar.preset("riegl-vz400", rate=0.25),
        ValueError,
        (
            "rate: expected a rate that riegl-vz400 can have, got 0.25, with firing_times: expected times >= 0 and "
            "< 0.00555556 s, that of a cycle, got firing_times[120] = 0.005556"
        ),
    ),
    "a batch that is read-only": (
        lambda: LIDAR.scan_many(SCENE, [T], out=read_only(LIDAR.scan_many(SCENE, [T]))),
        ValueError,
        "out: expected a batch whose range can be written, got a read-only one",
    ),
    "one label as an array": (
        lambda: LIDAR.scan(SCENE).boxes(labels=np.array(1)),
        TypeError,
        "labels: expected labels, or names among class_names (none), got array(1)",
    ),
    **{
        f"no path for {name}": (lambda read=read: read(None), TypeError, "path: expected a path, got None")
        for name, read in {
            "Scene.from_file": ls.Scene.from_file,
            "Lidar.from_file": ls.Lidar.from_file,
            "TriangleMesh.from_file": ls.TriangleMesh.from_file,
            "TriangleMesh.from_raster": ls.TriangleMesh.from_raster,
            "Table.from_file": lambda path: ls.patterns.Table.from_file(path, rate=10.0),
            "Trajectory.load": ls.Trajectory.load,
            "Waveforms.load": ls.Waveforms.load,
            "ImuSamples.load": ls.ImuSamples.load,
            "GnssFixes.load": ls.GnssFixes.load,
            "config.load": ls.config.load,
            "rosbag.read": ls.io.rosbag.read,
        }.items()
    },
    "no folder of a data set": (
        lambda: ls.datasets.load(None),
        TypeError,
        "folder: expected a folder or a URL as text, or a path, got None",
    ),
    "rig as a list": (
        lambda: ls.Rig([LIDAR]),
        TypeError,
        "sensors: expected a mapping from names to sensors, got list",
    ),
}


def test_there_are_sixty() -> None:
    assert len(MISTAKES) >= 60


@pytest.mark.parametrize(("mistake", "kind", "message"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_explained(mistake: Callable[[], Any], kind: type[Exception], message: str) -> None:
    with pytest.raises(kind) as raised:
        mistake()
    if kind in (TypeError, ValueError) and "missing 1 required" not in message:  # which is Python's own
        assert isinstance(raised.value, ArgumentError)
    assert message in (raised.value.args[-1], str(raised.value))


@pytest.mark.parametrize(
    "mistake",
    [
        lambda given: ls.Measurement(beam=given),
        lambda given: ls.Measurement(detection=given),
        lambda given: ls.Measurement(response=given),
        lambda given: ls.Lidar(LIDAR.pattern, measurement=given),
        lambda given: ls.Lidar(LIDAR.pattern, model=given),
        lambda given: ls.Lidar(SimpleNamespace(rate=10.0, shape=given, pulses=LIDAR.pattern.pulses)),
        lambda given: ls.Scene().add(BALL, name=given),
        SCENE.find,
        lambda given: ls.Cylinder((0, 0, 0), (0, 0, 1), 1.0, capped=given),
        lambda given: LIDAR.scan(SCENE).image(size=given),
        lambda given: LIDAR.scan(SCENE).point_cloud(deskew=given),
    ],
)
def test_an_array_takes_one_line_of_an_error(mistake: Callable[[Any], Any]) -> None:
    with pytest.raises(ArgumentError, match=r", got an array of shape \(2, 2\)$"):
        mistake(np.eye(2))


def test_a_value_of_several_lines_takes_one_line_of_an_error() -> None:
    class Lines:
        def __repr__(self) -> str:
            return "one\ntwo"

    with pytest.raises(TypeError, match=r"^radius: expected a finite number > 0, got one two$"):
        ls.Sphere((0, 0, 0), Lines())  # type: ignore[arg-type]


@pytest.mark.parametrize("half", [Fraction(1, 2), Decimal("0.5"), np.array(0.5), np.float16(0.5), np.longdouble(0.5)])
def test_real_numbers_of_all_kinds_are_taken(half: Any) -> None:
    assert ls.Detection(half, 2 * half) == ls.Detection(0.5, 1.0)
    assert ls.Measurement(range_bias=-half).range_bias == -0.5
    assert ls.Measurement(range_sigma=half).range_sigma == 0.5
    assert dataclasses.replace(LIDAR, range_offset=half).range_offset == 0.5


def spin(*elevations: float, **more: Any) -> ls.patterns.Spinning:
    return ls.patterns.Spinning(np.radians(elevations), **more)


QUESTIONS: dict[str, tuple[Callable[[], Any], str]] = {
    "a decimal comma": (
        lambda: spin(-5, -3, 33, -2, -1),
        "elevations: out of order at elevations[2] (33, -2 degrees); a decimal comma?",
    ),
    "a decimal comma at the end": (
        lambda: spin(1, 2, 3, 33),
        "elevations: far from the others at elevations[2] (3, 33 degrees); a decimal comma?",
    ),
    "a decimal comma of a grid": (
        lambda: ls.patterns.Grid(np.radians([-2, -1, 5, 0]), [0.0], rate=10.0),
        "azimuths: out of order at azimuths[2] (5, 0 degrees); a decimal comma?",
    ),
    "a channel twice": (
        lambda: spin(-5, -4, -4),
        "elevations: -4 degrees twice or more, first at elevations[1]; one too many?",
    ),
    "turns per minute": (lambda: spin(0, rate=600.0), "rate: 600 turns per second; rpm?"),
    "offsets in degrees": (
        lambda: spin(1, 2, azimuth_offsets=[4.2, -4.2]),
        "azimuth_offsets: 8.4 rad apart; degrees?",
    ),
    "origins in mm": (lambda: spin(0, beam_origins=(15.8, 0, 36.2)), "beam_origins: 36.2 m; mm?"),
    "range in mm": (lambda: ls.Lidar(LIDAR.pattern, max_range=2e5), "max_range: 200000 m; mm?"),
    "noise in mm": (
        lambda: ls.Measurement(range_sigma=[(1, 0.01), (9, 20)]),
        "range_sigma: 20 m; mm?",
    ),
    "noise in degrees": (lambda: ls.Measurement(azimuth_sigma=0.05), "azimuth_sigma: 0.05 rad; degrees?"),
    "turn in degrees": (
        lambda: ls.Trajectory.from_twist(np.eye(4), angular=(0, 0, 90)),
        "angular: 90 rad/s; degrees per second?",
    ),
    "gyroscope in degrees": (
        lambda: ls.Imu(100.0, gyroscope=ls.ImuErrors(noise_density=0.005)),
        "gyroscope.noise_density: 0.005 rad/s/√Hz; degrees?",
    ),
}


@pytest.mark.parametrize(("unlikely", "question"), QUESTIONS.values(), ids=QUESTIONS)
def test_an_unlikely_number_is_asked_about_where_it_is_given(unlikely: Callable[[], Any], question: str) -> None:
    with pytest.warns(UserWarning, match="[?]$") as caught:
        unlikely()
    assert [str(warning.message) for warning in caught] == [question]
    assert caught[0].filename == __file__


def test_usual_numbers_raise_no_question() -> None:
    """Warnings are errors in these tests."""
    for name in ls.Lidar.presets():
        for noise in ("datasheet", "measured"):
            with contextlib.suppress(ValueError):  # not every preset has both
                ls.Lidar.preset(name, noise=noise)
    spin(-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)  # a VLP-16 in firing order
    spin(*[0.0] * 64)  # to measure noise
    spin(-1, -1, azimuth_offsets=[0.0, np.pi])  # a scanner with two sides
    spin(-1, 1, -1, 1, firing_times=[0, 1e-6, 2e-6, 3e-6])  # lasers that fire twice a cycle
    spin(3, 2, 1)
    spin(-10, 0, 30)
    ls.patterns.Grid(np.linspace(0, 6.2, 9), [0.1, 0.0], rate=10.0)
    ls.Measurement(range_sigma=0.3, range_bias=-0.5, azimuth_sigma=0.01)
    ls.Trajectory.from_twist(np.eye(4), angular=(0, 0, 20))
    ls.Imu(100.0, gyroscope=ls.ImuErrors(noise_density=np.radians(0.05), bias=np.radians(5)))
