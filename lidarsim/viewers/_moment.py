"""What a live viewer draws of a frame, and its colours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.scan.scan import moment_and_pose
from lidarsim.viewers._boxes import transform_boxes
from lidarsim.viewers._colors import (
    CATEGORIES,
    DARK,
    Coloring,
    Style,
    class_coloring,
    coloring,
    instance_coloring,
)
from lidarsim.viewers._show import find_known, names_by_instance
from lidarsim.viewers._surfaces import Surface, surfaces, transform

if TYPE_CHECKING:
    from lidarsim.scan.boxes import Boxes
    from lidarsim.scan.pointcloud import PointCloud
    from lidarsim.scan.scan import Scan
    from lidarsim.world.scene import Scene

UNNAMED = "lidar"
"""Name of a sensor without one."""
KILOMETRE = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class SensorView:
    """The points of a sensor in a frame.

    Attributes
    ----------
    cloud : PointCloud
        The finite points, deskewed to the start of the scan, in the sensor frame of that moment.
    rgb : ndarray of uint8, shape (n, 3)
        Their colours.
    pose : ndarray of float64, shape (4, 4)
        Pose of the sensor at that moment, sensor to world.
    """

    cloud: PointCloud
    rgb: npt.NDArray[np.uint8]
    pose: Floats

    def in_world(self) -> Floats:
        """Return the points in the world, m: ndarray of float64, shape (n, 3)."""
        return transform(self.pose, self.cloud.xyz)


@dataclass(frozen=True, slots=True, eq=False)
class Painted:
    """Surfaces of one colour.

    Attributes
    ----------
    name : str
        Name of the class or of the object.
    color : str
        Such as ``#ff0000``.
    surface : Surface
        The surface.
    """

    name: str
    color: str
    surface: Surface


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """A frame.

    Attributes
    ----------
    number : int
        Number of the frame, counting from 0.
    time : float
        Start of the frame, s.
    sensors : dict of str to SensorView
        The points by sensor name.
    boxes : Boxes or None
        Boxes of the instances that the sensors see, in the world.
    box_names, box_colors : list of str
        Class name and colour of each box.
    movers : list of Painted
        The moving objects where they are at the start of the frame, always the same ones.
    """

    number: int
    time: float
    sensors: dict[str, SensorView]
    boxes: Boxes | None
    box_names: list[str]
    box_colors: list[str]
    movers: list[Painted]


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """What stays the same in all frames.

    Attributes
    ----------
    static : list of Painted
        Surfaces of the objects that do not move.
    origin : ndarray of float64, shape (3,)
        Origin of the viewer's coordinates in the world, m: whole kilometres near the first pose of the sensor. Viewers
        use float32, whose steps are 0.06 mm at half a kilometre, but 0.5 m at the coordinates of maps.
    classes : dict of int to (str, str)
        Names and colours of the labels of the scene.
    eye, target : ndarray of float64, shape (3,)
        Viewpoint behind and above the first sensor, in the world, m.
    """

    static: list[Painted]
    origin: Floats
    classes: dict[int, tuple[str, str]]
    eye: Floats
    target: Floats


class Painter:
    """Prepare frames: points, boxes and surfaces with their colours.

    Parameters
    ----------
    scene : Scene, optional
        The scene, for its surfaces and the names of its labels.
    color_by : str, optional
        Field to colour the points by. Default: the label if the scene has labels, else the intensity.
    class_names : mapping of int to str, optional
        Class names by label. Default: those of the scene.
    boxes, surfaces : bool
        Whether frames have boxes, and whether there are surfaces.
    """

    def __init__(
        self,
        scene: Scene | None,
        *,
        color_by: str | None = None,
        class_names: Mapping[int, str] | None = None,
        boxes: bool = True,
        surfaces: bool = True,
    ) -> None:
        self._boxes = boxes
        own = {} if scene is None else scene.class_names
        self._known = find_known(scene, own if class_names is None else class_names)
        labels = set(self._known.others["label"])
        named = class_coloring(labels, self._known, DARK)
        self._classes = {label: (name, named.color(label)) for label, name in named.names.items()}
        self._color_by = "label" if color_by is None and labels - {0} else color_by
        alike = {}
        if scene is not None and self._color_by != "label":
            alike = names_by_instance(scene, self._known.names["label"])
        self._instances = instance_coloring(alike, DARK)
        self._style = Style(DARK)
        self._scene = scene if surfaces else None
        self._movers: list[Painted] = []

    def world(self, first: Moment) -> World:
        """Return what stays the same in all frames; later ones have the objects that move."""
        sensor = next(iter(first.sensors.values()))
        seen = np.concatenate([view.in_world() for view in first.sensors.values()])
        static: list[Painted] = []
        if self._scene is not None:
            everything = np.concatenate([seen, *(view.pose[None, :3, 3] for view in first.sensors.values())])
            bounds = np.stack([everything.min(axis=0), everything.max(axis=0)])
            found = surfaces(self._scene, bounds=bounds, time=first.time)
            painted = [part for surface in found if len(surface.faces) for part in self._paint(surface)]
            self._movers = [part for part in painted if part.surface.item.motion is not None]
            static = [part for part in painted if part.surface.item.motion is None]
        here = sensor.pose[:3, 3]
        far = float(np.median(np.linalg.norm(seen - here, axis=1))) if len(seen) else 10.0
        eye = here + far * (-2.0 * sensor.pose[:3, 0] + [0.0, 0.0, 1.2])
        return World(static, np.rint(here / KILOMETRE) * KILOMETRE, self._classes, eye, here)

    def moment(self, number: int, scans: Mapping[str, Scan]) -> Moment:
        """Return a frame of scans by sensor name, of which there is at least one."""
        clouds = {name or UNNAMED: scan.point_cloud(deskew="start") for name, scan in scans.items()}
        clouds = {name: cloud[np.isfinite(cloud.xyz).all(axis=1)] for name, cloud in clouds.items()}
        poses = [moment_and_pose(scan, deskew="start")[1] for scan in scans.values()]
        colors = self._coloring(list(clouds.values()))
        sensors = {
            name: SensorView(cloud, colors.rgb(cloud), pose)
            for (name, cloud), pose in zip(clouds.items(), poses, strict=True)
        }
        time = min(scan.time for scan in scans.values())
        movers = [replace(mover, surface=mover.surface.at(time)) for mover in self._movers]
        boxes = self._find_boxes(scans, poses) if self._boxes else None
        labels = [] if boxes is None else boxes.label.tolist()
        named = [self._classes.get(label, (str(label), DARK.surface)) for label in labels]
        return Moment(number, time, sensors, boxes, [name for name, _ in named], [color for _, color in named], movers)

    def _coloring(self, clouds: list[PointCloud]) -> Coloring:
        """Return the colours of a frame: those of categories do not depend on the frame, and limits stay."""
        found = coloring(clouds, self._color_by, self._known, self._style)
        if found.field not in CATEGORIES and self._style.limits is None and any(map(len, clouds)):
            self._style = replace(self._style, limits=found.limits)
            found = coloring(clouds, self._color_by, self._known, self._style)
        return found

    def _paint(self, surface: Surface) -> list[Painted]:
        label = surface.item.label
        own = f"{surface.object_id} {surface.item.name}".rstrip()
        if (instance := surface.item.instance) in self._instances.names:
            return [Painted(own, self._instances.color(instance), surface)]
        parts = list(surface.parts(surface.labels)) if isinstance(label, np.ndarray) else [(label, surface)]
        named = [(*self._classes.get(label, ("other", DARK.surface)), part) for label, part in parts]
        moves = surface.item.motion is not None
        return [Painted(own if moves else name, color, part) for name, color, part in named]

    def _find_boxes(self, scans: Mapping[str, Scan], poses: list[Floats]) -> Boxes:
        """Return the boxes of instances with points, each by the first sensor that sees it."""
        from lidarsim.scan.boxes import Boxes

        found: list[Boxes] = []
        known = np.empty(0, np.uint32)
        for scan, pose in zip(scans.values(), poses, strict=True):
            boxes = transform_boxes(scan.boxes(deskew="start", min_points=1), pose)
            boxes = boxes[~np.isin(boxes.instance, known)]
            known = np.concatenate([known, boxes.instance])
            found.append(boxes)
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(boxes, name) for boxes in found])
            for name in Boxes.__slots__
            if isinstance(getattr(found[0], name), np.ndarray)
        }
        return replace(found[0], **arrays)
