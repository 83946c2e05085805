"""PyVista: conversion to its point data set, and a picture of a cloud, on the screen or as a PNG."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import closing
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from lidarsim import _validation
from lidarsim._extras import import_extra
from lidarsim._files import PathLike, atomic_writer, check_folder, check_suffix
from lidarsim._validation import Floats
from lidarsim._views import register_view
from lidarsim.errors import LidarsimError
from lidarsim.pointcloud import PointCloud
from lidarsim.scene import Scene
from lidarsim.viewers._colors import BACKGROUND, Coloring, coloring
from lidarsim.viewers._display import require_display
from lidarsim.viewers._surfaces import Surface, surfaces

if TYPE_CHECKING:
    import pyvista

__all__ = ["check_screenshot", "render"]


def to_pyvista(cloud: PointCloud) -> pyvista.PolyData:
    """Convert as `PointCloud.to_pyvista` documents."""
    pv = import_extra("pyvista", "pyvista", "this view")
    converted: pyvista.PolyData = pv.PolyData(cloud.xyz)
    for name in cloud.fields[1:]:
        array = getattr(cloud, name)
        if array.shape[0] or array.ndim == 1:
            converted.point_data[name] = array
        else:  # PyVista refuses an empty vector field, VTK does not
            converted.point_data.VTKObject.AddArray(pv.convert_array(array, name=name))
    if cloud.class_names:
        converted.field_data["class_label"] = np.array(list(cloud.class_names), np.uint32)
        converted.field_data["class_name"] = list(cloud.class_names.values())
    return converted


def from_pyvista(mesh: pyvista.DataSet) -> dict[str, Any]:
    """Return the fields as `PointCloud.from_pyvista` documents."""
    if not (hasattr(mesh, "points") and hasattr(mesh, "point_data")):
        raise TypeError(f"mesh: expected a PyVista data set, got {type(mesh).__name__}")
    fields: dict[str, Any] = {"xyz": np.asarray(mesh.points)}
    for name, array in mesh.point_data.items():
        if array.dtype.kind in "biuf":
            fields["normal" if name == "Normals" else name] = np.asarray(array)
    if {"class_label", "class_name"} <= set(mesh.field_data.keys()):
        labels, names = mesh.field_data["class_label"], mesh.field_data["class_name"]
        fields["class_names"] = {int(label): str(name) for label, name in zip(labels, names, strict=True)}
    return fields


def scene_to_pyvista(scene: Scene, **options: Any) -> pyvista.MultiBlock:
    """Convert as `Scene.to_pyvista` documents."""
    pv = import_extra("pyvista", "pyvista", "this view")
    blocks: pyvista.MultiBlock = pv.MultiBlock()
    shared: dict[tuple[int, bool], pyvista.CellArray] = {}
    for surface in surfaces(scene, **options):
        block = _triangles(surface, shared)
        block.cell_data["object_id"] = np.full(block.n_cells, surface.object_id, np.int32)
        block.cell_data["label"] = np.full(block.n_cells, surface.item.label, np.uint32)
        block.field_data["name"] = [surface.item.name]
        blocks.append(block, surface.item.name or f"object {surface.object_id}")
    return blocks


def _triangles(surface: Surface, shared: dict[tuple[int, bool], pyvista.CellArray]) -> pyvista.PolyData:
    """Return a surface in the world; those of one shape have the same connectivity."""
    pv = import_extra("pyvista", "pyvista", "this view")
    faces = surface.outward()
    key = id(surface.vertices), faces is surface.faces
    if key not in shared:
        shared[key] = pv.CellArray.from_regular_cells(faces)
    triangles: pyvista.PolyData = pv.PolyData()
    triangles.SetPoints(pv.vtk_points(surface.points()))
    triangles.SetPolys(shared[key])
    return triangles


def check_screenshot(path: PathLike) -> None:
    """Check, before any work, that `render` can write a file: a PNG, in a folder that is there.

    Parameters
    ----------
    path : path-like
        The picture to be written.

    Raises
    ------
    FileFormatError
        If the suffix is not ``.png``.
    OSError
        If the folder does not exist or cannot be written in.
    """
    check_suffix(path, {".png"})
    check_folder(path)


def render(
    cloud: PointCloud,
    path: PathLike | None = None,
    *,
    color_by: str | None = None,
    meshes: Iterable[Any] = (),
    pose: Any = None,
    camera: Sequence[Sequence[float]] | None = None,
    window_size: tuple[int, int] = (1600, 1000),
    point_size: float | None = None,
) -> None:
    """Show a cloud in a window until the user closes it, or write the picture to a PNG file, which needs no display.

    Parameters
    ----------
    cloud : PointCloud
        The points.
    path : path-like, optional
        PNG file to write instead of opening a window.
    color_by : str, optional
        Scalar field that gives the colours, or ``"height"``; by default the intensity, if there is one.
    meshes : iterable of pyvista.DataSet or trimesh.Trimesh
        Surfaces to show translucent, in the frame of the cloud.
    pose : RigidTransform or array_like of shape (4, 4), optional
        Pose of the sensor in the frame of the cloud, shown by its axes (x red, y green, z blue); by default the origin.
    camera : sequence of three points, optional
        Position, focal point and up vector; by default behind and above the sensor, as far off as to see most points.
    window_size : tuple of int
        Width and height, pixels.
    point_size : float, optional
        Diameter of a point, in half pixels; by default the more points, the smaller.

    Raises
    ------
    FileFormatError
        If the suffix of `path` is not ``.png``.
    LidarsimError
        If there is no display for a window, or no OpenGL for a picture.
    MissingExtraError
        If PyVista is not installed.
    OSError
        If the file cannot be written.
    ValueError
        If the cloud has no scalar field `color_by`.
    """
    cloud = cloud[np.isfinite(cloud.xyz).all(axis=1)]
    colors = coloring(cloud, color_by)
    sensor = np.eye(4) if pose is None else _validation.pose("pose", pose)
    if path is None:
        require_display()
    else:
        check_screenshot(path)
    middle, size = _extent(cloud, sensor)
    if camera is None:
        forward, left, up = sensor[:3, 0], sensor[:3, 1], np.array([0.0, 0.0, 1.0])
        eye, target = middle + size * (-2.0 * forward + 0.5 * left + 1.3 * up), middle
    else:
        eye, target, up = _validation.array("camera", camera, (3, 3))
    pv = import_extra("pyvista", "pyvista", "this view")
    # VTK reports each kind of window that it tries in vain.
    with pv.vtk_verbosity("off"), closing(pv.Plotter(off_screen=path is not None, window_size=window_size)) as plotter:
        # All is drawn relative to the middle: the graphics card has float32, too coarse for map coordinates.
        plotter.set_background(BACKGROUND)
        if len(cloud):  # PyVista refuses to draw nothing
            _add_points(plotter, cloud.xyz - middle, colors, point_size)
        for mesh in meshes:
            plotter.add_mesh(mesh, color="white", opacity=0.15).position = -middle
        if np.linalg.norm(sensor[:3, 3] - middle) < 1000 * size:  # else it would be a dot, and spoil the depth buffer
            for axis, color in enumerate(("#ff4b4b", "#4bd964", "#4b8bff")):
                arrow = pv.Arrow(start=sensor[:3, 3] - middle, direction=sensor[:3, axis], scale=0.06 * size)
                plotter.add_mesh(arrow, color=color, lighting=False)
        # VTK's nearest visible depth is a fraction of the farthest: one far point must not hide all near ones.
        farthest = np.linalg.norm(cloud.xyz - eye, axis=1).max(initial=size)
        plotter.renderer.SetNearClippingPlaneTolerance(0.01 * size / farthest)
        plotter.camera_position = (eye - middle, target - middle, up)
        plotter.enable_anti_aliasing("ssaa")
        if path is None:
            plotter.show(title="lidarsim")
        else:
            _write_png(plotter, path)


def _write_png(plotter: pyvista.Plotter, path: PathLike) -> None:
    window: Any = plotter.render_window
    window.Initialize()
    if not window.GetInitialized():  # VTK would draw nevertheless, and crash
        raise LidarsimError("no OpenGL to draw with: install libEGL (Debian, Ubuntu: apt install libegl1)")
    image = BytesIO()
    plotter.screenshot(image)
    with atomic_writer(path) as file:
        file.write(image.getvalue())


def _add_points(plotter: pyvista.Plotter, xyz: Floats, colors: Coloring, size: float | None) -> None:
    if size is None:  # of as many pixels as it takes for the points to cover about the same part of the picture
        size = float(np.clip(5 * (100_000 / len(xyz)) ** 0.25, 3, 12))
    plotter.add_points(
        xyz,
        scalars=colors.values,
        cmap=colors.table,
        clim=colors.limits,
        point_size=size,
        render_points_as_spheres=True,
        lighting=False,
        annotations=dict(enumerate(colors.names)),
        show_scalar_bar=len(colors.names) <= 20,
        scalar_bar_args={
            "title": f"{colors.title}\n",  # a line clear of the topmost number
            "vertical": True,
            "position_x": 0.93,
            "position_y": 0.25,
            "width": 0.05,
            "height": 0.5,
            "n_labels": 0 if colors.names else 5,
            "fmt": "%.3g",
            "color": "white",
        },
    )


def _extent(cloud: PointCloud, sensor: Floats) -> tuple[Floats, float]:
    """Return the middle of the points and how far they reach, however far a few of them lie."""
    if not len(cloud):
        return sensor[:3, 3], 10.0
    middle = np.median(cloud.xyz, axis=0)
    half, most = np.percentile(np.linalg.norm(cloud.xyz - middle, axis=1), (50, 90))
    return middle, float(max(most, 1.6 * half)) or 1.0  # a ball is seen whole, a street without its far ends


register_view(PointCloud, "pyvista", to_pyvista)
register_view(PointCloud, "from_pyvista", from_pyvista)
register_view(Scene, "pyvista", scene_to_pyvista)
