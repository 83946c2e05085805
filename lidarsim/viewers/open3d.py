"""Open3D: conversion to its tensor point cloud, and its interactive window."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from lidarsim._extras import import_extra
from lidarsim._views import register_view
from lidarsim.pointcloud import Fields, PointCloud, narrowed
from lidarsim.scene import Scene
from lidarsim.viewers._colors import BACKGROUND, coloring
from lidarsim.viewers._display import require_display
from lidarsim.viewers._surfaces import surfaces

if TYPE_CHECKING:
    import open3d

__all__ = ["import_open3d", "show"]


def import_open3d() -> ModuleType:
    """Import Open3D, also on a machine without libusb.

    Open3D's wheel links to ``libusb-1.0.so.0`` for its camera drivers, which servers lack. The package `libusb-package`
    carries that library, and once it is loaded the dynamic linker looks no further.

    Returns
    -------
    module
        `open3d`.

    Raises
    ------
    MissingExtraError
        If Open3D is not installed, or does not import here.
    """
    with suppress(ImportError, OSError):  # Open3D's own import then says what is missing, if anything is
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    return import_extra("open3d", "open3d", "this view")


def to_open3d(cloud: PointCloud) -> open3d.t.geometry.PointCloud:
    """Convert as `PointCloud.to_open3d` documents."""
    o3d = import_open3d()
    columns: Fields = {"positions": cloud.xyz}
    for name in cloud.fields[1:]:
        array = narrowed(name, getattr(cloud, name))
        if name == "normal":
            columns["normals"] = array.astype(np.float64)
        elif array.ndim == 1:
            columns[name] = array[:, np.newaxis]
        else:
            columns |= {f"{name}.{i}": np.ascontiguousarray(array[:, [i]]) for i in range(array.shape[1])}
    converted: open3d.t.geometry.PointCloud = o3d.t.geometry.PointCloud()
    for name, array in columns.items():
        converted.point[name] = o3d.core.Tensor(array)
    return converted


def scene_to_open3d(scene: Scene, **options: Any) -> list[dict[str, Any]]:
    """Convert as `Scene.to_open3d` documents."""
    o3d = import_open3d()
    converted = []
    for surface in surfaces(scene, **options):
        faces = np.ascontiguousarray(surface.outward(), np.int32)
        if not len(faces):
            continue
        mesh = o3d.t.geometry.TriangleMesh(o3d.core.Tensor(surface.points()), o3d.core.Tensor(faces))
        for name, value in (("object_id", surface.object_id), ("label", surface.item.label)):
            column = narrowed(name, np.full(len(faces), value, np.int64))
            mesh.triangle[name] = o3d.core.Tensor(column[:, np.newaxis])
        name = f"{surface.object_id} {surface.item.name}".rstrip()
        converted.append({"name": name, "geometry": mesh})
    return converted


def from_open3d(points: Any) -> dict[str, Any]:
    """Return the fields as `PointCloud.from_open3d` documents."""
    o3d = import_open3d()
    if isinstance(points, o3d.geometry.PointCloud):
        points = o3d.t.geometry.PointCloud.from_legacy(points, o3d.core.float64)
    if not isinstance(points, o3d.t.geometry.PointCloud):
        raise TypeError(f"points: expected an Open3D point cloud, got {type(points).__name__}")
    if "positions" not in points.point:
        raise ValueError("points: expected a point cloud with positions, got an empty one")
    names = {"positions": "xyz", "normals": "normal"}
    fields: dict[str, Any] = {}
    vectors: dict[str, list[Any]] = {}
    for name in sorted(points.point, key=lambda name: (len(name), name)):  # columns of a vector in their order
        array = points.point[name].cpu().numpy()
        if array.ndim == 2 and array.shape[1] == 1:
            array = array[:, 0]
        base, _, index = name.rpartition(".")
        if base and index == str(len(vectors.get(base, ()))):
            vectors.setdefault(base, []).append(array)
        else:
            fields[names.get(name, name)] = array.copy()
    return fields | {name: np.stack(columns, axis=1) for name, columns in vectors.items()}


def show(cloud: PointCloud, *, color_by: str | None = None, point_size: int = 3) -> None:
    """Show a cloud in Open3D's viewer until the user closes it.

    Parameters
    ----------
    cloud : PointCloud
        The points.
    color_by : str, optional
        Scalar field that gives the colours, or ``"height"``; by default the intensity, if there is one.
    point_size : int
        Diameter of a point, pixels.

    Raises
    ------
    LidarsimError
        If there is no display.
    MissingExtraError
        If Open3D is not installed.
    ValueError
        If the cloud has no scalar field `color_by`.
    """
    rgb = coloring(cloud, color_by).rgb()
    require_display()
    o3d = import_open3d()
    geometry = to_open3d(cloud)
    geometry.point["colors"] = o3d.core.Tensor(rgb)
    background = (*(channel / 255 for channel in bytes.fromhex(BACKGROUND[1:])), 1.0)
    o3d.visualization.draw(
        geometry, title="lidarsim", bg_color=background, point_size=point_size, show_skybox=False, show_ui=True
    )


register_view(PointCloud, "open3d", to_open3d)
register_view(PointCloud, "from_open3d", from_open3d)
register_view(Scene, "open3d", scene_to_open3d)
