"""PyVista: conversion of clouds and scenes, and pictures of them in a window or as PNG, GIF or MP4."""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from io import BytesIO
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, atomic_writer, check_folder, check_suffix
from lidarsim._base.shown import plain, quantity
from lidarsim._base.validation import Floats
from lidarsim._base.views import register_view
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, LidarsimError
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.viewers._boxes import LINES, lines
from lidarsim.viewers._colors import AXES, PATH, Coloring, _channels
from lidarsim.viewers._display import require_display
from lidarsim.viewers._picture import AXIS, TO_SUN, Frame, Picture, grid, split_by_color
from lidarsim.viewers._surfaces import Surface, merge_surfaces, surfaces
from lidarsim.world.scene import Scene

if TYPE_CHECKING:
    import pyvista

ROOM = 0.002
"""Greatest share of the points that a legend may hide, and no box; otherwise the view is shifted away from it."""
STILLS = {".png": "PNG", ".jpg": "JPG"}
"""Kinds of pictures of a single frame by suffix."""
QUALITY = 92
"""Quality of JPG files: text stays sharp."""
TURN = 90
"""Images of a film that circles a single frame once."""
INSTANCED = 1000
"""Least number of triangles of a shared mesh to be drawn as instances; all other meshes are merged."""
LONGEST = 22
"""Greatest length of a text in the legend, characters."""
FONT_FILE = 4
"""VTK's constant for a font from a file (``VTK_FONT_FILE``)."""
SHADING = {"ambient": 0.35, "diffuse": 0.65}
SUN, HEADLIGHT = 0.9, 0.35
"""Intensities of the light from `TO_SUN`, which shows relief from above, and of the light from the camera."""


def to_pyvista(cloud: PointCloud) -> pyvista.PolyData:
    """Convert a cloud as documented in `PointCloud.to_pyvista`."""
    pv = import_extra("pyvista", "pyvista", "this view")
    converted: pyvista.PolyData = pv.PolyData(cloud.xyz)
    for name in cloud.fields[1:]:
        array = getattr(cloud, name)
        if array.shape[0] or array.ndim == 1:
            converted.point_data[name] = array
        else:  # PyVista refuses empty vector fields, VTK does not; VTK has no bool, which PyVista notes by name
            converted.point_data[name] = array[:, 0]
            stored = array.view(np.uint8) if array.dtype == np.bool_ else array
            converted.point_data.VTKObject.AddArray(pv.convert_array(stored, name=name))
    if cloud.class_names:
        converted.field_data["class_label"] = np.array(list(cloud.class_names), np.uint32)
        _add_texts(converted, "class_name", cloud.class_names.values())
    return converted


def _add_texts(mesh: pyvista.DataSet, name: str, texts: Iterable[str]) -> None:
    """Add texts as field data by VTK, since PyVista only takes ASCII."""
    array = import_extra("vtkmodules.vtkCommonCore", "pyvista", "this view").vtkStringArray()
    array.SetName(name)
    for text in texts:
        array.InsertNextValue(_encodable(text))
    mesh.field_data.VTKObject.AddArray(array)


