"""The function that shows clouds, scans and scenes in any of the viewers."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any, TypeAlias, TypeVar, get_args

import numpy as np

from lidarsim._base import validation
from lidarsim._base.files import PathLike, Place, check_folder, check_suffix
from lidarsim._base.shown import plain, quantity
from lidarsim._base.validation import (
    Floats,
    Transform,
    dimensions,
    flag,
    integer,
    items,
    named_labels,
    one_of,
    real,
    short_repr,
)
from lidarsim._base.views import Background, Camera, ColorMap, Plotted, Viewer, register_view
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.motion.trajectory import Trajectory
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.pointcloud import PointCloud, with_common_fields
from lidarsim.scan.scan import Scan
from lidarsim.viewers import html, open3d, pyvista
from lidarsim.viewers._boxes import transform_boxes
from lidarsim.viewers._colors import (
    THEMES,
    Known,
    Style,
    check_limits,
    class_coloring,
    coloring,
    instance_coloring,
)
from lidarsim.viewers._display import in_notebook
from lidarsim.viewers._picture import Frame, Picture, check_camera
from lidarsim.viewers._surfaces import Surface, surfaces
from lidarsim.world.scene import Scene

Item = TypeVar("Item")

Shown: TypeAlias = PointCloud | Scan | Mapping[str, Scan] | Mapping[str, PointCloud]
"""A frame: a cloud, a scan, or the scans or clouds of a rig by sensor name."""

KINDS = "point clouds, scans or a scene"
"""What can be shown, as errors name it."""

MOST_COLORS = 40
"""Most instances without labels that have a colour each."""

SUFFIXES = (".png", ".jpg", ".gif", ".mp4", ".html")


def show(
    what: Shown | Scene | Iterable[Shown],
    *,
    scene: Scene | None = None,
    boxes: Boxes | Sequence[Boxes | None] | None = None,
    color_by: str | None = None,
    class_names: Mapping[int, str] | None = None,
    pose: Transform | Sequence[Transform] | None = None,
    time: float | Sequence[float] | None = None,
    save: PathLike | None = None,
    camera: Camera | Sequence[Sequence[float]] = "behind",
    size: tuple[int, int] = (1600, 1000),
    point_size: float | None = None,
    viewer: Viewer = "pyvista",
    title: str | Sequence[str] | None = None,
    limits: tuple[float, float] | None = None,
    color_map: ColorMap | None = None,
    background: Background = "dark",
    accumulate: bool = False,
) -> html.Page | None:
    """Show a point cloud, a scan, a scene or a sequence of frames in a window or a notebook, or write it to a file.

    Parameters
    ----------
    what : PointCloud, Scan, Scene, mapping of str to Scan or PointCloud, or an iterable of these except scenes
        What to show. Scans are shown in world coordinates; a mapping by sensor name, as from `Rig.frames`, is one
        frame, whose clouds are in the same coordinates. With several frames, a window has a slider to choose one, and
        GIF, MP4 and HTML play all of them.
    scene : Scene, optional
        Surfaces to show with the points, which must be in world coordinates. They are translucent, and coloured by
        object, instance or height if the points are, else by label; labels without a name are grey then. If no object
        has a label, each instance has a colour. Moving objects are shown at their poses at the start of each frame.
    boxes : Boxes or sequence of Boxes, optional
        Boxes to show with the points of the frame, or one per frame (None: without), as from `Scan.boxes`: in world
        coordinates with scans (``scan.boxes(frame="world")``), and in those of the points with clouds. They are
        coloured by label, have the names of their classes, and an arrow head on the roof points where they head.
    color_by : str, optional
        Scalar field to colour the points by, ``"height"``, or ``"sensor"`` of mappings. Default: the intensity if there
        is one; for a scene alone the label, or the instance if no object has a label. Points whose value is not finite
        are grey, with a note in the legend. Heights of points with normals are shaded as by a sun in the north-west,
        down to half the brightness.
    class_names : mapping of int to str, optional
        Class names by label, for the legend. Default: those of the scene, the boxes and the clouds; then the names of
        the objects with the label. Classes with the names of SemanticKITTI, nuScenes and LAS have the colours of these
        sets, where those show on the background.
    pose : RigidTransform, array_like of shape (4, 4), or a sequence of these, optional
        Pose of the sensor for the cloud, or one per cloud, in world coordinates. It is shown as axes (x red, y green, z
        blue). A cloud in the sensor frame, as from `Scan.point_cloud`, is transformed by it. Default: the identity, or
        the pose of the scan.
    time : float or sequence of float, optional
        Time of the cloud, or one per cloud, s. Default: the start of the scan; 0 for a single cloud. For several clouds
        there is no default: without times, moving objects are not shown.
    save : path-like, optional
        File to write instead of opening a window: PNG or JPG (a single frame), GIF or MP4 (all frames, or once around a
        single one), or HTML (a self-contained page of all frames). None of these needs a display.
    camera : {"behind", "birds-eye", "first-person", "orbit", "top"} or array_like of shape (3, 3)
        View from behind and above the sensor, from straight above, from the sensor looking ahead, circling the scene
        from above, or a plan without perspective; or position, target and up vector. "behind" and "first-person" move
        with the sensor. The farthest twentieth of the points may be outside, except on an orbit.
    size : tuple of int
        Width and height, pixels.
    point_size : float, optional
        Diameter of a point, pixels. Default: smaller for more points.
    viewer : {"pyvista", "open3d"}
        The library that opens the window.
    title : str or sequence of str, optional
        Title of the picture, or one per frame. Default: the number and the time of the frame, if there are several; of
        all of them with `accumulate`.
    limits : tuple of float, optional
        Values at the ends of the colours. Default: those of the data, without a few outliers.
    color_map : {"magma", "viridis", "cividis", "grey"}, optional
        Colours of numbers. Default: magma, and blue to red for errors and velocities.
    background : {"dark", "white"}
        Colour of the background.
    accumulate : bool
        Show all frames as one in world coordinates, as a map: the points of all of them with the path of the sensor,
        and moving objects, boxes and the sensor as in the last frame.

    Returns
    -------
    Page or None
        The HTML page for the notebook to display, if `show` runs in a Jupyter notebook without `save`.

    Raises
    ------
    FileFormatError
        If the suffix of `save` is not one of these.
    LidarsimError
        If there is no display for a window, or no OpenGL for a picture.
    MissingExtraError
        If the drawing library is not installed.
    OSError
        If the file cannot be written.
    TypeError, ValueError
        If there is nothing to show, a cloud has no scalar field `color_by`, a PNG is requested for several frames,
        points in the sensor frame are to be shown in the world without a `pose`, or an argument is not one of the
        values above.
    """
    one_of("viewer", viewer, get_args(Viewer))
    if save is not None:
        check_save(save)
        place = Place(save)
    width, height = check_size(size)
    style = _style(limits, color_map, background)
    view = check_camera(camera)
    if not isinstance(scene, Scene | None):
        raise ArgumentTypeError("scene", "a Scene", short_repr(scene))
    if point_size is not None:
        point_size = real("point_size", point_size, above=0.0)
    accumulate = flag("accumulate", accumulate)
    sensors: dict[str, int] = {}
    if isinstance(what, Scene):
        (shown_boxes,) = _boxes(boxes, 1)
        starts = _starts(time, [_nothing()])
        frames = _titles(title, [replace(_frame(_nothing(), np.eye(4)), boxes=shown_boxes)], None, ())
        rate, scene = 10.0, what
    else:
        given = _list_frames(what)
        poses = _poses(pose, len(given))
        _check_places(given, poses, scene, accumulate=accumulate)
        several = _boxes(boxes, len(given))
        names = dict.fromkeys(name for shown in given if isinstance(shown, Mapping) for name in shown)
        sensors = {name: k for k, name in enumerate(names)}
        frames = [_make_frame(*frame, sensors) for frame in zip(given, poses, several, strict=True)]
        starts, rate = _starts(time, given), _rate(given[0])
        if accumulate and title is None:
            title = together_title(len(given), starts or ())
        frames = _titles(title, frames, starts, given)
    picture = _picture(
        frames, scene, color_by, class_names, sensors, camera=view, rate=rate, starts=starts, style=style
    )
    picture = replace(picture, of_points=what is not scene)
    if accumulate:
        picture = _accumulate(picture)
    looks: dict[str, Any] = {"size": (width, height), "point_size": point_size}
    if save is not None:
        write = html.write if place.path.suffix.lower() == ".html" else pyvista.draw
        with place.errors_as_given():
            write(picture, place.path, **looks)
        return None
    if in_notebook():
        return html.page(picture, **looks)
    draw = open3d.draw if viewer == "open3d" else partial(pyvista.draw, path=None)
    draw(picture, **looks)
    return None


def _list_frames(what: Shown | Iterable[Shown]) -> list[Shown]:
    """Return the frames, at least one."""
    if isinstance(what, PointCloud | Scan | Mapping):
        return [what]
    if not isinstance(what, Iterable):
        raise ArgumentTypeError("what", KINDS, short_repr(what))
    several = list(what)
    if not several:
        raise ArgumentValueError("what", "at least one frame", "none")
    return several


def _style(limits: tuple[float, float] | None, color_map: str | None, background: str) -> Style:
    one_of("background", background, get_args(Background))
    if color_map is not None:
        one_of("color_map", color_map, get_args(ColorMap))
    return Style(THEMES[background], color_map, check_limits(limits))


def frame_title(number: int | None, place: int, count: int | None, time: float | None) -> str:
    """Return the title of a frame: its number, its place among all, from 1 on, and the time from the first start, s."""
    name = f"frame {place} of {count}" if number is None else f"frame {number}"
    which = f" ({place} of {count})" if count and number is not None else ""
    return f"{name}{which}" + ("" if time is None else f", {time:.2f} s")


def together_title(count: int, times: Sequence[float]) -> str:
    """Return the title of several frames in one picture."""
    return quantity(count, "frame") + (f", 0.00 to {max(times) - min(times):.2f} s" if len(times) > 1 else "")


def _titles(
    title: str | Sequence[str] | None, frames: list[Frame], starts: Sequence[float] | None, given: Sequence[Shown]
) -> list[Frame]:
    """Return the frames with their titles."""
    count = len(frames)
    if title is None and count > 1:
        numbers = [scan.frame if isinstance(scan, Scan) else None for scan in map(_first, given)]
        times = [time - starts[0] for time in starts] if starts else [None] * count
        title = [
            frame_title(number, place, count, time)
            for place, (number, time) in enumerate(zip(numbers, times, strict=True), 1)
        ]
    titles = [title or ""] * count if title is None or isinstance(title, str) else items("title", title, "texts")
    for text in _one_each("title", titles, count):
        if not isinstance(text, str):
            raise ArgumentTypeError("title", "text", type(text).__name__)
    return [replace(frame, title=plain(text, most=80)) for frame, text in zip(frames, titles, strict=True)]


def _one_each(name: str, values: list[Item], count: int) -> list[Item]:
    """Return the values of an argument after checking that there is one for each frame."""
    if len(values) != count:
        raise ArgumentValueError(name, f"one for each of the {count} frames", len(values))
    return values


def _accumulate(picture: Picture) -> Picture:
    """Return a picture with the points of all frames in one, which is the last otherwise."""
    clouds = [frame.cloud for frame in picture.frames]
    full = with_common_fields([cloud for cloud in clouds if len(cloud)] or clouds)
    points = PointCloud({name: np.concatenate([getattr(cloud, name) for cloud in full]) for name in full[0].fields})
    return replace(picture, frames=[replace(picture.frames[-1], cloud=points)])


def check_save(path: PathLike) -> None:
    """Check, before any work, that `show` can write a file: that it knows the suffix and the folder exists.

    Raises
    ------
    FileFormatError
        If the suffix is unknown.
    OSError
        If the folder does not exist or is not writable.
    TypeError
        If it is no path.
    """
    if not isinstance(path, str | os.PathLike):
        raise ArgumentTypeError("save", "a path", short_repr(path))
    check_suffix(path, SUFFIXES)
    check_folder(path)


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return a width and a height in pixels after checking that they are integers from 16 to 16384.

    Raises
    ------
    TypeError, ValueError
        If they are not.
    """
    given = items("size", size, "pixels")
    if len(given) != 2:
        raise ArgumentValueError("size", "a width and a height", quantity(len(given), "number"))
    width, height = (integer(f"size[{i}]", pixels, at_least=16, at_most=16384) for i, pixels in enumerate(given))
    return width, height


