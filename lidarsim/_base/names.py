"""Errors for names from other programs, which name lidarsim's."""

from __future__ import annotations

import difflib
import functools
import inspect
from abc import ABCMeta
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, cast

from lidarsim.errors import ArgumentTypeError

Called = TypeVar("Called", bound=Callable[..., Any])

_SAVE = "write export to_file to_csv to_pcd to_ply to_las to_npz write_point_cloud save_point_cloud"
_LOAD = "read open from_file load_file"
_ATTRIBUTES = {
    "lidarsim": {
        "PointCloud.load, Scene.from_file, config.load, datasets.load or Trajectory.load": "load read open from_file",
        "PointCloud.load": "load_point_cloud read_point_cloud load_cloud load_pcd",
        "PointCloud.save": f"save {_SAVE}",
        "TriangleMesh.from_file": "load_mesh read_mesh read_triangle_mesh",
        "TriangleMesh": "Mesh",
        "Lidar": "Sensor LidarSensor RaySensor",
        "Lidar.preset": "preset presets",
        "a 4×4 array or scipy.spatial.transform.RigidTransform": "Pose Transform SE3 RigidTransform",
    },
    "PointCloud": {
        "PointCloud.load(path)": f"{_LOAD} from_pcd from_ply from_las",
        "PointCloud(xyz, …)": "from_numpy from_array from_points from_xyz from_arrays",
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
        "np.asarray(cloud) for xyz, cloud.to_structured() for all fields": "numpy to_numpy as_array values tolist",
        "cloud.to_pandas()": "to_dataframe to_df df describe groupby iloc loc sort_values value_counts",
        "cloud.to_open3d().voxel_down_sample(size)": "voxel_down_sample downsample voxelize",
        "cloud.to_open3d(), which has it": (
            "estimate_normals remove_statistical_outlier remove_radius_outlier cluster_dbscan segment_plane"
            " uniform_down_sample farthest_point_down_sample compute_nearest_neighbor_distance"
            " get_axis_aligned_bounding_box get_oriented_bounding_box paint_uniform_color"
        ),
        "cloud.to_pyvista(), which has it": "point_data glyph delaunay_2d delaunay_3d threshold clip",
        "cloud.xyz, as cloud.xyz.min(axis=0)":
            "min max mean std sum T astype center bounds extent min_bound max_bound"
            " get_center get_min_bound get_max_bound",
        "cloud.fields, as 'normal' in cloud.fields": "has_normals has_points has_colors is_empty array_names",
        "scan.boxes()": "boxes bounding_boxes",
        "scan.image(field)": "image range_image depth_image to_image",
        "torch.from_numpy(cloud.xyz)": "torch to_torch to_tensor tensor",
        "cloud.fields": "columns dtype names keys",
    },
    "Labels": {"np.isin(cloud.label, names)": "isin", "np.unique(cloud.label, return_counts=True)": "value_counts"},
    "Scan": {
        "scan.point_cloud().xyz": "xyz points positions coordinates numpy to_numpy",
        "scan.point_cloud()":
            "cloud pointcloud to_point_cloud to_pointcloud as_point_cloud get_points"
            " to_open3d to_pyvista to_pandas to_structured fields",
        "scan.status == 'hit'": "hits hit valid mask misses",
        "len(scan)": "size shape num_points n_points count",
        "scan.boxes()": "bounding_boxes get_boxes objects",
        "scan.label, with scan.class_names": "classes semantic semantics names class_id",
        "scan.point_cloud().save(path)": f"save {_SAVE}",
        "scan.plot(color_by=…)": "show view visualize colors color",
        "scan.range": "distance distances depth depths",
        "scan.pulses": "ring column azimuth elevation direction directions rays",
        "scan.pulses.time, from scan.time on": "timestamp timestamps",
        "scan.image(field)": "range_image depth_image to_image",
    },
    "Scene": {
        "scene.add(shape)": "add_mesh add_object add_geometry add_shape add_box add_sphere add_plane append insert",
        "Scene.from_file(path)": "load read open load_file",
        "copy.copy(scene)": "copy clone",
        "Scene(), a new one": "clear reset",
        "scene.add(item.shape, …) for each item of the other": "merge extend concatenate",
        "len(scene)": "size n_objects num_objects",
        "[item.name for item in scene]": "names labels ids",
        "scene.remove(id)": "delete remove_object remove_geometry pop",
        "scene.objects": "meshes geometries geometry items actors shapes",
        "scene.cast(origins, directions)": "cast_rays raycast ray_cast trace ray_trace intersect",
        "scene.update(id, transform=…)": "move set_pose set_transform move_object",
        "scene.plot()": "show view visualize render",
        "scene.to_pyvista().save(path)": "save export write",
    },
    "Lidar": {
        "lidar.scan(scene, pose)": "simulate capture measure get_scan sense render cast raycast",
        "lidar.pattern":
            "channels rings fov elevations azimuths rate frequency frame_rate resolution columns n_channels"
            " num_channels horizontal_fov vertical_fov field_of_view shape",
        "lidar.pattern.pulses()": "directions rays pulses generate_rays get_rays",
        "lidar.scan(scene, pose), since a sensor has none": "pose position transform mount set_pose move_to",
        "Lidar.preset(name)": "from_preset from_name from_model",
        "Lidar.presets()": "list list_presets models available",
        "Lidar.from_file(path)": "load read open from_yaml",
        "lidar.min_range and lidar.max_range": "range ranges",
        "lidar.measurement": "noise beam returns",
    },
    "Trajectory": {
        "trajectory.at(time)": "pose interpolate sample get_pose evaluate position rotation orientation",
        "trajectory.poses": "positions matrices transforms points xyz rotations orientations translations",
        "trajectory.span": "duration start end start_time end_time",
        "Trajectory(times, poses)": "from_poses from_points from_positions from_waypoints",
        "trajectory.velocity(times)": "speed velocities twist",
        "Trajectory.load(path)": _LOAD,
        "show(trajectory.at(times), …)": "plot show",
    },
    "Boxes": {
        "boxes.center": "position positions xyz location centre",
        "boxes.size": "extent extents dimensions dims lengths lwh wlh",
        "boxes.label, with boxes.class_names": "classes category categories class_id names",
        "boxes.yaw or boxes.rotation": "heading orientation angle R",
        "boxes.corners": "vertices bounds get_box_points",
        "boxes.instance": "track_id id ids track_ids",
    },
    "Hits": {
        "hits.t": "t_hit distance distances range depth",
        "origins + hits.t[:, None] * directions": "points point xyz position positions",
        "hits.object_id": "geometry_ids instance label",
        "hits.primitive_id": "primitive_ids face face_id triangle triangle_id",
        "hits.normal": "primitive_normals",
    },
    "TriangleMesh": {
        "TriangleMesh.from_file(path)": "load read open from_path from_stl from_obj",
        "mesh.vertices": "points xyz verts",
        "mesh.faces": "triangles cells",
        "len(mesh)": "n_faces n_cells num_faces n_triangles",
    },
    "Shape": {
        "scene.add(shape, transform=…)": "translate rotate scale move position pose rotation location apply_transform",
        "shape.bounds": "extents extent aabb get_axis_aligned_bounding_box",
        "shape.cast(origins, directions)": "intersect intersects ray_cast cast_rays raycast hit ray",
        "scene.add(shape, …)": "name label material color reflectivity instance",
        "lidarsim.show(scene), with the shape in it": "plot show view",
    },
    "SceneObject": {
        "item.transform, or item.motion": "pose position matrix location",
        "item.shape": "mesh geometry",
        "item.id": "object_id",
        "item.material": "reflectivity color",
    },
    "Rig": {"rig.frames(scene, trajectory, count)": "simulate capture", "rig[name]": "sensors lidars members"},
}  # fmt: skip
"""Names from other programs, after what lidarsim has instead, by class, or by a base of it."""