def _encodable(text: str) -> str:
    """Return a text that VTK accepts: surrogates, which UTF-8 cannot encode, become escapes."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def from_pyvista(mesh: pyvista.DataSet) -> dict[str, Any]:
    """Return the fields as documented in `PointCloud.from_pyvista`."""
    if not (hasattr(mesh, "points") and hasattr(mesh, "point_data")):
        raise ArgumentTypeError("mesh", "a PyVista data set", type(mesh).__name__)
    fields: dict[str, Any] = {"xyz": np.asarray(mesh.points)}
    for name, array in mesh.point_data.items():
        if array.dtype.kind in "biuf":
            field = "normal" if name == "Normals" else name
            fields[f"{field} 2" if field in fields else field] = np.asarray(array)
    if {"class_label", "class_name"} <= set(mesh.field_data.keys()):
        labels, names = mesh.field_data["class_label"], mesh.field_data["class_name"]
        fields["class_names"] = {int(label): str(name) for label, name in zip(labels, names, strict=True)}
    return fields


def scene_to_pyvista(scene: Scene, **options: Any) -> pyvista.MultiBlock:
    """Convert a scene as documented in `Scene.to_pyvista`."""
    pv = import_extra("pyvista", "pyvista", "this view")
    blocks: pyvista.MultiBlock = pv.MultiBlock()
    shared: dict[tuple[int, bool], pyvista.CellArray] = {}
    for surface in surfaces(scene, **options):
        block = _triangles(surface, shared)
        block.cell_data["object_id"] = np.full(block.n_cells, surface.object_id, np.int32)
        block.cell_data["label"] = surface.labels
        _add_texts(block, "name", [surface.item.name])
        blocks.append(block, _encodable(surface.item.name) or f"object {surface.object_id}")
    return blocks


def _triangles(surface: Surface, shared: dict[tuple[int, bool], pyvista.CellArray]) -> pyvista.PolyData:
    """Return a surface in the world; surfaces of one shape share their connectivity."""
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
    """Check, before any work, that a picture can be written: a PNG or JPG in an existing folder.

    Raises
    ------
    FileFormatError
        If the suffix is neither ``.png`` nor ``.jpg``.
    OSError
        If the folder does not exist or is not writable.
    """
    check_suffix(path, STILLS)
    check_folder(path)


def draw(picture: Picture, path: PathLike | None, *, size: tuple[int, int], point_size: float | None) -> None:
    """Show a picture in a window until it is closed, or write one frame as PNG, or all as GIF or MP4.

    Parameters
    ----------
    picture : Picture
        The picture.
    path : path-like, optional
        The file; without it, a window opens.
    size : tuple of int
        Width and height, pixels.
    point_size : float, optional
        Diameter of a point, pixels; by default smaller for more points.

    Raises
    ------
    LidarsimError
        If there is no display for a window, or no OpenGL.
    MissingExtraError
        If PyVista, or the package for MP4 files, is not installed.
    OSError
        If the file cannot be written.
    ValueError
        If a PNG is requested for several frames.
    """
    suffix = "" if path is None else Path(path).suffix.lower()
    if suffix in STILLS and len(picture.frames) > 1:
        raise ArgumentValueError(
            "save",
            f"one frame for a {STILLS[suffix]}",
            len(picture.frames),
            "GIF, MP4 and HTML (on the command line --gif, --mp4 and --html) show all",
        )
    if path is None:
        require_display()
    pv = import_extra("pyvista", "pyvista", "this view")
    _check_x11()
    # Silences VTK's reports of each kind of window that it tries without success.
    with (
        _DRAWING,
        pv.vtk_verbosity("off"),
        _no_formulas(),
        closing(
            pv.Plotter(
                shape=(1, 2),
                border=False,
                off_screen=path is not None,
                window_size=list(size),
                lighting="none",
            )
        ) as plotter,
    ):
        plotter.set_background(picture.theme.background)
        plotter.enable_anti_aliasing("ssaa")
        stage = _Stage(plotter, picture, point_size)
        _check_opengl(plotter, path)
        if path is None:
            last = len(picture.frames) - 1
            if last:
                getattr(plotter, "widgets", plotter).add_slider_widget(
                    lambda value: stage.show(round(value) - 1),
                    (1, last + 1),
                    value=1,
                    title="frame",
                    fmt="%.0f",
                    color=picture.theme.text,
                    pointa=(0.05, 0.13),
                    pointb=(0.6, 0.13),
                    interaction_event="always",
                    style="modern",
                )
            plotter.show(title="lidarsim")
        elif suffix in STILLS:
            image = BytesIO()
            plotter.screenshot(image)
            with atomic_writer(path) as file:
                if STILLS[suffix] == "PNG":
                    file.write(image.getvalue())
                else:
                    _write_jpg(image, file)
        else:
            _write_film(path, stage.film(), picture.rate if len(picture.frames) > 1 else TURN / 6.0)


_DRAWING = threading.Lock()
"""Held while VTK draws, which is for one thread at a time: its settings are those of the process."""


@contextmanager
def _no_formulas() -> Iterator[None]:
    """Let VTK draw texts literally in the block: it takes dollar signs and bars for formulas."""
    import_extra("vtkmodules.vtkRenderingFreeType", "pyvista", "this view")  # its import creates the renderer
    texts = import_extra("vtkmodules.vtkRenderingCore", "pyvista", "this view").vtkTextRenderer.GetInstance()
    before = texts.GetDefaultBackend()
    texts.SetDefaultBackend(texts.FreeType)
    try:
        yield
    finally:
        texts.SetDefaultBackend(before)


@cache
def _font() -> tuple[str, frozenset[int]]:
    """Return the file and characters of a font for more alphabets than VTK's own, which only has Latin letters."""
    fonts = import_extra("matplotlib.ft2font", "pyvista", "this picture")
    folder = import_extra("matplotlib", "pyvista", "this picture").get_data_path()
    path = str(Path(folder, "fonts", "ttf", "DejaVuSans.ttf"))
    return path, frozenset(fonts.FT2Font(path).get_charmap())