def _nothing() -> PointCloud:
    """Return an empty cloud with the fields that can colour surfaces."""
    none = np.empty(0, np.uint32)
    return PointCloud(xyz=np.empty((0, 3)), label=none, object_id=none, instance=none)


def _frame(cloud: PointCloud, pose: Floats) -> Frame:
    return Frame(cloud[np.isfinite(cloud.xyz).all(axis=1)], pose)


def _check_places(
    given: Sequence[Shown], poses: Sequence[Floats | None], scene: Scene | None, *, accumulate: bool
) -> None:
    """Raise an error if points in a sensor frame would be shown together with others, in world coordinates."""
    lost = [
        isinstance(what, PointCloud) and what._in_sensor_frame and pose is None
        for what, pose in zip(given, poses, strict=True)
    ]
    others = "scene" if scene is not None else ""
    others = others or ("scans" if not all(isinstance(what, PointCloud) for what in given) else "")
    others = others or ("other frames" if accumulate and len(given) > 1 else "")
    if any(lost) and others:
        raise ArgumentValueError(
            f"what{f'[{lost.index(True)}]' if len(given) > 1 else ''}",
            f"points in world coordinates beside the {others}",
            "points in the sensor frame",
            "give pose=, or show the scan or its point_cloud('world')",
        )


