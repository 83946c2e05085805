"""Open3D: conversion to tensor point clouds and meshes, and the interactive window."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.shown import plain
from lidarsim._base.validation import Floats
from lidarsim._base.views import register_view
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, LidarsimError
from lidarsim.materials import linear_light
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.fields import Fields, narrow
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.viewers._boxes import LINES, lines
from lidarsim.viewers._colors import NAME, _channels
from lidarsim.viewers._display import require_display
from lidarsim.viewers._picture import Picture, split_by_color
from lidarsim.viewers._surfaces import Surface, surfaces
from lidarsim.world.scene import Scene

if TYPE_CHECKING:
    import open3d


def import_open3d() -> ModuleType:
    """Import Open3D, also on a machine without libusb.

    Open3D's wheel links to ``libusb-1.0.so.0`` for its camera drivers, which servers lack. The package `libusb-package`
    contains that library; once it is loaded, the dynamic linker uses it.
    """
    with suppress(ImportError, OSError):  # the import of Open3D reports what is missing
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    return import_extra("open3d", "open3d", "this view")


def to_open3d(cloud: PointCloud) -> open3d.t.geometry.PointCloud:
    """Convert a cloud as documented in `PointCloud.to_open3d`."""
    o3d = import_open3d()
    columns: Fields = {"positions": cloud.xyz}
    for name in cloud.fields[1:]:
        array = narrow(name, getattr(cloud, name))
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
    """Convert a scene as documented in `Scene.to_open3d`."""
    o3d = import_open3d()
    converted = []
    for surface in surfaces(scene, **options):
        if not len(surface.faces):
            continue
        mesh = _mesh(o3d, surface)
        for name, value in (("object_id", surface.object_id), ("label", surface.labels)):
            column = narrow(name, np.full(len(surface.faces), value, np.int64))
            mesh.triangle[name] = o3d.core.Tensor(column[:, np.newaxis])
        name = f"{surface.object_id} {surface.item.name}".rstrip()
        converted.append({"name": name, "geometry": mesh})
    return converted


def from_open3d(points: Any) -> dict[str, Any]:
    """Return the fields as documented in `PointCloud.from_open3d`."""
    o3d = import_open3d()
    if isinstance(points, o3d.geometry.PointCloud):
        points = o3d.t.geometry.PointCloud.from_legacy(points, o3d.core.float64)
    if not isinstance(points, o3d.t.geometry.PointCloud):
        raise ArgumentTypeError("points", "an Open3D point cloud", type(points).__name__)
    if "positions" not in points.point:
        raise ArgumentValueError("points", "a point cloud with positions", "an empty one")
    own = sorted(points.point, key=lambda name: (name != "positions", len(name), name))  # components in order
    fields: dict[str, Any] = {}
    vectors: dict[str, list[Any]] = {}
    for name in own:
        array = points.point[name].cpu().numpy()
        if array.ndim == 2 and array.shape[1] == 1:
            array = array[:, 0]
        base, _, index = name.rpartition(".")
        if base and base not in {*own, "xyz", "normal"} and index == str(len(vectors.get(base, ()))):
            vectors.setdefault(base, []).append(array)
        else:
            field = {"positions": "xyz", "normals": "normal"}.get(name, name)
            fields[f"{field} 2" if field in fields else field] = array.copy()
    return fields | {name: np.stack(columns, axis=1) for name, columns in vectors.items()}


def _mesh(o3d: ModuleType, surface: Surface) -> open3d.t.geometry.TriangleMesh:
    faces = np.ascontiguousarray(surface.outward(), np.int32)
    mesh: open3d.t.geometry.TriangleMesh = o3d.t.geometry.TriangleMesh(
        o3d.core.Tensor(surface.points()), o3d.core.Tensor(faces)
    )
    return mesh


def _part(o3d: ModuleType, surface: Surface, which: str, picture: Picture, middle: Floats) -> list[dict[str, Any]]:
    """Return a surface as input for Open3D's viewer, one geometry per colour; empty without triangles."""
    if not len(surface.faces):
        return []
    colors = picture.colors
    by_height = colors.field == "height"
    name = f"{surface.object_id} {plain(surface.item.name, most=NAME)}".rstrip()
    if by_height:  # colours are interpolated linearly in a triangle, so it must not span many
        surface = surface.refine((colors.limits[1] - colors.limits[0]) / 16)
    parts = []
    for number, (color, part) in enumerate(split_by_color(surface, picture)):
        material = o3d.visualization.rendering.MaterialRecord()
        material.shader = "defaultLitTransparency"
        channels = (255, 255, 255) if by_height else bytes.fromhex(color[1:])
        material.base_color = (*(channel / 255 for channel in channels), 0.3)
        mesh = _mesh(o3d, part).translate(o3d.core.Tensor(-middle)).compute_vertex_normals()
        if by_height:
            mesh.vertex["colors"] = o3d.core.Tensor(_linear(colors.rgb_of(part.points()[:, 2])))
        several = f" ({number})" if number else ""
        parts.append({"name": f"{name}{several}{which}", "geometry": mesh, "material": material})
    return parts


