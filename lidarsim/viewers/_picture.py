"""Pictures, whichever library draws them: frames of points, surfaces, the sensor and the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import get_args

import numpy as np
import numpy.typing as npt

from lidarsim._base import validation
from lidarsim._base.validation import Floats
from lidarsim._base.views import Camera
from lidarsim.errors import ArgumentValueError
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.viewers._colors import DARK, Coloring, Theme, round_step
from lidarsim.viewers._surfaces import Surface, extent_of, merge_surfaces

CAMERAS: tuple[Camera, ...] = get_args(Camera)
AXIS = 0.06
"""Length of the sensor's axes relative to the radius of the view."""
MATTERS = 95.0
"""Percentage of the points that a picture shows at least; the others are far away."""
MARGIN = 1.04
"""Width of a picture relative to its contents."""
FLAT = 0.02
"""Greatest height of a flat surface, such as a road, relative to its width."""
TO_SUN = np.array([-0.5, 0.5, 0.6])
"""Direction to the light on surfaces: from the north-west, as relief is shown on maps, 40° high."""
SHADE = 0.5
"""Brightness of points in the shade."""
SAMPLES = 20_000
"""Number of points that stand for the surfaces of a scene."""

NO_CLASSES = Coloring("label", (0.0, 0.0), (0.0, 0.0), [], {})


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Points, the pose of the sensor and moving objects, in the same coordinates.

    Attributes
    ----------
    cloud : PointCloud
        The points.
    pose : ndarray of float64, shape (4, 4)
        Sensor to world.
    movers : list of Surface
        Surfaces of the moving objects at their poses in this frame; all frames have the same objects.
    boxes : Boxes or None
        Boxes of the instances in this frame.
    title : str
        What the frame is.
    """

    cloud: PointCloud
    pose: Floats
    movers: list[Surface] = field(default_factory=list)
    boxes: Boxes | None = None
    title: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Viewpoint of a picture.

    Attributes
    ----------
    eye, target, up : ndarray of float64, shape (3,)
        Positions, m, and the up vector.
    angle : float
        Vertical angle of view, rad.
    half : float or None
        Half the height of an orthographic picture, m; None for perspective.
    """

    eye: Floats
    target: Floats
    up: Floats
    angle: float
    half: float | None = None

    def places(self, points: Floats, aspect: float) -> Floats:
        """Return where points are in the picture, from -1 to 1 across and up; nan behind the eye: shape (n, 2)."""
        back = (self.eye - self.target) / np.linalg.norm(self.eye - self.target)
        right = np.cross(self.up, back)
        right /= np.linalg.norm(right)
        x, y, z = ((points - self.eye) @ axis for axis in (right, np.cross(back, right), back))
        depth = np.full(len(points), self.half) if self.half else np.where(z < 0, -z, np.nan) * math.tan(self.angle / 2)
        places: Floats = np.stack([x / depth / aspect, y / depth], axis=-1)
        return places


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """Contents of a picture.

    Attributes
    ----------
    frames : list of Frame
        At least one frame; all points are finite.
    surfaces : list of Surface
        Surfaces of the static objects, in the coordinates of the points.
    path : ndarray of float64, shape (m, 3)
        Positions of the sensor, m; empty if it does not move.
    colors : Coloring
        Colours of the points of all frames.
    camera : str or ndarray of shape (3, 3)
        One of `CAMERAS`, or position, target and up vector.
    rate : float
        Frame rate, Hz.
    classes : Coloring
        Colours of boxes and surfaces by their labels.
    instances : Coloring
        Colours of surfaces by their instances, if no object has a label.
    theme : Theme
        Colours of what is not data.
    of_points : bool
        Whether this is a picture of points, although there may be none; else of a scene alone.
    """

    frames: list[Frame]
    surfaces: list[Surface]
    path: Floats
    colors: Coloring
    camera: Camera | Floats
    rate: float
    classes: Coloring = NO_CLASSES
    instances: Coloring = NO_CLASSES
    theme: Theme = DARK
    of_points: bool = True

    @property
    def has_points(self) -> bool:
        """Whether any frame has points."""
        return any(len(frame.cloud) for frame in self.frames)

    @property
    def every_surface(self) -> list[Surface]:
        """Surfaces of the static objects, and of the moving ones in each frame."""
        return self.surfaces + [surface for frame in self.frames for surface in frame.movers]

    def class_color(self, label: int) -> str:
        """Return the colour of boxes and surfaces with a label."""
        classes = self.colors if self.colors.field == "label" else self.classes
        return classes.color(label) if label in classes.names else self.theme.surface

    def class_name(self, label: int) -> str:
        """Return the name of boxes and surfaces with a label, or its number."""
        return self.classes.names.get(label, str(label))

    def rgb(self, cloud: PointCloud) -> npt.NDArray[np.uint8]:
        """Return the colours of points, shape (n, 3); with normals, heights are shaded to show relief."""
        rgb = self.colors.rgb(cloud)
        if self.colors.field != "height" or "normal" not in cloud.fields:
            return rgb
        light = (cloud.normal @ TO_SUN / TO_SUN[2]).clip(0.0, 1.0)  # level ground has its whole colour
        shaded: npt.NDArray[np.uint8] = np.rint(rgb * (SHADE + (1.0 - SHADE) * light[:, None])).astype(np.uint8)
        return shaded

    def sample_points(self) -> Floats:
        """Return points that are spread evenly over what a picture shows, shape (n, 3)."""
        surfaces = [surface for surface in self.every_surface if len(surface.faces)]
        if self.has_points or not surfaces:
            return self.points_to_show()
        sides = (np.diff(surface.points()[surface.faces], axis=1) for surface in surfaces)
        ends = np.cumsum(np.concatenate([np.linalg.norm(np.cross(own[:, 0], own[:, 1]), axis=1) for own in sides]))
        points, faces = merge_surfaces(surfaces, np.zeros(3))
        rng = np.random.default_rng(0)
        chosen = np.searchsorted(ends, rng.uniform(0.0, ends[-1], SAMPLES)).clip(max=len(faces) - 1)
        spread: Floats = (rng.dirichlet((1, 1, 1), SAMPLES)[:, :, None] * points[faces[chosen]]).sum(axis=1)
        return spread

    def points_to_show(self) -> Floats:
        """Return the points that a picture must show: all but the farthest ones, and but stray ones on an orbit.

        A picture without points shows what stands on the ground, and only an orbit shows all surfaces, whose middles it
        would circle otherwise.
        """
        orbits = isinstance(self.camera, str) and self.camera == "orbit"
        if not self.has_points:
            surfaces = [surface for surface in self.every_surface if len(surface.vertices)]
            bounded = [surface for surface in surfaces if surface.item.shape.bounded]
            standing = [surface for surface in bounded if not surface.is_flat(FLAT)]
            if surfaces:
                chosen = surfaces if orbits else standing or bounded or surfaces
                return np.concatenate([surface.points() for surface in chosen])
        points = [frame.cloud.xyz for frame in self.frames]
        every = np.concatenate([*points, self.path, *(frame.pose[None, :3, 3] for frame in self.frames)])
        every = every[:: max(1, len(every) // 200_000)]
        middle = np.median(every, axis=0)
        away = np.linalg.norm(every - middle, axis=1)
        half, most = np.percentile(away, (50, 99.8 if orbits else MATTERS))
        far = max(most, 2.5 * half)
        kept: Floats = every[away <= far]
        if not np.ptp(kept, axis=0).any():
            return np.concatenate([middle - 2.0 * np.eye(3), middle + 2.0 * np.eye(3)])
        corners = [frame.boxes.corners.reshape(-1, 3) for frame in self.frames if frame.boxes]
        kept = np.concatenate([kept, *(part[np.linalg.norm(part - middle, axis=1) <= far] for part in corners)])
        axis = AXIS * np.linalg.norm(kept - kept.mean(axis=0), axis=1).max()
        if orbits:
            kept = np.concatenate([kept, *(surface.points() for surface in self.every_surface)])
        near = [frame.pose for frame in self.frames if np.linalg.norm(frame.pose[:3, 3] - middle) <= far]
        return np.concatenate([kept, *(pose[:3, 3] + axis * pose[:3, :3].T for pose in near)])

    def view(
        self, frame: int, seen: Floats, aspect: float, *, turn: float = 0.0, angle: float = math.radians(30.0)
    ) -> View:
        """Return the viewpoint for a frame.

        Parameters
        ----------
        frame : int
            Number of the frame.
        seen : ndarray of float64, shape (n, 3)
            Points that must be visible.
        aspect : float
            Width of the picture divided by its height.
        turn : float
            Angle travelled on the orbit, rad.
        angle : float
            Vertical angle of view, rad; ignored by "first-person".

        Returns
        -------
        View
            The viewpoint in the coordinates of the points.
        """
        if not isinstance(self.camera, str):
            eye, target, up = self.camera
            return View(eye, target, up, angle)
        pose = self.frames[frame].pose
        forward, left, vertical = pose[:3, 0], pose[:3, 1], np.array([0.0, 0.0, 1.0])
        if self.camera == "first-person":
            wide = 2.0 * math.atan(1.0 / max(aspect, 1.0))  # 90 degrees horizontally
            return View(pose[:3, 3], pose[:3, 3] + forward, pose[:3, 2], wide)
        if self.camera in {"birds-eye", "top"}:
            ahead = forward if abs(forward[2]) < 0.9 else pose[:3, 2]
            if self.camera == "top":
                return _from_top(seen, vertical, ahead, angle, aspect)
            return _fit_view(seen, vertical, ahead, angle, aspect)
        if self.camera == "orbit":
            towards = np.array([math.cos(turn - 2.2), math.sin(turn - 2.2), 0.65])
            return _fit_view(seen, towards, vertical, angle, aspect)
        moved = self.frames[frame].pose[:3, 3] - self.frames[0].pose[:3, 3]
        first = _fit_view(seen, -2.0 * forward + 0.5 * left + 1.3 * vertical, vertical, angle, aspect)
        return first if len(self.frames) == 1 else View(first.eye + moved, first.target + moved, vertical, angle)


def _fit_view(seen: Floats, towards: Floats, up: Floats, angle: float, aspect: float) -> View:
    """Return the nearest view from the direction `towards` that shows all points.

    A point (x, y, z), with z towards the eye, is visible from an eye at (a, b, c) if |x − a| <= (c − z) s, where s is
    the tangent of half the angle. With the maxima p of z + x/s and q of z − x/s, the least c is (p + q)/2, and
    a = (p − q) s/2.
    """
    back = towards / np.linalg.norm(towards)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    above = np.cross(back, right)
    middle = seen.mean(axis=0)
    x, y, z = np.stack([right, above, back]) @ (seen - middle).T
    tangent = math.tan(angle / 2) / MARGIN
    places, distances = [], []
    for along, slope in ((x, tangent * aspect), (y, tangent)):
        first, second = float((z + along / slope).max()), float((z - along / slope).max())
        distances.append((first + second) / 2)
        places.append((first - second) / 2 * slope)
    eye = middle + places[0] * right + places[1] * above + max(distances) * back
    target = middle + places[0] * right + places[1] * above
    return View(eye, target, above, angle)


def _from_top(seen: Floats, vertical: Floats, ahead: Floats, angle: float, aspect: float) -> View:
    """Return an orthographic view from above."""
    ahead = ahead - (ahead @ vertical) * vertical
    ahead /= np.linalg.norm(ahead)
    ends = np.array([[end(seen @ axis) for end in (np.min, np.max)] for axis in (np.cross(ahead, vertical), ahead)])
    across, along = ends.mean(axis=1)
    half = MARGIN * float(max(np.ptp(ends[0]) / 2 / aspect, np.ptp(ends[1]) / 2))
    target = across * np.cross(ahead, vertical) + along * ahead + float(np.mean(seen @ vertical)) * vertical
    return View(target + (half + float(np.ptp(seen @ vertical))) * 2.0 * vertical, target, ahead, angle, half)


def check_camera(camera: object) -> Camera | Floats:
    """Return a camera after checking that it is one of `CAMERAS` or three points.

    Raises
    ------
    TypeError, ValueError
        If it is neither.
    """
    if isinstance(camera, str):
        for name in CAMERAS:
            if camera == name:
                return name
        raise ArgumentValueError("camera", f"{', '.join(CAMERAS)} or three points", repr(camera))
    points = validation.array("camera", camera, (3, 3))
    if not np.cross(points[1] - points[0], points[2]).any():
        expected = "a target apart from the position and an up vector across the view"
        raise ArgumentValueError("camera", expected, "others")
    return points


def grid(seen: Floats) -> tuple[float, float, Sequence[float], Sequence[float]]:
    """Return the spacing and height of a grid under the points, and the coordinates of its lines along x and y, m."""
    low, high = extent_of(seen)
    spacing = float(round_step(Fraction(float((high - low)[:2].max())) / 12 or Fraction(1)))
    x, y = (
        (np.arange(math.floor(start / spacing), math.ceil(end / spacing) + 1) * spacing).tolist()
        for start, end in zip(low[:2], high[:2], strict=True)
    )
    return spacing, float(np.percentile(seen[:, 2], 1)), x, y


def split_by_color(surface: Surface, picture: Picture) -> list[tuple[str, Surface]]:
    """Split a surface into parts of one colour: by object or instance if the points are coloured so, else by label.

    If no object has a label, it is by instance unless the points are coloured by label.
    If points are coloured by height, each viewer colours surfaces by height itself.
    """
    item, colors = surface.item, picture.colors
    if colors.field in {"object_id", "instance"}:
        category = surface.object_id if colors.field == "object_id" else item.instance
        return [(colors.color(category), surface)]
    if item.instance in picture.instances.names and colors.field != "label":
        return [(picture.instances.color(item.instance), surface)]
    if isinstance(item.label, np.ndarray):
        return [(picture.class_color(label), part) for label, part in surface.parts(surface.labels)]
    return [(picture.class_color(item.label), surface)]