NO_OPENGL = "no OpenGL to draw with: install libEGL (Debian, Ubuntu: apt install libegl1)"


def _check_x11() -> None:
    """Raise an error without libX11, which libEGL needs, too: VTK would crash when it makes a window on Linux."""
    if sys.platform == "linux":
        try:
            ctypes.CDLL("libX11.so.6")
        except OSError:
            raise LidarsimError(NO_OPENGL) from None


def _check_opengl(plotter: pyvista.Plotter, path: PathLike | None) -> None:
    window: Any = plotter.render_window
    window.Initialize()
    if path is not None and not window.GetInitialized():  # VTK would crash when drawing
        raise LidarsimError(NO_OPENGL)


class _Stage:
    """Contents of a plotter: all frames, one of them visible, in coordinates relative to the middle of the view.

    Graphics cards use float32, which is too coarse for map coordinates.
    """

    def __init__(self, plotter: pyvista.Plotter, picture: Picture, point_size: float | None) -> None:
        self.pv = import_extra("pyvista", "pyvista", "this view")
        self.plotter, self.picture = plotter, picture
        self.added = 0
        width, height = plotter.window_size
        self.font = max(11, round(height / 50))
        self.seen = picture.points_to_show()
        self.middle = self.seen.mean(axis=0)
        self.reach = float(np.linalg.norm(self.seen - self.middle, axis=1).max())
        legend = _Legend(picture, self.font, height)
        left, bottom, box_width, box_height, hides = legend.place(picture, self.seen, (width, height))
        self.stage = (left - self.font) / width if hides else 1.0
        self.aspect = self.stage * width / height
        plotter.renderers[0].viewport = (0.0, 0.0, 1.0, 1.0)
        plotter.renderers[1].viewport = (
            left / width, bottom / height, (left + box_width) / width, (bottom + box_height) / height
        )  # fmt: skip
        plotter.subplot(0, 0)
        plotter.add_light(self.pv.Light(position=tuple(TO_SUN), light_type="scene light", intensity=SUN))
        plotter.add_light(self.pv.Light(light_type="headlight", intensity=HEADLIGHT))
        self.spacing = self._grid()
        self._surfaces(picture.surfaces)
        if len(picture.path):
            plotter.add_lines(picture.path - self.middle, color=PATH, width=2, connected=True)
        most = max(len(frame.cloud) for frame in picture.frames)
        size = point_size or float(np.clip(5 * (100_000 / max(most, 1)) ** 0.25, 2.5, 10))
        self.actors = [self._frame(frame, size) for frame in picture.frames]
        self.texts = [self._text((0.012, y), size) for y, size in ((0.03, self.font), (0.96, 1.2 * self.font))]
        self.texts.append(self._text((0.5, 0.5), 1.2 * self.font, centred=True))
        plotter.subplot(0, 1)
        self._draw(legend, (box_width, box_height))
        plotter.subplot(0, 0)
        self.show(0)

    def show(self, index: int, turn: float = 0.0) -> None:
        """Show one frame from its camera, and hide the others."""
        for number, actors in enumerate(self.actors):
            for actor in actors:
                actor.SetVisibility(number == index)
        frame = self.picture.frames[index]
        _set_text(self.texts[0], self._caption(frame))
        _set_text(self.texts[1], frame.title)
        _set_text(self.texts[2], "no points" if self.picture.of_points and not len(frame.cloud) else "")
        follows = isinstance(self.picture.camera, str) and self.picture.camera == "first-person"
        if index and not follows and not self.plotter.off_screen:
            return  # keep the user's view
        view = self.picture.view(index, self.seen, self.aspect, turn=turn)
        camera = self.plotter.renderers[0].camera
        camera.position, camera.focal_point, camera.up = view.eye - self.middle, view.target - self.middle, view.up
        camera.view_angle = np.degrees(view.angle)
        camera.SetWindowCenter(1.0 - self.stage, 0.0)  # puts the middle of the view in the middle of the stage
        if view.half:
            camera.parallel_projection, camera.parallel_scale = True, view.half
        renderer = self.plotter.renderers[0]
        # VTK's near clipping distance is a fraction of the far one: a far point must not hide all near ones.
        farthest = float(
            np.linalg.norm(self.picture.frames[index].cloud.xyz - view.eye, axis=1).max(initial=self.reach)
        )
        renderer.SetNearClippingPlaneTolerance(0.002 * self.reach / farthest)
        renderer.ResetCameraClippingRange()

    def film(self) -> Iterator[npt.NDArray[np.uint8]]:
        """Yield the images of a film: all frames, or a single one from all sides."""
        frames = len(self.picture.frames)
        self.plotter.show(auto_close=False, interactive=False)
        for number in range(frames if frames > 1 else TURN):
            self.show(number if frames > 1 else 0, 2 * np.pi * number / max(frames, TURN))
            self.plotter.render()
            yield np.asarray(self.plotter.screenshot(return_img=True))

    def _frame(self, frame: Frame, size: float) -> list[pyvista.Actor]:
        cloud, actors = frame.cloud, self._surfaces(frame.movers)
        if len(cloud):  # PyVista refuses to draw nothing
            points = self.pv.PolyData(cloud.xyz - self.middle)
            points.point_data["rgb"] = self.picture.rgb(cloud)
            dots: dict[str, Any] = {"point_size": size, "render_points_as_spheres": True, "lighting": False}
            actors.append(self.plotter.add_mesh(points, scalars="rgb", rgb=True, copy_mesh=False, **dots))
        if frame.boxes:
            actors += self._boxes(frame.boxes)
        position = frame.pose[:3, 3] - self.middle
        inside = isinstance(self.picture.camera, str) and self.picture.camera == "first-person"
        shown = not inside and self.picture.of_points
        if shown and np.linalg.norm(position) < 1000 * self.reach:  # far axes would be a dot and spoil the depth buffer
            for axis, color in enumerate(AXES):
                arrow = self.pv.Arrow(start=position, direction=frame.pose[:3, axis], scale=AXIS * self.reach)
                actors.append(self.plotter.add_mesh(arrow, color=color, lighting=False))
        return actors

    def _boxes(self, boxes: Boxes) -> list[pyvista.Actor]:
        """Add boxes, and the names of their classes where these have room."""
        ends = lines(boxes).reshape(-1, 3) - self.middle
        wires = self.pv.line_segments_from_points(ends)
        colors = [self.picture.class_color(label) for label in boxes.label.tolist()]
        wires.cell_data["rgb"] = np.repeat(_channels(colors), LINES, axis=0)
        width = max(2, round(self.plotter.window_size[1] / 300))
        actors = [self.plotter.add_mesh(wires, scalars="rgb", rgb=True, lighting=False, line_width=width)]
        names = [self._choose_text(self.picture.class_name(label), str(label)) for label in boxes.label.tolist()]
        tops = boxes.center * [1, 1, 0] + boxes.corners.max(axis=1) * [0, 0, 1]
        self.added += 1
        actors.append(
            self.plotter.add_point_labels(
                tops - self.middle,
                names,
                name=f"names {self.added}",
                font_size=self.font,
                text_color=self.picture.theme.text,
                font_file=None if all(map(str.isascii, names)) else _font()[0],
                shape=None,
                show_points=False,
                always_visible=True,
            )
        )
        return actors

    def _surfaces(self, surfaces: Sequence[Surface]) -> list[pyvista.Actor]:
        """Add translucent surfaces: large shared meshes as instances, all others merged."""
        colors, actors = self.picture.colors, []
        by_height = colors.field == "height"
        look: dict[str, Any] = {"opacity": 0.15 if self.picture.has_points else 1.0, **SHADING}
        properties: dict[str, pyvista.Property] = {}
        groups: dict[int, list[Surface]] = {}
        for surface in surfaces:
            if len(surface.faces):
                groups.setdefault(id(surface.vertices), []).append(surface)
        others: list[Surface] = []
        for group in groups.values():
            vertices, faces = group[0].vertices, group[0].faces
            whole = all(len(split_by_color(surface, self.picture)) == 1 for surface in group)
            if len(group) == 1 or len(faces) < INSTANCED or not whole or by_height:
                others += group
                continue
            centre = vertices.mean(axis=0)
            mapper = self.pv.DataSetMapper(self.pv.PolyData.from_regular_faces(vertices - centre, faces))
            for surface in group:
                ((color, _),) = split_by_color(surface, self.picture)
                if color not in properties:
                    properties[color] = self.pv.Property(color=color, interpolation="flat", **look)
                actor = self.pv.Actor(mapper=mapper, prop=properties[color])
                matrix = surface.matrix.copy()
                matrix[:3, 3] += matrix[:3, :3] @ centre - self.middle
                actor.user_matrix = matrix
                self.plotter.renderers[0].AddActor(actor)
                actors.append(actor)
        if others and by_height:
            mesh = self.pv.PolyData.from_regular_faces(*merge_surfaces(others, self.middle))
            mesh.point_data["height"] = mesh.points[:, 2] + self.middle[2]
            # Interpolates heights instead of colours within large triangles.
            scale = {"cmap": colors.table, "clim": colors.limits, "interpolate_before_map": True}
            look |= {"scalars": "height", "show_scalar_bar": False, "smooth_shading": False, **scale}
            actors.append(self.plotter.add_mesh(mesh, **look))
        elif others:
            parts = [part for surface in others for part in split_by_color(surface, self.picture)]
            mesh = self.pv.PolyData.from_regular_faces(*merge_surfaces([surface for _, surface in parts], self.middle))
            table = _channels([color for color, _ in parts])
            mesh.cell_data["rgb"] = np.repeat(table, [len(surface.faces) for _, surface in parts], axis=0)
            actors.append(self.plotter.add_mesh(mesh, scalars="rgb", rgb=True, smooth_shading=False, **look))
        return actors

    def _grid(self) -> float:
        """Add a grid on the ground, and return its spacing, m."""
        spacing, height, xs, ys = grid(self.seen)
        ends = [((x, ys[0], height), (x, ys[-1], height)) for x in xs] + [
            ((xs[0], y, height), (xs[-1], y, height)) for y in ys
        ]
        lines_of_grid = np.reshape(ends, (-1, 3)) - self.middle
        self.plotter.add_lines(lines_of_grid, color=self.picture.theme.grid, width=1)
        return spacing

    def _caption(self, frame: Frame) -> str:
        """Return what there is to see, and the spacing of the grid."""
        objects = len(self.picture.surfaces + frame.movers)
        points, boxes = len(frame.cloud), 0 if frame.boxes is None else len(frame.boxes)
        parts = [quantity(points, "point") if self.picture.of_points else quantity(objects, "object")]
        if boxes:
            parts.append(f"{boxes:,} box{'es' * (boxes != 1)}")
        return ", ".join([*parts, f"grid {self.spacing:,g} m"])

    def _text(self, position: tuple[float, float], size: float, *, centred: bool = False) -> pyvista.Text:
        """Add an empty text at a position in the stage or the legend, in units of its width and height."""
        text = self.plotter.add_text("", position=position, viewport=True, color=self.picture.theme.text, shadow=False)
        looks = text.GetTextProperty()
        looks.SetBackgroundColor(self.pv.Color(self.picture.theme.background).float_rgb)
        looks.SetBackgroundOpacity(0.7)
        looks.SetFontSize(round(size))
        looks.SetVerticalJustificationToCentered()
        if centred:
            looks.SetJustificationToCentered()
        return text

    def _choose_text(self, name: str, other: str) -> str:
        """Return a name, or `other` if the font lacks one of its characters."""
        return plain(name if name.isascii() or _font()[1].issuperset(map(ord, name)) else other, most=LONGEST)

    def _draw(self, legend: _Legend, size: tuple[int, int]) -> None:
        """Draw the legend; its coordinates are pixels from its upper left corner."""
        renderer = self.plotter.renderers[1]
        renderer.SetInteractive(False)
        width, height = size

        def write(text: str, x: float, y: float) -> None:
            _set_text(self._text((x / width, 1.0 - y / height), self.font), text)

        def fill(x: tuple[float, float], y: tuple[float, float], rgb: npt.NDArray[np.uint8]) -> None:
            plane = self.pv.Plane(
                center=(sum(x) / 2, height - sum(y) / 2, 0),
                i_size=x[1] - x[0],
                j_size=y[1] - y[0],
                i_resolution=1,
                j_resolution=len(rgb),
            )
            plane.cell_data["rgb"] = rgb
            self.plotter.add_mesh(plane, scalars="rgb", rgb=True, lighting=False)

        font, line = self.font, legend.line
        y = line
        for row in legend.rows:
            if row.color:
                fill((font, 2 * font), (y - 0.35 * line, y + 0.35 * line), _channels([row.color]))
            write(self._choose_text(row.text, row.other), (2.6 if row.color else 1.0) * font, y)
            y += line
            if row.bar is not None:
                colors, high = row.bar, y + legend.bar - line
                fill((font, 2.4 * font), (y, high), _channels(colors.table))
                for value, text in colors.ticks().items():
                    place = high - (high - y) * float(colors.places(value))
                    fill((2.4 * font, 2.8 * font), (place - 0.5, place + 0.5), _channels([self.picture.theme.text]))
                    write(text, 3.2 * font, place)
                y = high + line
        camera = renderer.camera
        camera.parallel_projection, camera.parallel_scale = True, height / 2
        middle = width / 2, height / 2
        camera.focal_point, camera.position, camera.up = (*middle, 0.0), (*middle, 1.0), (0.0, 1.0, 0.0)
        renderer.ResetCameraClippingRange()