def _wireframe(o3d: ModuleType, boxes: Boxes, picture: Picture, middle: Floats) -> open3d.t.geometry.LineSet:
    ends = lines(boxes).reshape(-1, 3) - middle
    wires: open3d.t.geometry.LineSet = o3d.t.geometry.LineSet(
        o3d.core.Tensor(ends), o3d.core.Tensor(np.arange(len(ends), dtype=np.int32).reshape(-1, 2))
    )
    colors = _channels([picture.class_color(label) for label in boxes.label.tolist()])
    wires.line["colors"] = o3d.core.Tensor(np.repeat(_linear(colors), LINES, axis=0))
    return wires


def _linear(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """Return colours in linear light, 0 to 1, which Open3D's viewer expects for points (IEC 61966-2-1)."""
    return linear_light(rgb / np.float32(255)).astype(np.float32)


def draw(picture: Picture, *, size: tuple[int, int], point_size: float | None) -> None:
    """Show a picture in Open3D's viewer until it is closed; its list of geometries selects among frames.

    Parameters
    ----------
    picture : Picture
        The picture.
    size : tuple of int
        Width and height of the window, pixels.
    point_size : float, optional
        Diameter of a point, pixels; by default 3.

    Raises
    ------
    LidarsimError
        If there is no display, or Open3D cannot draw on it.
    MissingExtraError
        If Open3D is not installed.
    """
    require_display()
    o3d = import_open3d()
    seen = picture.points_to_show()
    middle = seen.mean(axis=0)  # graphics use float32, too coarse for map coordinates
    dots = o3d.visualization.rendering.MaterialRecord()
    dots.shader = "defaultUnlit"  # lighting must not change the colour of a class
    dots.point_size = point_size or 3
    parts: list[dict[str, Any]] = []
    for number, frame in enumerate(picture.frames):
        points = to_open3d(frame.cloud)
        points.point["colors"] = o3d.core.Tensor(_linear(picture.colors.rgb(frame.cloud)))
        parts.append(
            {
                "name": f"frame {number}",
                "geometry": points.translate(-middle),
                "material": dots,
                "is_visible": not number,
            }
        )
        several = f", frame {number}" if len(picture.frames) > 1 else ""
        if frame.boxes:
            boxes = _wireframe(o3d, frame.boxes, picture, middle)
            parts.append({"name": f"boxes{several}", "geometry": boxes, "is_visible": not number})
        for mover in frame.movers:
            parts += [{**part, "is_visible": not number} for part in _part(o3d, mover, several, picture, middle)]
    for surface in picture.surfaces:
        parts += _part(o3d, surface, "", picture, middle)
    if len(picture.path):
        joints = np.arange(len(picture.path) - 1, dtype=np.int32)
        path = o3d.t.geometry.LineSet(
            o3d.core.Tensor(picture.path - middle), o3d.core.Tensor(np.stack([joints, joints + 1], axis=-1))
        )
        parts.append({"name": "path", "geometry": path})
    reach = float(np.linalg.norm(seen - middle, axis=1).max())
    axes = o3d.t.geometry.TriangleMesh.create_coordinate_frame(0.1 * reach)
    pose = picture.frames[0].pose.copy()
    pose[:3, 3] -= middle
    parts.append({"name": "sensor", "geometry": axes.transform(pose)})
    view = picture.view(0, seen, size[0] / size[1])
    errors_alone = o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error)
    try:
        with errors_alone:  # hides warnings of arrays rounded to float32
            o3d.visualization.draw(
                parts,
                title="lidarsim",
                width=size[0],
                height=size[1],
                lookat=view.target - middle,
                eye=view.eye - middle,
                up=view.up,
                field_of_view=float(np.degrees(view.angle)),
                bg_color=(*(channel / 255 for channel in bytes.fromhex(picture.theme.background[1:])), 1.0),
                point_size=round(point_size or 3),
                show_skybox=False,
                show_ui=True,
            )
    except RuntimeError as error:  # no Vulkan or OpenGL
        raise LidarsimError(f"Open3D cannot open a window here ({error}): try the viewer pyvista") from error


register_view(PointCloud, "open3d", to_open3d)
register_view(PointCloud, "from_open3d", from_open3d)
register_view(Scene, "open3d", scene_to_open3d)