_POSES = "poses is an array of shape (n, 4, 4), whose last columns are the positions"
_ARGUMENTS = {
    "Beam": {"divergence_azimuth and divergence_elevation are full angles, rad": "divergence angle width fwhm"},
    "Box": {
        "size is the lengths of the edges":
            "extents extent dimensions min max half_extents lengths scale width height depth length",
        "center is the middle": "position pos location origin",
    },
    "Cylinder": {"start and end are the ends of the axis": "height length axis center"},
    "Scene": {"scene.add(shape) adds an object, Scene.from_file(path) reads a file": "",
        "scene.add(shape) adds an object": "objects meshes shapes geometries"},
    "Scene.add": {
        "transform is the 4×4 pose, object to world": "pose position location translation center matrix T rotation",
        "shape comes first": "mesh geometry object",
        "motion is the trajectory": "trajectory path velocity",
        "label is the class": "class_id class_name category semantic cls",
        "instance is the number": "instance_id id object_id",
        "material=Material(reflectivity=…) is the surface": "reflectivity reflectance intensity color colour",
    },
    "Grid": {
        "azimuths and elevations are arrays of angles, rad":
            "azimuths_deg elevations_deg fov field_of_view channels rings columns rows resolution angles",
    },
    "Lidar": {
        "Lidar.preset(name) makes a sensor": "preset model_name sensor",
        "measurement is the noise": "noise",
        "pattern has them": "channels rings rate fov columns elevations azimuths frequency",
    },
    "Lidar.scan": {
        "pose is the 4×4 matrix, sensor to world": "position transform origin location at sensor_pose trajectory",
        "Lidar.preset(name, noise=…) has noise": "noise noisy",
        "time is the start, s": "t timestamp start",
        "ignore has the instances": "exclude mask",
    },
    "Material": {
        "reflectivity is a number; Material.from_colors(colors) takes colours": "color colour albedo rgb diffuse",
        "lidarsim.materials has those of the library, as materials.ASPHALT": "",
    },
    "Measurement": {
        "range_sigma is the noise of ranges, m": "noise range_noise sigma std stddev range_std noise_std",
        "dropout is the probability": "drop dropout_rate drop_probability loss",
        "azimuth_sigma and elevation_sigma are the noise of angles, rad": "angle_noise angular_noise jitter",
        "Atmosphere is the fog": "fog rain snow",
    },
    "Plane": {
        "Plane.from_point(point, normal) takes a point": "point origin center position",
        "a plane has no end: Box, Polygon and Disk have one": "size width length extent",
    },
    "Rig": {"sensors is a mapping, as {name: (lidar, mount)}": "lidars mounts poses"},
    "Scan.point_cloud": {
        "frame is 'sensor' or 'world'": "coordinates in_world world frame_id",
        "deskew is the moment": "undistort motion_compensation compensate",
    },
    "Sphere": {"center and radius are in m": "r diameter position pos location"},
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


def instead(owner: str | type, name: str, known: list[str]) -> str:
    """Return what to use instead of an attribute that a class or module lacks, or ""."""
    for whose in (owner,) if isinstance(owner, str) else (kind.__name__ for kind in owner.__mro__):
        for right, wrong in _ATTRIBUTES.get(whose, {}).items():
            if name in wrong.split():
                return f"use {right}"
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.8)
    return f"did you mean {near[0]}?" if near else ""