def _boxes(boxes: Boxes | Sequence[Boxes | None] | None, count: int) -> Sequence[Boxes | None]:
    if boxes is None:
        return [None] * count
    several = [boxes] if isinstance(boxes, Boxes) else items("boxes", boxes, "Boxes")
    for i, given in enumerate(several):
        if not isinstance(given, Boxes | None):
            raise ArgumentTypeError(f"boxes[{i}]", "Boxes or None", type(given).__name__)
    return _one_each("boxes", several, count)


def _make_frame(what: Shown, pose: Floats | None, boxes: Boxes | None, sensors: Mapping[str, int]) -> Frame:
    in_sensor_frame = isinstance(what, PointCloud) and what._in_sensor_frame
    if boxes is not None and boxes.in_sensor_frame != in_sensor_frame:
        places = "boxes in the sensor frame, as the points", "boxes in world coordinates"
        expected, got = places if in_sensor_frame else places[::-1]
        hint = f"scan.boxes(frame={'sensor' if in_sensor_frame else 'world'!r})"
        raise ArgumentValueError("boxes", expected, got.removesuffix(", as the points"), hint)
    if isinstance(what, PointCloud):
        if pose is not None and what._in_sensor_frame:
            what, boxes = what.transformed(pose), None if boxes is None else transform_boxes(boxes, pose)
        return replace(_frame(what, np.eye(4) if pose is None else pose), boxes=boxes)
    several = what if isinstance(what, Mapping) else {"": what}
    for scan in several.values():
        if not isinstance(scan, Scan | PointCloud):
            raise ArgumentTypeError("what", KINDS, type(scan).__name__)
    if not several:
        return replace(_frame(_nothing(), np.eye(4)), boxes=boxes)
    clouds = [scan if isinstance(scan, PointCloud) else scan.point_cloud("world") for scan in several.values()]
    cloud = _merge(clouds, [sensors[name] for name in several]) if isinstance(what, Mapping) else clouds[0]
    here = np.eye(4) if pose is None else pose
    first = next(iter(several.values()))
    if isinstance(first, Scan):
        here = first.pose.at(first.time).as_matrix() if isinstance(first.pose, Trajectory) else first.pose
    return replace(_frame(cloud, here), boxes=boxes)


