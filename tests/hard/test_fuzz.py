"""Every public function with arguments of every kind: what comes of them is a result or an error that is documented.

The functions are found by the public names, so that a new one is among them by itself. Each needs an example of a call,
put together by the names of its parameters, and a parameter of an unknown name makes a test fail until it has a value.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from decimal import Decimal
from fractions import Fraction
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from tests.io.scenes.gltf_files import Gltf

DOCUMENTED = (ValueError, TypeError, KeyError, ls.errors.LidarsimError, OSError, MemoryError)

LEFT_OUT = {
    "register_": "change what later calls do",
    "show": "opens windows; tests/viewers",
    "generate": "makes folders; tests/datasets",
    "fit": "scans for each step of a fit; tests/test_fit.py",
    "stream": "opens viewers; tests/test_live.py",
    "datasets.": "the same",
    "materials.Material": "Material, by its other name",
    "materials.Texture": "Texture, by its other name",
    "io.rosbag.": "bags, of whole runs; tests/io",
    "io.packets.": "packets, of whole runs; tests/io/packets",
    "io.las.Writer": "writes in a with block; tests/io",
    "Shape": "abstract",
    "patterns.Pattern": "a protocol",
    "Source": "an enumeration",
    "Status": "an enumeration",
    "errors.": "what is raised",
}
"""Beginnings of names, and why they are not called here."""

RESULTS = {
    "Boxes",
    "Cells",
    "Comparison",
    "Hits",
    "GnssFixes",
    "ImuSamples",
    "LaserScan",
    "OccupancyGrid",
    "RigSensor",
    "Scan",
    "ScanBatch",
    "SceneObject",
    "io.packets.Sent",
    "Waveforms",
    "patterns.Description",
    "worlds.Asset",
    "worlds.Part",
    "worlds.Street",
    "worlds.Walker",
    "worlds.Ways",
}
"""Classes that functions return: their methods are called, their constructors not."""

HEAVY = ("to_open3d", "to_pyvista", "from_open3d", "from_pyvista", "from_trimesh", "plot", "show")
"""Methods that import a viewer, which takes a second; tests/viewers."""


def parts(module: ModuleType, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name in sorted(getattr(module, "__all__", ())):
        value = getattr(module, name)
        full = prefix + name
        if any(full.startswith(left) if left.endswith((".", "_")) else full == left for left in LEFT_OUT):
            continue
        if inspect.ismodule(value):
            yield from parts(value, full + ".")
        elif callable(value):
            yield full, value


def functions() -> dict[str, inspect.Signature]:
    """All that can be called: functions, constructors and methods, by their names from `lidarsim` on."""
    found = {}
    for name, value in parts(ls):
        if not (inspect.isclass(value) and name in RESULTS):
            found[name] = inspect.signature(value)
        if inspect.isclass(value):
            for method, member in inspect.getmembers(value, callable):
                ours = (getattr(member, "__module__", None) or "").startswith("lidarsim.")
                if ours and not method.startswith("_") and method not in HEAVY:
                    found[f"{name}.{method}"] = inspect.signature(member)
    return found


def pose_at(angle: float, *position: float) -> np.ndarray:
    return RigidTransform.from_components(position, Rotation.from_euler("z", angle)).as_matrix()


def ball_and_floor() -> ls.Scene:
    scene = ls.Scene(class_names={1: "ball"})
    scene.add(ls.Sphere((4, 0, 0), 1.0), label=1)
    scene.add(ls.Plane((0, 0, 1), -1.0), motion=ls.Trajectory.from_twist(np.eye(4), (0, 0, 0.1), (0, 0, 1)))
    return scene


def lidar() -> ls.Lidar:
    return ls.Lidar(ls.patterns.Grid([0.0, 0.1, 0.2], [-0.1, 0.1], rate=10.0, column_period=0.01), name="top")


def flat_scan() -> ls.Scan:
    return ls.Lidar(ls.patterns.Spinning([0.0], columns=8)).scan(ball_and_floor())


def growing(folder: Path) -> ls.Scene:
    """A scene with an animation."""
    file = Gltf()
    file.node(mesh=file.mesh())
    sampler = {"input": file.numbers([[0.0], [1.0]]), "output": file.numbers(np.array([(1, 1, 1), (2, 2, 2)]))}
    channel = {"sampler": 0, "target": {"node": 0, "path": "scale"}}
    file.put("animations", {"channels": [channel], "samplers": [sampler]})
    return ls.Scene.from_file(file.save(folder / "growing.glb"))


def drive() -> ls.Trajectory:
    return ls.Trajectory([0.0, 0.5, 2.0], [pose_at(a, a, 0, 0) for a in (0.0, 1.0, 3.0)], interpolation="spline")


MODEL = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><body><freejoint/><geom size="1"/><site name="lidar"/></body></worldbody></mujoco>'
)


def poses() -> mujoco.MjData:
    data = mujoco.MjData(MODEL)
    mujoco.mj_forward(MODEL, data)
    return data


RUN = """\
frames: 1
sensor: {pattern: {type: spinning, elevations_deg: [0], columns: 4}}
scene: [{shape: sphere, center_m: [3, 0, 0], radius_m: 1}]
"""


def write(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text)
    return folder / name


def cloud() -> ls.PointCloud:
    return ls.PointCloud(xyz=np.arange(6.0).reshape(2, 3), label=[1, 2])


def save(folder: Path, name: str = "cloud.pcd") -> Path:
    cloud().save(folder / name)
    return folder / name


def record(folder: Path) -> Path:
    lidar().scan(ball_and_floor()).waveforms().save(folder / "recorded.npz")
    return folder / "recorded.npz"


VALUES: dict[str, Callable[[Path], Any]] = {
    # Shapes
    **dict.fromkeys(("center", "start", "a", "linear", "angular"), lambda _: (0.0, 0.0, -1.0)),
    **dict.fromkeys(("end", "normal", "b", "point", "size", "radii"), lambda _: (0.5, 1.0, 2.0)),
    "c": lambda _: (1.0, 0.0, 0.0),
    **dict.fromkeys(("radius", "distance", "chord_error"), lambda _: 1.5),
    "capped": lambda _: True,
    "rotation": lambda _: Rotation.from_euler("z", 0.3),
    "vertices": lambda _: np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]),
    "faces": lambda _: np.array([(0, 1, 2), (0, 2, 3)]),
    "z": lambda _: np.arange(12.0).reshape(3, 4),
    "spacing": lambda _: 0.5,
    "origin": lambda _: (0.0, 0.0),
    "crs": lambda _: None,
    "cell": lambda _: 0.5,
    "statistic": lambda _: "max",
    **dict.fromkeys(("position_sigma", "orientation_sigma"), lambda _: 0.01),
    "correlation_time": lambda _: 1.0,
    **dict.fromkeys(("boresight", "lever_arm"), lambda _: (0.01, 0.0, 0.02)),
    **dict.fromkeys(("transform", "pose", "mount"), lambda _: pose_at(0.2, 0.1, 0.2, 0.3)),
    "bounds": lambda _: np.array([(-1.0, -1, -1), (1, 1, 1)]),
    # Casts
    "origins": lambda _: np.array([(0.0, 0, 0), (0, 0, 5)]),
    "directions": lambda _: np.array([(1.0, 0, 0), (0, 0, -1)]),
    "t_min": lambda _: 0.5,
    "t_max": lambda _: 50.0,
    "most": lambda _: 3,
    **dict.fromkeys(("time", "offset"), lambda _: 0.25),
    # Scenes
    "shape": lambda _: ls.Sphere((4, 0, 0), 1.0),
    "name": lambda _: "ball",
    "label": lambda _: 3,
    "instance": lambda _: 7,
    "material": lambda _: ls.Material(reflectivity=0.5),
    "motion": lambda _: drive(),
    "object_id": lambda _: 0,
    "class_names": lambda _: {1: "ball"},
    "reflectivity": lambda _: 0.5,
    "per": lambda _: "object",
    **dict.fromkeys(("roughness", "specular", "specular_width", "transmission", "mirror"), lambda _: 0.3),
    "colors": lambda _: np.array([(0.1, 0.2, 0.3), (0.4, 0.5, 0.6)]),
    "values": lambda _: np.array([(0.1, 0.2, 0.3), (0.4, 0.5, 0.6)]),
    "texture_coordinates": lambda _: None,
    "wrap": lambda _: ("clamp", "mirror"),
    **dict.fromkeys(("variation", "grain"), lambda _: 0.1),
    # Patterns
    "elevations": lambda _: np.array([-0.1, 0.1]),
    **dict.fromkeys(("azimuths", "azimuth_offsets"), lambda _: np.array([0.0, 0.1])),
    "columns": lambda _: 8,
    "column_period": lambda _: None,
    "rate": lambda _: 10.0,
    "firing_times": lambda _: 0.0,
    "beam_origins": lambda _: (0.0, 0.0, 0.1),
    "clockwise": lambda _: True,
    **dict.fromkeys(("field_of_view", "half_angle", "phase"), lambda _: 0.4),
    **dict.fromkeys(("start_azimuth", "turn"), lambda _: 0.3),
    "sweep": lambda _: 0.5,
    **dict.fromkeys(("scan_rate", "line_rate", "rotation_rate"), lambda _: 50.0),
    "pulse_rate": lambda _: 1000.0,
    **dict.fromkeys(("entry_tilt", "exit_tilt"), lambda _: 0.1),
    "prisms": lambda _: [ls.patterns.Prism(100.0, exit_tilt=0.1)],
    "refractive_index": lambda _: 1.5,
    "beams": lambda _: [(1.0, 0.0, 0.0)],
    "rings": lambda _: np.array([0, 1]),
    "frame": lambda _: 1,
    "pattern": lambda _: ls.patterns.Spinning([0.0, 0.1], columns=8),
    # Sensors
    **dict.fromkeys(("divergence_azimuth", "divergence_elevation"), lambda _: 1e-3),
    "pulse_length": lambda _: 5e-9,
    "rays": lambda _: 7,
    "separation": lambda _: 1.0,
    "range": lambda _: 100.0,
    **dict.fromkeys(
        (
            "range_sigma",
            "range_sigma_slope",
            "range_sigma_limit",
            "range_bias",
            "channel_bias_sigma",
            "range_resolution",
            "receiver_offset",
            "dropout",
        ),
        lambda _: 0.01,
    ),
    **dict.fromkeys(("azimuth_sigma", "elevation_sigma", "extinction", "power_sigma", "false_returns"), lambda _: 1e-3),
    "crossover": lambda _: (0.5, 2.0),
    "near_threshold": lambda _: 0.01,
    "near_range": lambda _: 20.0,
    "response": lambda _: ls.Response(limit=1.0),
    **dict.fromkeys(("exponent", "sigma", "ring_sigma", "limit"), lambda _: 0.5),
    "sigma_block": lambda _: 20,
    "visibility": lambda _: 50.0,
    **dict.fromkeys(("backscatter", "aperture", "divergence"), lambda _: 1e-3),
    **dict.fromkeys(("intercept", "slope", "reflectance"), lambda _: 1.0),
    "lidar": lambda _: dataclasses.replace(
        lidar(), min_range=0.1, max_range=80.0, measurement=ls.Measurement(near_threshold=0.01)
    ),
    "detection": lambda _: ls.Detection(0.1, 100.0),
    "beam": lambda _: ls.Beam(1e-3, rays=7),
    "returns": lambda _: 2,
    "depth": lambda _: 2,
    "measurement": lambda _: ls.Measurement(range_sigma=0.02),
    "min_range": lambda _: 0.1,
    "max_range": lambda _: 80.0,
    "range_offset": lambda _: 0.0,
    **dict.fromkeys(("model", "mode", "noise"), lambda _: None),
    "scene": lambda _: ball_and_floor(),
    "seed": lambda _: 3,
    "first": lambda _: 1,
    "ignore": lambda _: [1],
    "out": lambda _: None,
    "count": lambda _: 2,
    "sensors": lambda _: {"top": (lidar(), pose_at(0.0, 0, 0, 2))},
    # Trajectories
    "times": lambda _: np.array([0.0, 0.5, 2.0]),
    "poses": lambda _: np.array([pose_at(a, a, 0, 0) for a in (0.0, 1.0, 3.0)]),
    "interpolation": lambda _: "spline",
    "axes": lambda _: "camera",
    # Inertial data
    **dict.fromkeys(
        ("noise_density", "bias_instability", "random_walk", "bias", "scale_factor", "misalignment"), lambda _: 0.001
    ),
    **dict.fromkeys(("position_sigma", "drift_sigma"), lambda _: 0.5),
    "drift_time": lambda _: 60.0,
    "georeference": lambda _: ls.Georeference(origin=(0.8, 0.2, 500.0)),
    "positions": lambda _: np.eye(3),
    **dict.fromkeys(("gyroscope", "accelerometer"), lambda _: ls.ImuErrors(noise_density=0.001)),
    "gravity": lambda _: 9.8,
    "latitude": lambda _: 0.8,
    "trajectory": lambda _: drive(),
    # Scans and clouds
    "field": lambda _: "range",
    "return_number": lambda _: 1,
    "deskew": lambda _: False,
    "fields": lambda _: None,
    "more": lambda _: {"xyz": np.zeros((2, 3)), "label": [1, 2]},
    "clouds": lambda _: [cloud(), cloud()],
    "cloud": lambda _: cloud(),
    "float32": lambda _: False,
    # MuJoCo
    "groups": lambda _: (0, 1),
    "keyframe": lambda _: None,
    "data": lambda _: poses(),
    "site": lambda _: "lidar",
    "body": lambda _: 1,
    "subtree": lambda _: True,
    "xpos": lambda _: np.zeros((2, 3)),
    "xquat": lambda _: np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
    "ids": lambda _: [0],
    "transforms": lambda _: pose_at(0.2, 0.1, 0.2, 0.3)[None],
    "resolution": lambda _: 0.5,
    "free_from": lambda _: None,
    "animation": lambda _: None,
    # Worlds
    "rng": lambda _: np.random.default_rng(0),
    **dict.fromkeys(("width", "height", "length", "posture", "load"), lambda _: None),
    "storeys": lambda _: 2,
    "clearance": lambda _: 0.0,
    "rider": lambda _: True,
    # Files
    "path": lambda folder: folder / "cloud.npz",
    "topic": lambda _: None,
    "overrides": lambda _: (),
    "options": lambda _: {},
    "changes": lambda _: {"label": 4},
}
"""By name of a parameter, what it may be."""

PARTICULAR: dict[str, Callable[[Path], Any]] = {
    **dict.fromkeys(("Material.from_texture.image", "Texture.image"), lambda _: np.zeros((2, 2))),
    **dict.fromkeys(("Material.from_texture.interpolation", "Texture.interpolation"), lambda _: "nearest"),
    **dict.fromkeys(("Response.range", "Response.curve"), lambda _: [(1.0, 0.5), (5.0, 1.0)]),
    "PointCloud.to_pandas.class_names": lambda _: True,
    **dict.fromkeys(("mujoco.World.pose.body", "mujoco.World.poses.body"), lambda _: None),
    **dict.fromkeys(("mujoco.World.pose.offset", "mujoco.World.poses.offset"), lambda _: None),
    "worlds.building.kind": lambda _: "house",
    "worlds.building.depth": lambda _: None,
    "worlds.furniture.kind": lambda _: "bench",
    "worlds.tree.kind": lambda _: "bush",
    "worlds.vehicle.kind": lambda _: "suv",
    "worlds.street.kind": lambda _: "rural",
    "worlds.street.length": lambda _: 60.0,
    **dict.fromkeys(("Imu.measure.start", "Gnss.measure.start", "Rig.inertial.start"), lambda _: 0.5),
    **dict.fromkeys(("Rig.fixes.start", "ImuSamples.between.start", "GnssFixes.between.start"), lambda _: 0.5),
    **dict.fromkeys(("Imu.measure.end", "Gnss.measure.end", "Rig.inertial.end"), lambda _: 1.5),
    **dict.fromkeys(("Rig.fixes.end", "ImuSamples.between.end", "GnssFixes.between.end"), lambda _: 1.5),
    "Georeference.origin": lambda _: (0.8, 0.2, 500.0),
    "Georeference.crs": lambda _: None,
    "GnssFixes.load.path": lambda folder: write(folder, "gnss.csv", "0,48,11,500\n"),
    "ImuSamples.load.path": lambda folder: write(folder, "imu.csv", "0,1,2,3,4,5,6\n"),
    "PointCloud.save.start": lambda _: 0.0,
    **dict.fromkeys(("ImuSamples.load.start", "ImuSamples.save.start"), lambda _: 0.0),
    **dict.fromkeys(("GnssFixes.load.start", "GnssFixes.save.start"), lambda _: 0.0),
    "Scan.point_cloud.pose": lambda _: None,
    "PointCloud.raster.field": lambda _: "z",
    "Cells.save.path": lambda folder: folder / "cells.tif",
    "PointCloud.raster.bounds": lambda _: (-1.0, -1.0, 1.0, 1.0),
    "Scan.image.size": lambda _: (4, 6),
    "Comparison.save.path": lambda folder: folder / "report.json",
    **dict.fromkeys(("compare.real", "compare.simulated"), lambda _: cloud()),
    "compare.sensor": lambda _: None,
    "materials.named.name": lambda _: "asphalt",
    "Lidar.model": lambda _: "",
    "scan_many.lidar": lambda _: [lidar(), lidar()],
    "scan_many.sensor": lambda _: np.array([0, 1, 0]),
    "Lidar.preset.rate": lambda _: None,
    "mujoco.World.model": lambda _: MODEL,
    "mujoco.World.rules": lambda _: [ls.Rule(node="*", label=1)],
    "Lidar.preset.name": lambda _: "velodyne-vlp16",
    "patterns.Pulses.time": lambda _: np.array([0.0, 0.1]),
    "patterns.Pulses.ring": lambda _: np.array([0, 1]),
    "patterns.Pulses.column": lambda _: np.array([0, 1]),
    "patterns.Pulses.origins": lambda _: np.zeros((2, 3)),
    "patterns.Table.columns": lambda _: None,
    "patterns.Table.times": lambda _: np.array([0.0, 0.1]),
    "patterns.Table.from_file.path": lambda folder: write(folder, "table.csv", "x,y,z\n1,0,0\n0,1,0\n"),
    **dict.fromkeys(("Spheres.centers", "Disks.centers"), lambda _: np.arange(12.0).reshape(4, 3)),
    **dict.fromkeys(("Spheres.radii", "Disks.radii"), lambda _: np.array([0.5, 1.0, 2.0, 0.25])),
    "Disks.normals": lambda _: np.eye(4, 3) + 1.0,
    "Disks.from_points.points": lambda _: np.stack([*np.mgrid[:4.0, :5.0], np.ones((4, 5))], axis=-1).reshape(-1, 3),
    **dict.fromkeys(("Disks.from_points.normals", "Disks.from_points.radii"), lambda _: None),
    "Disks.from_points.neighbours": lambda _: 5,
    "Disks.from_points.return_index": lambda _: True,
    "PointCloud.save.fields": lambda _: ["xyz"],
    "PointCloud.load.path": save,
    "PointCloud.load.columns": lambda _: None,
    "PointCloud.save.pose": lambda _: None,
    "Trajectory.load.path": lambda folder: write(folder, "poses.kitti", "1 0 0 0 0 1 0 0 0 0 1 0\n" * 3),
    "Trajectory.load.scene": lambda _: None,
    "Trajectory.load.start": lambda _: 0.5,
    "io.las.flight_fields.scan": lambda _: lidar().scan(ball_and_floor(), drive()),
    "io.las.flight_fields.point_source_id": lambda _: 3,
    "Trajectory.strips.area": lambda _: (0.0, 0.0, 300.0, 200.0),
    "Trajectory.strips.height": lambda _: 100.0,
    "Trajectory.strips.speed": lambda _: 30.0,
    **dict.fromkeys(("Trajectory.strips.overlap", "Trajectory.strips.heading"), lambda _: 0.3),
    **dict.fromkeys(("Trajectory.strips.ground", "Trajectory.strips.margin"), lambda _: 5.0),
    "Trajectory.save.path": lambda folder: folder / "poses.tum",
    "TriangleMesh.from_file.path": lambda folder: write(folder, "m.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
    "Scene.from_file.path": lambda folder: write(folder, "m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "Scene.from_file.up": lambda _: "y",
    "Scene.from_file.time": lambda _: None,
    "Scene.animate.self": growing,
    "Scan.laser_scan.self": lambda _: flat_scan(),
    "Scan.waveforms.pulses": lambda _: [3, 1],
    "Scan.waveforms.sample_period": lambda _: 1e-9,
    "Waveforms.save.path": lambda folder: folder / "waveforms.npz",
    "Waveforms.load.path": record,
    "occupancy.z": lambda _: 0.1,
    "occupancy.bounds": lambda _: ((-2.0, -2.0), (5.0, 2.0)),
    "OccupancyGrid.index.points": lambda _: [(0.0, 1.0)],
    "OccupancyGrid.save.path": lambda folder: folder / "map.yaml",
    "Scene.from_file.unit": lambda _: 0.01,
    "Scene.from_file.rules": lambda _: [ls.Rule(node="a*", label=3)],
    **dict.fromkeys(("Scene.from_file.reflectivity", "Rule.reflectivity"), lambda _: "color"),
    **dict.fromkeys(("Rule.node", "Rule.matches.node"), lambda _: "cars/*"),
    **dict.fromkeys(("Rule.material", "Rule.matches.material"), lambda _: "paint"),
    "Rule.instance": lambda _: "node",
    "Rule.name": lambda _: "car",
    "Rule.skip": lambda _: False,
    "Lidar.from_file.path": lambda folder: write(folder, "s.yaml", "pattern: {type: mid360}\nname: a\n"),
    "config.read_lidar.path": lambda folder: write(folder, "s.yaml", "pattern: {type: mid360}\nname: a\n"),
    "config.load.path": lambda folder: write(folder, "run.yaml", RUN),
    "io.las.Writer.path": lambda folder: folder / "cloud.las",
    "io.las.read.path": lambda folder: save(folder, "cloud.las"),
    "io.semantickitti.read_labels.path": lambda folder: write(folder, "a.label", "abcd"),
    "Scan.point_cloud.frame": lambda _: "world",
    "Scan.boxes.frame": lambda _: "world",
    "Scan.boxes.min_points": lambda _: 1,
    "Scan.boxes.labels": lambda _: [1, "ball"],
    "Scan.point_cloud.deskew": lambda _: "middle",
    "Scan.point_cloud.deskew_movers": lambda _: True,
    "Boxes.contain.xyz": lambda _: np.zeros((2, 3)),
    "TriangleMesh.from_raster.path": lambda folder: write(
        folder, "dem.asc", "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n2 3 4\n"
    ),
    "TriangleMesh.from_raster.band": lambda _: 1,
    "TriangleMesh.from_raster.window": lambda _: (0.0, 0.0, 3.0, 2.0),
    "TriangleMesh.from_raster.stride": lambda _: 1,
    "Scan.true_points.frame": lambda _: "world",
    "Material.from_texture.image": lambda _: np.linspace(0.0, 1.0, 12).reshape(2, 2, 3),
    "Material.from_colors.per": lambda _: "face",
    "Material.from_texture.texture_coordinates": lambda _: np.array([(0.0, 0), (1, 0), (1, 1), (0, 1)]),
    "patterns.Grid.column_period": lambda _: 0.01,
}
"""The same, of one parameter of one function."""


def nasty(folder: Path) -> list[Any]:
    """What no parameter expects, or many do not: a new list each time, as some of it may be used up."""
    misaligned = np.frombuffer(b"\0" * 25, np.uint8)[1:].view(np.float64)
    return [
        *(math.nan, math.inf, -math.inf, 0, 0.0, -0.0, 5e-324, -5e-324, 1e-200, 1e200, 1e308, -1e308, -1, 1.5),
        *(sys.float_info.max, 10**400, -(10**400), 2**31, 2**32, 2**63, 2**64, 1e9, 1e16),
        *(
            True,
            False,
            np.True_,
            None,
            "",
            "1",
            "x\0y",
            "é" * 300,
            b"1",
            bytearray(b"1"),
            object(),
            NotImplemented,
            ...,
        ),
        *(1 + 5j, np.complex128(1 + 5j), np.float32(1.5), np.float16(0.1), np.longdouble("1e4000"), np.int8(3)),
        *(np.uint64(2**64 - 1), np.str_("1"), np.datetime64("2020"), np.timedelta64(5, "s"), np.void(b"12")),
        *(Fraction(1, 3), Fraction(10**400), Decimal("0.5"), Decimal("NaN"), Decimal("sNaN"), Decimal("1e999")),
        *(np.array(2.0), np.array([2.0]), np.array(3), np.array([[3]]), np.array("1"), np.array(None), np.array(1j)),
        *(
            [],
            (),
            [[]],
            [[1], [2, 3]],
            [None],
            [1, "a"],
            [10**400],
            {},
            {1: 2},
            {"a": None},
            {1.5},
            range(3),
            iter([1.0]),
        ),
        *(np.empty((0, 3)), np.empty((0, 4, 4)), np.zeros(3), np.zeros((2, 3)), np.ones((3, 3)), np.eye(4), -np.eye(4)),
        *(np.full((4, 4), math.nan), 1e308 * np.eye(4), np.array(["a"]), np.array([1, None]), misaligned, np.ones(7)),
        *(
            np.ma.masked_array([1.0, 2, 3], [0, 1, 0]),
            np.zeros(2, [("a", float)]),
            np.ones(3, ">f4"),
            np.eye(3, dtype="m8[s]"),
        ),
        *(
            pose_at(1.0, 1e308, -1e308, 0),
            pose_at(1.0, 1e200, 0, 0),
            np.diag([1e-300, 1, 1, 1]),
            np.diag([1e300, 1, 1, 1]),
        ),
        *(Rotation.identity(), Rotation.identity(2), RigidTransform.identity(), RigidTransform.identity(2)),
        *(ls.Sphere((0, 0, 0), 1.0), ball_and_floor(), lidar(), drive(), cloud(), ls.Material(), ls.Scene(), ls.Sphere),
        *(folder, folder / "none" / "cloud.pcd", folder / "none", "none\0.pcd", len, lambda *_: None, int, ls),
    ]


def numeric(value: Any) -> np.ndarray | None:
    """`value` as a new array, if it is one of numbers."""
    try:
        array = np.array(value.as_matrix() if hasattr(value, "as_matrix") else value)
    except (TypeError, ValueError):
        return None
    return array if array.size and array.dtype.kind in "biuf" else None


ALTERATIONS: tuple[Callable[[np.ndarray], Any], ...] = (
    lambda x: x.astype(float) * 1e308,
    lambda x: x.astype(float) * 1e-308,
    lambda x: x.astype(float) * 1e200,
    lambda x: -x.astype(float),
    lambda x: x.astype(np.float32),
    lambda x: x.astype(object),
    lambda x: x.astype(complex),
    lambda x: x.astype(str),
    lambda x: x.astype(bool),
    lambda x: x.tolist(),
    lambda x: x.T,
    lambda x: x.ravel(),
    lambda x: x[None],
    lambda x: x[:0] if x.ndim else x,
    lambda x: x[::-1] if x.ndim else x,
    lambda x: x[:1] if x.ndim else x,
    lambda x: np.repeat(x, 2, axis=0) if x.ndim else x,
    np.zeros_like,
    np.asfortranarray,
)
NUMBERS = (math.nan, math.inf, -0.0, 0.0, 5e-324, 1e-200, 1e160, 1e200, 1e308, -1e308, sys.float_info.max, -1.0, 1e9)


@st.composite
def replacement(draw: st.DrawFn, value: Any, folder: Path) -> Any:
    """Something else in place of a value: anything, or the value altered."""
    array = numeric(value)
    kind = draw(st.integers(0, 2)) if array is not None else 0
    if array is None or kind == 0:
        everything = nasty(folder)
        return everything[draw(st.integers(0, len(everything) - 1))]
    if kind == 1:
        with np.errstate(all="ignore"):
            return draw(st.sampled_from(ALTERATIONS))(array)
    altered = array.astype(float)
    altered.flat[draw(st.integers(0, array.size - 1))] = draw(st.one_of(st.sampled_from(NUMBERS), st.floats()))
    return altered if array.ndim else altered.item()


def example(name: str, signature: inspect.Signature, folder: Path) -> dict[str, Any]:
    """Arguments by name with which a function can be called, `self` among them."""
    arguments: dict[str, Any] = {}
    for parameter in signature.parameters:
        if f"{name}.{parameter}" in PARTICULAR:
            arguments[parameter] = PARTICULAR[f"{name}.{parameter}"](folder)
        elif parameter == "self":
            owner = name.rpartition(".")[0]
            arguments[parameter] = INSTANCES[owner]() if owner in INSTANCES else make(owner, folder)
        else:
            arguments[parameter] = VALUES.get(parameter, absent)(folder)
    return arguments


INSTANCES = {
    "Scan": lambda: lidar().scan(ball_and_floor()),
    "ImuSamples": lambda: ls.Imu(10.0).measure(drive()),
    "GnssFixes": lambda: ls.Gnss(10.0).measure(drive(), ls.Georeference(origin=(0.8, 0.2, 500.0))),
    "Scene": ball_and_floor,
    "Lidar": lidar,
    "Boxes": lambda: lidar().scan(ball_and_floor()).boxes(),
    "Cells": lambda: cloud().raster(cell=0.5),
    "ScanBatch": lambda: lidar().scan_many(ball_and_floor(), [np.eye(4)] * 2),
    "Comparison": lambda: ls.compare(cloud(), cloud()),
    "LaserScan": lambda: flat_scan().laser_scan(),
    "OccupancyGrid": lambda: ls.occupancy(ball_and_floor(), 0.5, 0.1),
    "worlds.Asset": lambda: ls.worlds.vehicle("suv", np.random.default_rng(0)),
    "Waveforms": lambda: lidar().scan(ball_and_floor()).waveforms(),
}
"""By class, what is better than what its constructor makes of the example."""


def absent(_: Path) -> Any:
    raise AssertionError("no value is known for this parameter: add one to VALUES or PARTICULAR")


def make(name: str, folder: Path) -> Any:
    return call(name, example(name, inspect.signature(find(name)), folder))


def find(name: str) -> Any:
    value: Any = ls
    for part in name.split("."):
        value = getattr(value, part)
    return value


def call(name: str, arguments: dict[str, Any]) -> Any:
    """Call a function, and take what it yields first."""
    function = find(name)
    bound = inspect.signature(function).bind_partial()
    bound.arguments.update(arguments)
    result = function(*bound.args, **bound.kwargs)
    return list(islice(result, 2)) if inspect.isgenerator(result) else result


FUNCTIONS = functions()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_function_has_an_example(name: str, folder: Path) -> None:
    call(name, example(name, FUNCTIONS[name], folder))


def test_what_is_left_out_is_there() -> None:
    names = [name for name, _ in everything(ls)]
    for left in LEFT_OUT:
        assert any(name.startswith(left) for name in names), left
    assert set(names) >= RESULTS
    assert len(FUNCTIONS) > 70


def everything(module: ModuleType, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name in getattr(module, "__all__", ()):
        yield prefix + name, getattr(module, name)
        if inspect.ismodule(getattr(module, name)):
            yield from everything(getattr(module, name), prefix + name + ".")


@contextmanager
def limit_memory() -> Iterator[None]:
    """Let the process have some GB more than it has, where a system can do that: no request is to take all there is."""
    try:
        import resource

        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except (ImportError, OSError):
        yield
        return
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + (6 << 30), limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


def is_small(value: Any) -> bool:
    """Whether what is made is not so large, though allowed, that its methods take long."""
    pattern = getattr(value, "pattern", value)
    return not isinstance(pattern, ls.patterns.Pattern) or math.prod(pattern.shape) < 10_000


def names_nothing(error: Exception, name: str, arguments: dict[str, Any]) -> bool:
    """Whether an error tells neither which argument it is about nor which file."""
    if isinstance(error, OSError | ls.errors.LidarsimError) or "os.PathLike" in str(error) or "null byte" in str(error):
        return not str(error)
    keys = {key for value in arguments.values() if isinstance(value, dict) for key in map(str, value)}
    names = {*arguments, *keys, *ALIASES.get(name, ())} - {"self"}
    return not any(part in str(error) for part in names)


ALIASES = {
    "Lidar.preset": ("preset",),
    "Lidar.from_file": ("option",),
    **dict.fromkeys(("Lidar.frames", "Rig.frames", "Rig.span"), ("frame",)),
}
"""What errors of a function call its arguments besides their names."""


@given(st.data())
def check(folder: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(FUNCTIONS)), label="function")
    arguments = example(name, FUNCTIONS[name], folder)
    names = [parameter for parameter in arguments if parameter != "self"]
    changed = data.draw(st.lists(st.sampled_from(names), min_size=1, max_size=3, unique=True)) if names else []
    for parameter in changed:
        arguments[parameter] = data.draw(replacement(arguments[parameter], folder), label=parameter)
        if parameter in {"more", "options", "changes"}:  # what is given by keyword
            arguments[parameter] = {"xyz": arguments[parameter]}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", r".*\?$", UserWarning)  # questions about unlikely numbers
        result, error = outcome(name, arguments)
        assert error is None or not names_nothing(error, name, arguments), f"{type(error).__name__}: {error}"
        for method in FUNCTIONS if error is None and is_small(result) else ():
            if method.startswith(f"{name}.") and "self" in FUNCTIONS[method].parameters:
                _, error = outcome(method, {**example(method, FUNCTIONS[method], folder), "self": result})
                assert error is None or str(error), f"{method}: {error!r}"


def outcome(name: str, arguments: dict[str, Any]) -> tuple[Any, Exception | None]:
    """Return what a function returns, or the documented error that it raises."""
    try:
        return call(name, arguments), None
    except DOCUMENTED as error:
        return None, error


def test_whatever_is_given_the_outcome_is_documented(folder: Path, slow: bool) -> None:
    with limit_memory():
        settings(
            max_examples=20_000 if slow else 60,
            deadline=None,
            suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example],
        )(check)(folder)