class Answering(type):
    """Metaclass of the classes whose errors for missing attributes say what to use instead."""

    if not TYPE_CHECKING:  # type checkers know all attributes

        def __getattr__(cls, name: str) -> NoReturn:
            """Raise the error; called only for a missing attribute of the class itself."""
            public = [other for other in dir(cls) if other[0] != "_"]
            hint = "" if name.startswith("_") else instead(cls, name, public)
            problem = f"type object {cls.__name__!r} has no attribute {name!r}"
            raise AttributeError(f"{problem}; {hint}" if hint else problem, name=name, obj=cls)


class AnsweringABC(Answering, ABCMeta):
    """The same of an abstract base class."""


def explain_arguments(called: Called) -> Called:
    """Let the error for arguments of wrong names or number say what the function, or the class, takes.

    A correct call costs one more call in Python.
    """
    if isinstance(called, type):
        called.__init__ = _explain_mistakes(called.__init__, called.__name__)  # type: ignore[misc]
        return called
    return cast("Called", _explain_mistakes(called, called.__qualname__.removesuffix(".__init__")))


def _explain_mistakes(called: Callable[..., Any], whose: str) -> Callable[..., Any]:
    @functools.wraps(called)
    def call(*args: Any, **keywords: Any) -> Any:
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

    return call