def _merge(clouds: Sequence[PointCloud], sensors: Sequence[int]) -> PointCloud:
    """Return the points of several sensors, with the fields that all have and the number of the sensor."""
    alike = with_common_fields(clouds)
    for cloud, number in zip(alike, sensors, strict=True):
        cloud.sensor = np.full(len(cloud), number, np.uint16)
    return PointCloud.concatenate(alike)


def _poses(pose: Transform | Sequence[Transform] | None, count: int) -> Sequence[Floats | None]:
    if pose is None:
        return [None] * count
    several: Any = pose
    if hasattr(pose, "as_matrix") or dimensions(several) == 2:
        return [validation.pose("pose", several)] * count
    poses = [validation.pose(f"pose[{i}]", where) for i, where in enumerate(items("pose", several, "poses"))]
    return _one_each("pose", poses, count)


def _rate(what: Shown) -> float:
    """Return the frame rate, Hz; 10 if unknown."""
    scans = list(what.values()) if isinstance(what, Mapping) else [what]
    return max((scan.lidar.pattern.rate for scan in scans if isinstance(scan, Scan)), default=10.0)


def _first(what: Shown) -> PointCloud | Scan | None:
    """Return what the first sensor measured."""
    several: Iterable[PointCloud | Scan] = what.values() if isinstance(what, Mapping) else [what]
    return next(iter(several), None)