@dataclass(frozen=True)
class _Row:
    """A line of the legend; `other` is written if the font lacks a character of `text`, and a scale may follow."""

    text: str
    other: str = ""
    color: str = ""
    bar: Coloring | None = None


class _Legend:
    """The rows of a legend and its size, pixels."""

    def __init__(self, picture: Picture, font: int, height: int) -> None:
        colors, classes = picture.colors, picture.classes
        self.line, self.font = 1.7 * font, font
        rows = [_Row(colors.title, bar=colors if colors.scaled else None)]
        rows += self._categories(colors, height)
        rows += [_Row(note) for note in colors.notes if colors.scaled or note != colors.clipped]
        labels = {label for frame in picture.frames if frame.boxes for label in frame.boxes.label.tolist()}
        named = {label: name for label, name in classes.names.items() if label in labels}
        if colors.field != "label" and named:
            own = replace(classes, names=named, table=[classes.color(label) for label in named])
            rows += [_Row(""), _Row("boxes"), *self._categories(own, height - 6 * self.line)]
        self.rows = rows
        self.bar = max(4 * self.line, min(12 * self.line, height - (len(rows) + 4) * self.line))
        self.height = round((len(rows) + 0.8) * self.line + (self.bar if colors.scaled else 0))
        texts = [row.text for row in rows]
        texts += [f"  {text}" for text in colors.ticks().values()] if colors.scaled else []
        self.width = round(font * (3.4 + 0.56 * max(len(plain(text, most=LONGEST)) for text in texts)))

    def _categories(self, colors: Coloring, height: float) -> list[_Row]:
        room = int(0.8 * height / self.line)
        shown = [
            _Row(name, str(category), color)
            for (category, name), color in zip(colors.names.items(), colors.table, strict=False)
        ]
        left = len(shown) - room
        return shown if left <= 1 else [*shown[:room], _Row(f"and {left} more")]

    def place(self, picture: Picture, seen: Floats, size: tuple[int, int]) -> tuple[int, int, int, int, bool]:
        """Return left, bottom, width and height, and whether something is behind.

        The legend is in the upper right corner, or in the left one if only that one is free. On an orbit none is.
        """
        width, height = size
        margin = self.font
        box = min(self.width, width // 4 - margin), min(self.height, height - 2 * margin)
        right, left = ((x, height - box[1] - gap * margin) for x, gap in ((width - box[0] - margin, 1), (margin, 3)))
        view = picture.view(0, seen, width / height)
        boxes = picture.frames[0].boxes
        middles = np.empty((0, 3)) if boxes is None else boxes.center
        drawn, boxed = ((view.places(of, width / height) + 1.0) / 2 * size for of in (picture.sample_points(), middles))
        circles = isinstance(picture.camera, str) and picture.camera == "orbit"
        for corner in () if circles else (right, left):
            hidden, covered = (
                ((places > corner) & (places < np.add(corner, box))).all(axis=1) for places in (drawn, boxed)
            )
            if hidden.mean() <= ROOM and not covered.any():
                return *corner, *box, False
        return *right, *box, True


def _set_text(actor: pyvista.Text, text: str) -> None:
    """Set a text, in a font that has its characters."""
    actor.SetInput(text)
    if not text.isascii():
        actor.GetTextProperty().SetFontFamily(FONT_FILE)
        actor.GetTextProperty().SetFontFile(_font()[0])


def _write_jpg(image: BytesIO, file: BinaryIO) -> None:
    from PIL import Image

    with Image.open(image) as picture:
        picture.convert("RGB").save(file, "JPEG", quality=QUALITY, subsampling=0)


def _write_film(path: PathLike, images: Iterator[npt.NDArray[np.uint8]], rate: float) -> None:
    if Path(path).suffix.lower() == ".gif":
        from PIL import Image

        def palette(image: npt.NDArray[np.uint8]) -> Image.Image:
            # The default, median cut, merges the colours of classes with few points.
            return Image.fromarray(image).quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)

        first, *others = map(palette, images)
        with atomic_writer(path) as file:
            first.save(
                file, "GIF", save_all=True, append_images=others, duration=round(1000 / rate), loop=0, optimize=True
            )
        return
    films = import_extra("imageio_ffmpeg", "video", "an MP4 file")
    with TemporaryDirectory() as folder:
        name = Path(folder) / "film.mp4"
        begin = next(images)
        writer = films.write_frames(str(name), begin.shape[1::-1], fps=rate, macro_block_size=2, quality=8)
        writer.send(None)
        for image in chain([begin], images):
            writer.send(np.ascontiguousarray(image))
        writer.close()
        with atomic_writer(path) as file:
            file.write(name.read_bytes())


register_view(PointCloud, "pyvista", to_pyvista)
register_view(PointCloud, "from_pyvista", from_pyvista)
register_view(Scene, "pyvista", scene_to_pyvista)
