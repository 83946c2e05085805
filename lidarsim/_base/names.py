"""Errors for names from other programs, which name lidarsim's."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

from lidarsim.errors import ArgumentTypeError

Called = TypeVar("Called", bound=Callable[..., Any])

_SAVE = "write export to_file to_csv write_point_cloud save_point_cloud"
_ATTRIBUTES = {
    "lidarsim": {
        "PointCloud.load, Scene.from_file, config.load, datasets.load or Trajectory.load": "load read open from_file",
        "PointCloud.load": "load_point_cloud read_point_cloud load_cloud load_pcd",
        "PointCloud.save": f"save {_SAVE}",
        "TriangleMesh.from_file": "load_mesh read_mesh read_triangle_mesh",
        "TriangleMesh": "Mesh",
        "Lidar": "Sensor LidarSensor RaySensor",
        "Lidar.preset": "preset presets",
    },
    "PointCloud": {
        "cloud.xyz": "points positions coordinates coords vertices xyzs",
        "cloud.xyz[:, 0]": "x",
        "cloud.xyz[:, 1]": "y",
        "cloud.xyz[:, 2]": "z height",
        "cloud.range": "distance distances depth",
        "cloud.time": "timestamp timestamps t",
        "cloud.intensity": "reflectivity remission reflectance",
        "cloud.ring": "channel channels laser_id line",
        "cloud.label, with cloud.class_names": "semantic semantics classes classification class_id",
        'cloud.plot(color_by="label")': "colors color rgb show view visualize",
        "len(cloud)": "size shape num_points n_points",
        "cloud[mask], as cloud[cloud.range < 30]": "filter select select_by_index select_by_mask crop query where mask",
        "cloud[:5] or cloud.to_pandas().head()": "head sample",
        "cloud.transformed(transform)": "transform translate rotate apply_transform",
        "cloud + other or PointCloud.concatenate(clouds)": "append extend merge concat",
        "cloud.save(path)": _SAVE,
        "np.asarray(cloud) for xyz, cloud.to_structured() for all fields": "numpy to_numpy as_array",
        "cloud.to_pandas()": "to_dataframe to_df df",
        "cloud.to_open3d().voxel_down_sample(size)": "voxel_down_sample downsample voxelize",
        "cloud.fields": "columns dtype names keys",
    },
    "Scan": {
        "scan.point_cloud().xyz": "xyz points positions",
        "scan.point_cloud()": "cloud pointcloud to_point_cloud to_pointcloud as_point_cloud get_points",
        "scan.point_cloud().save(path)": f"save {_SAVE}",
        "scan.plot()": "show view visualize",
        "scan.range": "distance distances depth depths",
        "scan.pulses": "ring column azimuth elevation direction directions rays",
        "scan.pulses.time, from scan.time on": "timestamp timestamps",
        "scan.image(field)": "range_image depth_image to_image",
    },
    "Scene": {
        "scene.add(shape)": "add_mesh add_object add_geometry add_shape add_box add_sphere add_plane append insert",
        "scene.remove(id)": "delete remove_object remove_geometry pop",
        "scene.objects": "meshes geometries geometry items actors",
        "scene.cast(origins, directions)": "cast_rays raycast ray_cast trace ray_trace intersect",
        "scene.update(id, transform=…)": "move set_pose set_transform move_object",
        "scene.plot()": "show view visualize render",
        "scene.to_pyvista().save(path)": "save export write",
    },
    "Lidar": {
        "lidar.scan(scene, pose)": "simulate capture measure get_scan sense render cast raycast",
        "lidar.pattern": "channels rings fov elevations azimuths rate frequency",
        "lidar.min_range and lidar.max_range": "range ranges",
        "lidar.measurement": "noise beam returns",
    },
    "Trajectory": {
        "trajectory.at(time)": "pose interpolate sample get_pose",
        "trajectory.poses": "positions matrices transforms points xyz",
        "trajectory.span": "duration start end",
    },
}  # fmt: skip
"""Names from other programs, after what lidarsim has instead, by class."""

_POSES = "poses is an array of shape (n, 4, 4), whose last columns are the positions"
_ARGUMENTS = {
    "Box": {"size is the lengths of the edges": "extents extent dimensions min max half_extents lengths scale"},
    "Cylinder": {"start and end are the ends of the axis": "height length axis center"},
    "Scene": {"scene.add(shape) adds an object, Scene.from_file(path) reads a file": ""},
    "Scene.add": {
        "transform is the 4×4 pose, object to world": "pose position location translation center matrix T",
        "motion is the trajectory": "trajectory path velocity",
        "label is the class": "class_id class_name category semantic cls",
        "instance is the number": "instance_id id object_id",
        "material=Material(reflectivity=…) is the surface": "reflectivity reflectance intensity color colour",
    },
    "Lidar": {"Lidar.preset(name) makes a sensor": "preset model_name sensor", "measurement is the noise": "noise"},
    "Lidar.scan": {
        "pose is the 4×4 matrix, sensor to world": "position transform origin location at sensor_pose trajectory",
        "Lidar.preset(name, noise=…) has noise": "noise noisy",
        "time is the start, s": "t timestamp start",
        "ignore has the instances": "exclude mask",
    },
    "Measurement": {
        "range_sigma is the noise of ranges, m": "noise range_noise sigma std stddev range_std noise_std",
        "dropout is the probability": "drop dropout_rate drop_probability loss",
        "azimuth_sigma and elevation_sigma are the noise of angles, rad": "angle_noise angular_noise jitter",
        "Atmosphere is the fog": "fog rain snow",
    },
    "Table": {
        "directions of azimuth a and elevation e are [cos e · cos a, cos e · sin a, sin e]":
            "azimuth azimuths elevation elevations angles rays",
        "times are in s, rate is of frames, Hz": "time timestamps frequency",
    },
    "Spinning": {
        "elevations are in rad: np.radians(…)": "elevations_deg channels rings fov vertical_fov angles elevation",
        "rate is in Hz": "frequency rpm hz rotation_frequency",
        "columns is the number of azimuths": "azimuths resolution horizontal_resolution points_per_second",
    },
    "Trajectory": {_POSES: "positions points waypoints xyz path translations"},
    "TriangleMesh": {
        "TriangleMesh.from_file(path) reads a file": "path file filename",
        "faces are of indices": "triangles indices",
    },
}  # fmt: skip
"""Names of arguments from other programs, after what is said instead, by callable; "" for other mistakes."""


def instead(owner: str, name: str, known: list[str]) -> str:
    """Return what to use instead of an attribute that a class or module lacks, or ""."""
    others = _ATTRIBUTES.get(owner, {})
    for right, wrong in others.items():
        if name in wrong.split():
            return f"use {right}"
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.8)
    return f"did you mean {near[0]}?" if near else ""


def named(called: Called) -> Called:
    """Let the error for arguments of wrong names or number say what the function, or the class, takes.

    A correct call costs one more call in Python.
    """
    if isinstance(called, type):
        called.__init__ = _named(called.__init__, called.__name__)  # type: ignore[misc]
        return called
    return cast("Called", _named(called, called.__qualname__.removesuffix(".__init__")))


def _named(called: Callable[..., Any], whose: str) -> Callable[..., Any]:
    @functools.wraps(called)
    def checked(*args: Any, **keywords: Any) -> Any:
        try:
            return called(*args, **keywords)
        except TypeError:
            signature = inspect.signature(called)
            try:
                signature.bind(*args, **keywords)
            except TypeError as error:
                known = list(signature.parameters)[1:]
                wrong = next((name for name in keywords if name not in known), "")
                hints = (text for text, names in _ARGUMENTS.get(whose, {}).items() if wrong in (names.split() or [""]))
                got = repr(wrong) if wrong else str(error)
                raise ArgumentTypeError(whose, f"the arguments {', '.join(known)}", got, next(hints, "")) from None
            raise

    return checked