def _starts(time: float | Sequence[float] | None, given: Sequence[Shown]) -> list[float] | None:
    """Return the start of each frame, s; None if unknown."""
    if time is None:
        known = [scan.time for scan in map(_first, given) if isinstance(scan, Scan)]
        return known if len(known) == len(given) else [0.0] if len(given) == 1 else None
    if dimensions(time) == 0:
        return [real("time", time)] * len(given)
    times = [real(f"time[{i}]", moment) for i, moment in enumerate(time)]  # type: ignore[arg-type]
    return _one_each("time", times, len(given))


def _picture(
    frames: list[Frame],
    scene: Scene | None,
    color_by: str | None,
    class_names: Mapping[int, str] | None,
    sensors: Mapping[str, int],
    *,
    camera: Camera | Floats,
    rate: float,
    starts: list[float] | None,
    style: Style,
) -> Picture:
    points = [frame.cloud.xyz for frame in frames]
    places = np.array([frame.pose[:3, 3] for frame in frames])
    empty = not any(map(len, points))
    everything = np.concatenate([*points, places])
    bounds = np.stack([everything.min(axis=0), everything.max(axis=0)])
    labels: dict[int, str] = {}
    used: set[int] = set()
    for frame in frames:
        labels |= frame.cloud.class_names
        if frame.boxes is not None:
            labels |= frame.boxes.class_names
            used |= set(frame.boxes.label.tolist())
    if scene is not None:
        labels |= scene.class_names
    class_names = labels if class_names is None else named_labels("class_names", class_names)
    instances = {} if scene is None else names_by_instance(scene, class_names)
    known = find_known(scene, class_names, used)
    known = replace(
        known,
        names={**known.names, "sensor": {number: name for name, number in sensors.items()}, "instance": instances},
    )
    if color_by is None and scene is not None and empty:
        color_by = "instance" if instances else "label"
    found: list[Surface] = []
    if scene is not None:
        found = surfaces(scene, bounds=None if empty else bounds, time=starts[0] if starts else 0.0)
    if color_by == "height" and empty and any(len(surface.vertices) for surface in found):
        heights = np.concatenate([surface.points()[:, 2] for surface in found])
        known = replace(known, heights=np.array([heights.min(), heights.max()]))
    if starts:
        movers = [surface for surface in found if surface.item.motion is not None]
        frames = [
            replace(frame, movers=[mover.at(start) for mover in movers])
            for frame, start in zip(frames, starts, strict=True)
        ]
    return Picture(
        frames,
        [surface for surface in found if surface.item.motion is None],
        places if np.ptp(places, axis=0).any() else np.empty((0, 3)),
        coloring([frame.cloud for frame in frames], color_by, known, style),
        camera,
        rate,
        class_coloring(known.others["label"], known, style.theme),
        instance_coloring(instances, style.theme),
        style.theme,
    )


def find_known(scene: Scene | None, class_names: Mapping[int, str], labels: Iterable[int] = ()) -> Known:
    """Return what a scene tells of categories, beside class names and other labels."""
    items = () if scene is None else tuple(scene)
    names = {"label": class_names, "object_id": {item.id: item.name for item in items}}
    others = {
        "label": {*labels, *(label for item in items for label in np.unique(item.label).tolist())},
        "object_id": {item.id for item in items},
        "instance": {item.instance for item in items},
    }
    return Known(names, others, {} if scene is None else objects_by_label(scene))


def names_by_instance(scene: Scene, names: Mapping[int, str]) -> dict[int, str]:
    """Return the names of the instances if all objects have label 0, without a name in `names`; else none."""
    labels = {label for item in scene for label in np.unique(item.label).tolist()}
    found: dict[int, str] = {}
    for item in scene:
        found.setdefault(item.instance, re.sub(r"/\d+$", "", item.name))  # of a geom, the name of its body
    return found if labels == {0} and 0 not in names and 1 < len(found) <= MOST_COLORS else {}


def objects_by_label(scene: Scene) -> dict[int, str]:
    """Return the names of the objects with each label, the first two and the number of the others."""
    found: dict[int, dict[str, None]] = {}
    for item in scene:
        if isinstance(item.label, int) and item.name:
            found.setdefault(item.label, {}).setdefault(item.name)
    return {
        label: ", ".join([*islice(names, 2), *[f"{len(names) - 2} more"] * (len(names) > 2)])
        for label, names in found.items()
    }


register_view(Plotted, "plot", show)
