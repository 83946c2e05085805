"""Schema of configurations, and the objects built from it.

A key is the name of a constructor's argument followed by its unit: ``radius_m`` is the ``radius`` of `Sphere`. Shapes,
patterns and effects declare their own keys as `configuration`, from which `model_of` makes models; the constructor
checks everything except types. Only classes that need more than that have a model here.
"""

from __future__ import annotations

import copy
import dataclasses
import difflib
import inspect
import math
import re
from collections.abc import Callable, Iterable
from datetime import datetime
from functools import lru_cache, partial, reduce
from operator import or_
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, create_model, field_validator, model_validator
from pydantic_core import PydanticCustomError
from scipy.spatial.transform import Rotation

from lidarsim import patterns, worlds
from lidarsim._base import validation
from lidarsim._base.files import check_names, load_array, name_problem
from lidarsim._base.shown import plain
from lidarsim._base.validation import pose as rigid
from lidarsim.io import raster, scenes
from lidarsim.lidar import Lidar
from lidarsim.materials import Material, named
from lidarsim.motion.georeference import Georeference as OnEarth
from lidarsim.motion.georeference import gps_time, projected
from lidarsim.motion.trajectory import Trajectory, mounted
from lidarsim.rig import Rig
from lidarsim.run import CloudArguments, Leg
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.sensor.gnss import Gnss
from lidarsim.sensor.imu import GRAVITY, Imu, ImuErrors
from lidarsim.sensor.measurement import Measurement
from lidarsim.world import shapes
from lidarsim.world.atmosphere import Atmosphere
from lidarsim.world.rules import Options, Rule

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from lidarsim._base.validation import Floats
    from lidarsim.config.document import Place
    from lidarsim.patterns import Pattern
    from lidarsim.world.scene import Scene
    from lidarsim.world.shapes import Shape

__all__ = ["PATTERNS", "SHAPES", "Config", "Sensor", "VendorSensor"]

T = TypeVar("T")
P = TypeVar("P", bound="Part")

# Small units are divided: 55.296 / 1e6 is the float64 nearest to 55.296e-6, because 1e6 is a float64 and 1e-6 is not.
UNITS: dict[str, tuple[str, Callable[[Floats], Floats]]] = {
    "deg_per_s_per_sqrt_hz": ("rad/s/√Hz", np.radians),
    "deg_per_s2_per_sqrt_hz": ("rad/s²/√Hz", np.radians),
    "m_per_s2_per_sqrt_hz": ("", np.positive),
    "m_per_s3_per_sqrt_hz": ("", np.positive),
    "m_per_s2": ("", np.positive),
    "deg_per_s": ("rad/s", np.radians),
    "deg_per_h": ("rad/s", lambda value: np.radians(value) / 3600.0),
    "m_per_s": ("", np.positive),
    "per_m": ("", np.positive),
    "per_m_sr": ("", np.positive),
    "mm_per_h": ("", np.positive),
    "deg": ("rad", np.radians),
    "mrad": ("rad", lambda value: value / 1e3),
    "mm": ("m", lambda value: value / 1e3),
    "m": ("", np.positive),
    "us": ("s", lambda value: value / 1e6),
    "ns": ("s", lambda value: value / 1e9),
    "s": ("", np.positive),
    "khz": ("Hz", lambda value: value * 1e3),
    "hz": ("", np.positive),
    "rpm": ("Hz", lambda value: value / 60.0),
}


class Model(BaseModel):
    """A mapping with these keys and no others."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @classmethod
    def nearest(cls, key: str) -> list[str]:
        """Return the keys that `key` may be a misspelling of."""
        return difflib.get_close_matches(key, cls.model_fields)

    @model_validator(mode="before")
    @classmethod
    def _suggest(cls, value: object) -> object:
        for key in value if isinstance(value, dict) else ():
            if key not in cls.model_fields:
                near = cls.nearest(key)
                hint = (
                    f"did you mean {' or '.join(near)}?" if near else f"expected one of {', '.join(cls.model_fields)}"
                )
                raise PydanticCustomError("unknown_key", "unknown key; {hint}", {"key": key, "hint": hint})
        return value


def _in_si(value: float | list[float] | list[list[float]], unit: str) -> float | Floats:
    with np.errstate(over="ignore"):  # the constructor refuses infinite values
        converted = UNITS[unit][1](np.asarray(value, dtype=np.float64))
    return converted if isinstance(value, list) else float(converted)


def construct(constructor: Callable[..., T], model: Model, keys: Iterable[str], place: Place, **more: object) -> T:
    """Call `constructor` with `more` and the given values of `keys`, in SI units and radians.

    Raises
    ------
    ConfigError
        If the constructor raises an error: at the key of the argument that it names, else at `place`.
    """
    arguments: dict[str, object] = {}
    key_of: dict[str, tuple[str, str]] = {}
    for key in sorted(model.model_fields_set.intersection(keys)):
        value: Any = _built(getattr(model, key), place / key)
        name, unit = _argument(key), _unit(key)
        if unit and value is not None:
            value = _in_si(value, unit)
        if name in key_of:
            raise (place / key).error(f"given already as {key_of[name][0]}")
        arguments[name] = value
        key_of[name] = key, f" (in {UNITS[unit][0]})" if unit and UNITS[unit][0] else ""
    with place.refusals(key_of):
        return constructor(**{**arguments, **more})


def _built(value: object, place: Place) -> object:
    if isinstance(value, Part):
        return value.build(place)
    if isinstance(value, list):
        return [_built(entry, place / index) for index, entry in enumerate(value)]
    return value


class Part(Model):
    """A mapping whose keys are the arguments of a constructor."""

    constructor: ClassVar[Callable[..., Any]]
    alternatives: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Groups of keys for one required argument in different units; one key must be given."""

    def build(self, place: Place) -> Any:
        """Return the object that it describes."""
        for keys in self.alternatives:
            if not self.model_fields_set.intersection(keys):
                raise place.error(f"missing key {' or '.join(map(repr, keys))}")
        constructor = type(self).constructor
        return construct(constructor, self, constructor.configuration, place)  # type: ignore[attr-defined]


def model_of(constructor: Any, base: type[Part] = Part, **more: Any) -> Any:
    """Return the model for `constructor`, with the keys that it declares as its `configuration`.

    A key is optional if its argument has a default, and may be null if the default is None.

    Parameters
    ----------
    constructor : type
        A type with a `configuration` that maps keys to types.
    base : type of Part
        Base class of the model.
    **more : Any
        Further fields, as (type, default).

    Returns
    -------
    type of Part
        The model.
    """
    parameters = inspect.signature(constructor).parameters
    keys_of: dict[str, list[str]] = {}
    for key in constructor.configuration:
        keys_of.setdefault(_argument(key), []).append(key)
    fields: dict[str, Any] = dict(more)
    for argument, keys in keys_of.items():
        default = parameters[argument].default
        for key in keys:
            kind = _kind(constructor.configuration[key])
            if default is inspect.Parameter.empty and len(keys) == 1:
                fields[key] = (kind, ...)
            else:
                fields[key] = (kind | None if default is None else kind, None)
    model = create_model(constructor.__name__, __base__=base, **fields)
    model.constructor = constructor
    model.alternatives = tuple(
        tuple(keys)
        for argument, keys in keys_of.items()
        if len(keys) > 1 and parameters[argument].default is inspect.Parameter.empty
    )
    return model


def _kind(declared: Any) -> Any:
    """Return the type in a model of a value declared as `declared`."""
    if hasattr(declared, "configuration"):
        return model_of(declared)
    (entry,) = getattr(declared, "__args__", (None,)) if getattr(declared, "__origin__", None) is list else (None,)
    if hasattr(entry, "configuration"):
        return list[model_of(entry)]  # type: ignore[misc]
    return _KINDS[declared]


def _unit(key: str) -> str | None:
    return next((unit for unit in UNITS if key.endswith(f"_{unit}")), None)


def _argument(key: str) -> str:
    unit = _unit(key)
    return key.removesuffix(f"_{unit}") if unit else key


def either(first: Any, second: Any, is_second: Callable[[object], bool]) -> Any:
    """Return a union of two types that only reports errors of the type chosen by `is_second`."""
    tag = Discriminator(lambda value: "second" if is_second(value) else "first")
    return Annotated[Annotated[first, Tag("first")] | Annotated[second, Tag("second")], tag]


def _is_list(value: object) -> bool:
    return isinstance(value, list)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _has_file(value: object) -> bool:
    return isinstance(value, dict) and "file" in value


def _has_strips(value: object) -> bool:
    return isinstance(value, dict) and "strips" in value


def _has_way(value: object) -> bool:
    return isinstance(value, dict) and "way" in value


def _has_stations(value: object) -> bool:
    return isinstance(value, dict) and "stations" in value


def _is_table(value: object) -> bool:
    return isinstance(value, list) and any(isinstance(row, list) for row in value)


Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Row = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Row], Field(min_length=4, max_length=4)]

if TYPE_CHECKING:
    Numbers = float | list[float]
    Vectors = Vector | list[Vector]
    Scale = float | list[float]
    Grouping = str | int | None
    FloatOrText = float | str
    NumbersOrColor = float | list[float] | str
    SigmaTable = float | list[Pair]
    Area = list[float] | list[Pair]
    Returns = str | int
else:
    Numbers = either(float, list[float], _is_list)
    Vectors = either(Vector, list[Vector], _is_table)
    Scale = either(Finite, Annotated[list[Finite], Field(min_length=3, max_length=3)], _is_list)
    SigmaTable = either(float, list[Pair], _is_list)
    Area = either(list[float], list[Pair], _is_table)
    Returns = either(int, str, _is_text)
    Grouping = either(int, Literal["node", "parent", "file"], _is_text) | None
    NumbersOrColor = either(Numbers, Literal["color"], _is_text)
    FloatOrText = either(float, str, _is_text)

_KINDS: dict[Any, Any] = {
    bool: bool,
    float: float,
    int: int,
    int | str: Returns,
    list[float]: list[float],
    tuple[float, float]: Pair,
    float | list[float]: Numbers,
    float | list[tuple[float, float]]: SigmaTable,
    list[tuple[float, float]]: list[Pair],
    validation.Vector: Vector,
    list[validation.Vector]: list[Vector],
    validation.Vector | list[validation.Vector]: Vectors,
}
"""Type in a model for each type that a `configuration` may declare."""


# Poses


class Turn(Model):
    """Rotations about the fixed axes, x first: R = Rz(yaw) Ry(pitch) Rx(roll)."""

    roll: Finite = 0.0
    pitch: Finite = 0.0
    yaw: Finite = 0.0


class Placement(Model):
    """A pose: position and rotation, or the 4x4 matrix into the world."""

    position_m: Vector = [0.0, 0.0, 0.0]
    rotation_deg: Turn = Turn()
    matrix: Matrix | None = None

    def to_matrix(self, place: Place, scale: float | Vector = 1.0) -> Floats:
        """Return the 4x4 matrix into the world."""
        if self.matrix is not None:
            others = [key for key in ("position_m", "rotation_deg", "scale") if key in self.model_fields_set]
            if others:
                raise (place / "matrix").error(f"expected the matrix alone, got {others[0]} beside it")
            return np.array(self.matrix)
        matrix = np.eye(4)
        turn = self.rotation_deg
        rotation = Rotation.from_euler("ZYX", [turn.yaw, turn.pitch, turn.roll], degrees=True).as_matrix()
        matrix[:3, :3] = rotation * scale  # R diag(scale)
        matrix[:3, 3] = self.position_m
        return matrix


PLACING = frozenset(Placement.model_fields)


class Waypoint(Placement):
    """A placement at a time."""

    time_s: float


class Pose(Placement):
    """A placement that may move with a constant twist from time 0."""

    linear_m_per_s: Vector = [0.0, 0.0, 0.0]
    angular_deg_per_s: Vector = [0.0, 0.0, 0.0]


class TrajectoryFile(Placement):
    """Poses over time from a file; its placement is that of the world of the file."""

    file: str
    times: str | None = None
    scene: str | None = None
    start_s: Finite | None = None
    interpolation: Literal["linear", "spline"] = "linear"
    axes: Literal["body", "camera"] = "body"


class Plan(Model):
    """Parallel strips over an area, as in `Trajectory.strips`."""

    area_m: Area
    height_m: float
    speed_m_per_s: float
    overlap: float
    field_of_view_deg: float
    heading_deg: float = 0.0
    turn_s: float = 60.0
    ground_m: float = 0.0
    margin_m: float | None = None


class Strips(Placement):
    """A flight in strips; its placement is that of the sensor on the aircraft."""

    strips: Plan

    def build(self, place: Place, sensor: Lidar | Rig) -> tuple[Leg, ...]:
        """Return the strips, each with the frames that it holds."""
        plan, there = self.strips, place / "strips"
        rate = sensor.rate if isinstance(sensor, Rig) else sensor.pattern.rate
        # Frames start at multiples of 1/rate, so a strip has up to one period without a frame at either end.
        margin = {} if plan.margin_m is not None else {"margin": plan.speed_m_per_s / rate}
        keys = [key for key in Plan.model_fields if getattr(plan, key) is not None]
        legs, mount = [], _rigid(self, place)
        for number, body in enumerate(construct(Trajectory.strips, plan, keys, there, **margin), 1):
            (start, end), pose = body.span, mounted(body, mount)
            if not end * rate < 2**32:
                raise there.error(f"expected at most 4294967296 frames, got {end * rate:.3g}")
            first, stop = math.ceil(start * rate), math.floor(end * rate)
            while first / rate < start:  # rounding may exceed the span by a frame
                first += 1
            while stop / rate > end or _end(sensor, first, stop) > end:
                stop -= 1
            if stop <= first:
                raise there.error(f"expected strips of a frame, {1.0 / rate:g} s, got one of {end - start:g} s")
            legs.append(Leg(number, pose, range(first, stop)))
        return tuple(legs)


def _end(sensor: Lidar | Rig, first: int, stop: int) -> float:
    """Return the end of the last frame of any sensor, s."""
    if isinstance(sensor, Rig) and stop > first:
        return sensor.span(stop - first, first=first)[1]
    return -math.inf


class Stations(Placement):
    """Places of a tripod; the placement is that of the sensor on it."""

    stations: Annotated[list[Placement], Field(min_length=1)]

    def build(self, place: Place, frames: range) -> tuple[Leg, ...]:
        """Return the stations; the first has the given frames, and the others as many after them."""
        mount, legs = _rigid(self, place), []
        for index, station in enumerate(self.stations):
            first = frames.start + index * len(frames)
            pose = mounted(_rigid(station, place / "stations" / index), mount)
            legs.append(Leg(index + 1, pose, range(first, first + len(frames))))
        return tuple(legs)


class Drive(Placement):
    """A way of a street, along which the sensor moves; the placement is that of the sensor on the vehicle."""

    way: Literal["lanes", "turns", "pavements", "crossings"]
    number: Annotated[int, Field(ge=0)] = 0
    start_m: Annotated[float, Field(ge=0)] = 0.0
    speed_m_per_s: Annotated[float, Field(gt=0, allow_inf_nan=False)]

    def build(self, place: Place, ways: worlds.Ways | None) -> Trajectory:
        """Return the trajectory from time 0 to the end of the way."""
        if ways is None:
            raise (place / "way").error("expected a pose, since the scene is not a street")
        lines = getattr(ways, self.way)
        if self.number >= len(lines):
            raise (place / "number").error(f"expected the number of one of {len(lines)} {self.way}, got {self.number}")
        points = lines[self.number]
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        if not self.start_m < along[-1]:
            raise (place / "start_m").error(f"expected less than the length of the way, {along[-1]:.4g}")
        ahead = np.gradient(points, along, axis=0)
        at = np.concatenate([[self.start_m], along[along > self.start_m]])
        points, ahead = (np.stack([np.interp(at, along, row) for row in rows.T], axis=1) for rows in (points, ahead))
        turns = [np.arctan2(ahead[:, 1], ahead[:, 0]), -np.arctan2(ahead[:, 2], np.hypot(ahead[:, 0], ahead[:, 1]))]
        poses = np.tile(np.eye(4), (len(at), 1, 1))
        poses[:, :3, :3] = Rotation.from_euler("ZY", np.stack(turns, axis=1)).as_matrix()
        poses[:, :3, 3] = points
        return Trajectory((at - self.start_m) / self.speed_m_per_s, poses) @ _rigid(self, place)


def build_pose(value: Pose | list[Waypoint] | TrajectoryFile, place: Place) -> Floats | Trajectory:
    """Return the pose, or the trajectory of a moving one."""
    if isinstance(value, TrajectoryFile):
        files = {"path": (place / "file").file(value.file)}
        if value.times is not None:
            files["times"] = (place / "times").file(value.times)
        trajectory = construct(Trajectory.load, value, ["interpolation", "axes", "scene", "start_s"], place, **files)
        with place.refusals({"world": ("position_m", "")}):
            return trajectory if value.model_fields_set.isdisjoint(PLACING) else _rigid(value, place) @ trajectory
    if isinstance(value, list):
        poses = [_rigid(waypoint, place / index) for index, waypoint in enumerate(value)]
        with place.refusals():
            return Trajectory([waypoint.time_s for waypoint in value], poses)
    return _moving(_rigid(value, place), value, place)


def _rigid(placement: Placement, place: Place) -> Floats:
    with place.refusals({"matrix": ("matrix", "")}):
        return rigid("matrix", placement.to_matrix(place))


class Twist(Model):
    """A constant velocity, of an object in its own axes."""

    linear_m_per_s: Vector = [0.0, 0.0, 0.0]
    angular_deg_per_s: Vector = [0.0, 0.0, 0.0]


def _moving(start: Floats, twist: Pose | Twist, place: Place) -> Floats | Trajectory:
    """Return the pose, or the trajectory from it if there are velocities."""
    if any(twist.linear_m_per_s) or any(twist.angular_deg_per_s):
        keys = {"linear": ("linear_m_per_s", ""), "angular": ("angular_deg_per_s", " (in rad/s)")}
        with place.refusals(keys):
            return Trajectory.from_twist(start, twist.linear_m_per_s, np.radians(twist.angular_deg_per_s))
    return start


if TYPE_CHECKING:
    PoseOverTime = Pose | list[Waypoint] | TrajectoryFile
    Motion = Twist | list[Waypoint] | TrajectoryFile
    PoseOfRun = PoseOverTime | Strips | Stations | Drive
else:
    PoseOverTime = either(either(Pose, TrajectoryFile, _has_file), list[Waypoint], _is_list)
    Motion = either(either(Twist, TrajectoryFile, _has_file), list[Waypoint], _is_list)
    PoseOfRun = either(either(either(PoseOverTime, Strips, _has_strips), Stations, _has_stations), Drive, _has_way)


# Objects of the scene


class Object(Part, Placement):
    """An object of the scene: a shape with its placement and material."""

    name: str = ""
    label: int = 0
    instance: int | None = None
    material: str | None = None
    reflectivity: Numbers = 1.0
    reflectivity_per: Literal["object", "face", "vertex"] = "object"
    roughness_deg: float = 0.0
    specular: float = 0.0
    specular_width: float = 0.1
    transmission: float = 0.0
    mirror: float = 0.0
    variation: float = 0.0
    grain_m: float = 0.05
    scale: Scale = 1.0
    motion: Motion | None = None

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the object to `scene`."""
        self._add(self.build(place), scene, place)

    def _add(self, shape: Shape, scene: Scene, place: Place, inner: Floats | None = None, **more: object) -> None:
        material = more.pop("material", None) or self._material(place)
        transform, motion = self._placed(place)
        if inner is not None:
            transform = inner if transform is None else transform @ inner
        more = {"transform": transform, "motion": motion, "shape": shape, "material": material, **more}
        construct(scene.add, self, ["name", "label", "instance"], place, **more)

    def _material(self, place: Place) -> Material:
        """Return the material, whose own keys override those of the library's."""
        base = Material()
        if self.material is not None:
            with place.refusals({"name": ("material", "")}):
                base = named(self.material)
        keys = ["reflectivity", "roughness_deg", "specular", "specular_width", "transmission", "mirror"]
        keys += ["variation", "grain_m"]
        differ = partial(Material, **{_argument(key): getattr(base, _argument(key)) for key in keys})
        return construct(differ, self, keys, place, per=self.reflectivity_per)

    def _placed(self, place: Place) -> tuple[Floats | None, Trajectory | None]:
        """Return the transform and the motion that follows it."""
        placed = self.model_fields_set & {"position_m", "rotation_deg", "scale", "matrix"}
        transform = self.to_matrix(place, self.scale) if placed else None
        if self.motion is None:
            return transform, None
        if isinstance(self.motion, Twist):
            # The motion starts at the placement, in its axes, so only the scale precedes it.
            start = _rigid(Placement(**{key: getattr(self, key) for key in placed - {"scale"}}), place)
            motion = _moving(start, self.motion, place / "motion")
            if isinstance(motion, Trajectory):
                transform = np.diag([*np.broadcast_to(self.scale, 3), 1.0]) if "scale" in placed else None
        else:
            motion = build_pose(self.motion, place / "motion")
        return transform, motion if isinstance(motion, Trajectory) else None


class Plane(Object):
    """The plane of points p with normal·p = distance, or through a point."""

    constructor = shapes.Plane

    shape: Literal["plane"]
    normal: Vector
    distance_m: float = 0.0
    point_m: Vector | None = None

    def build(self, place: Place) -> Shape:
        """Return the shape."""
        if self.point_m is None:
            return construct(shapes.Plane, self, ["normal"], place, distance=self.distance_m)
        if "distance_m" in self.model_fields_set:
            raise (place / "distance_m").error("expected either distance_m or point_m, got both")
        return construct(shapes.Plane.from_point, self, ["point_m", "normal"], place)


class Mesh(Object):
    """A triangle mesh from a file."""

    constructor = shapes.TriangleMesh

    shape: Literal["mesh"]
    file: str

    def build(self, place: Place) -> Shape:
        """Return the shape."""
        return (place / "file").load(self.file, shapes.TriangleMesh.from_file)


class Heightfield(Object):
    """Terrain from a NumPy file of heights, m: columns along x, rows along y."""

    constructor = shapes.TriangleMesh.from_heightfield

    shape: Literal["heightfield"]
    file: str
    spacing_m: Numbers
    origin_m: Pair = [0.0, 0.0]

    def build(self, place: Place) -> Shape:
        """Return the shape."""
        heights = (place / "file").load(self.file, load_array)
        return construct(shapes.TriangleMesh.from_heightfield, self, ["spacing_m", "origin_m"], place, z=heights)


class Raster(Object):
    """Terrain from a digital elevation model, a GeoTIFF or an Esri ASCII grid, at its coordinates."""

    constructor = shapes.TriangleMesh.from_raster

    shape: Literal["raster"]
    file: str
    band: int = 1
    window_m: Row | None = None
    stride: int = 1

    def build(self, place: Place) -> shapes.TriangleMesh:
        """Return the shape."""

        def read(path: Path) -> shapes.TriangleMesh:
            return construct(shapes.TriangleMesh.from_raster, self, ["band", "window_m", "stride"], place, path=path)

        key = "raster", self.band, tuple(self.window_m or ()), self.stride
        return (place / "file").load(self.file, read, key)

    def _add(self, shape: Shape, scene: Scene, place: Place, inner: Floats | None = None, **more: object) -> None:
        crs = getattr(shape, "crs", None)
        for item in scene:
            other = getattr(item.shape, "crs", None)
            if crs and other and not raster.same_crs(crs, other):
                expected = f"expected a raster in {plain(other, most=60)}, as object {item.id} is"
                raise (place / "file").error(f"{expected}, got one in {plain(crs, most=60)}")
        super()._add(shape, scene, place, inner, **more)


class SceneRule(Part):
    """A rule for the parts of a scene file."""

    constructor = Rule

    node: str = "*"
    material: str = "*"
    label: int | None = None
    reflectivity: FloatOrText | None = None
    instance: Grouping = None
    name: str | None = None
    skip: bool = False

    def build(self, place: Place) -> Rule:
        """Return the rule."""
        keys = set(type(self).model_fields)
        if not isinstance(self.reflectivity, str) or self.reflectivity == "color":
            return construct(Rule, self, keys, place)
        with place.refusals({"name": ("reflectivity", "")}):
            material = named(self.reflectivity)
        return construct(Rule, self, keys - {"reflectivity"}, place, reflectivity=material)


class Surfels(Object):
    """Disks at the points of a cloud, with the labels that it has unless `label` is given."""

    constructor = shapes.Disks.from_points

    shape: Literal["surfels"]
    file: str
    neighbours: int = 16
    radius_m: float | None = None

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the disks to `scene`."""
        disks, labels = self._disks(place)
        if labels is None:
            self._add(disks, scene, place)
        else:
            self._add(disks, scene, place, label=labels)

    def build(self, place: Place) -> Shape:
        """Return the shape."""
        return self._disks(place)[0]

    def _disks(self, place: Place) -> tuple[shapes.Disks, npt.NDArray[np.uint32] | None]:
        cloud = (place / "file").load(self.file, PointCloud.load)
        with place.refusals({"points": ("file", ""), "neighbours": ("neighbours", ""), "radii": ("radius_m", "")}):
            disks, index = shapes.Disks.from_points(
                cloud.xyz, radii=self.radius_m, neighbours=self.neighbours, return_index=True
            )
        has_labels = "label" in cloud.fields and "label" not in self.model_fields_set
        return disks, cloud.label[index] if has_labels else None


class SceneFile(Object):
    """The objects of a scene file such as GLB."""

    constructor = shapes.TriangleMesh

    shape: Literal["scene_file"]
    file: str
    up: Literal["y", "z"] | None = None
    unit_m: float | None = None
    rules: list[SceneRule] = []
    reflectivity: NumbersOrColor = 1.0  # type: ignore[assignment]

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the objects to `scene`, named after their nodes; what a rule says of them replaces what is said here."""
        for item, instance in self.load(place).instances(len(scene)):
            more: dict[str, Any] = {"name": f"{self.name}/{item.name}".lstrip("/"), "instance": instance}
            if item.label is not None:
                more["label"] = item.label
            self._add(item.shape, scene, place, inner=item.transform, material=item.material, **more)

    def load(self, place: Place) -> scenes.Imported:
        """Return what the file holds."""
        others = [
            key
            for key in ("material", "roughness_deg", "specular", "transmission", "mirror", "variation")
            if key in self.model_fields_set
        ]
        if self.reflectivity == "color" and others:
            raise (place / "reflectivity").error(f"expected a number beside {others[0]}, got color")
        rules = [rule.build(place / "rules" / index) for index, rule in enumerate(self.rules)]
        with place.refusals({"unit": ("unit_m", "")}):
            options = Options.checked(self.up, self.unit_m, rules, "color" if self.reflectivity == "color" else None)
        return (place / "file").load(self.file, scenes.Load(options))


class Generated(Object):
    """An asset that a generator of `lidarsim.worlds` makes of a seed and its own keys, as one instance."""

    generator: ClassVar[Callable[..., worlds.Asset]]

    seed: Annotated[int, Field(ge=0)] = 0

    def add_to(self, scene: Scene, place: Place) -> None:
        """Add the parts to `scene`."""
        instance = len(scene) + 1 if self.instance is None else self.instance
        for part in self.asset(place).parts:
            self._add(part.shape, scene, place, inner=part.transform, instance=instance, **self.looks(part))

    def asset(self, place: Place, seed: int | None = None) -> worlds.Asset:
        """Return the asset of a seed, by default its own."""
        for key in Object.model_fields.keys() - {"name", "label", "instance", "motion", *PLACING, "scale"}:
            if key in self.model_fields_set:
                raise (place / key).error("expected none, since its parts have materials of their own")
        rng = np.random.default_rng(self.seed if seed is None else seed)
        keys = type(self).model_fields.keys() - Generated.model_fields.keys() - {"shape", "kind"}
        kind = {"kind": self.kind} if "kind" in type(self).model_fields else {}  # type: ignore[attr-defined]
        return construct(partial(type(self).generator, rng=rng), self, keys, place, **kind)

    def looks(self, part: worlds.Part) -> dict[str, Any]:
        """Return the arguments of `Scene.add` that are those of a part."""
        label = self.label if "label" in self.model_fields_set else part.label
        return {"name": f"{self.name}/{part.name}".lstrip("/"), "label": label, "material": part.material}


def _generated(name: str, generator: Callable[..., worlds.Asset]) -> type[Generated]:
    """Return the model of a generator, whose keys are its arguments; those that are lengths end in _m."""
    fields: dict[str, Any] = {"shape": (Literal[name], ...)}
    types = get_type_hints(generator)
    for argument, parameter in inspect.signature(generator).parameters.items():
        if argument != "rng":
            is_length = types[argument] in {float, float | None}
            default = ... if parameter.default is inspect.Parameter.empty else parameter.default
            fields[f"{argument}_m" if is_length else argument] = (types[argument], default)
    model = create_model(name.capitalize(), __base__=Generated, **fields)
    model.generator = generator
    return model


def _public(package: ModuleType) -> list[type]:
    return [getattr(package, name) for name in package.__all__]


def _models_of(constructors: Iterable[type], tag: str, base: type[P]) -> dict[str, type[P]]:
    """Return the models of the `constructors` that declare a `configuration`, by name; the key `tag` has the name."""
    declaring = [constructor for constructor in constructors if getattr(constructor, "configuration", None)]
    names = [re.sub(r"(?<=[a-z])(?=[A-Z])", "_", constructor.__name__).lower() for constructor in declaring]
    return {
        name: model_of(made, base, **{tag: (Literal[name], ...)}) for name, made in zip(names, declaring, strict=True)
    }


SHAPES: dict[str, type[Object]] = {
    "plane": Plane,
    "mesh": Mesh,
    "heightfield": Heightfield,
    "raster": Raster,
    "surfels": Surfels,
    "scene_file": SceneFile,
    **{name: _generated(name, getattr(worlds, name)) for name in worlds.GENERATORS},
    **_models_of(_public(shapes), "shape", Object),
}


# Scan patterns


class Table(Part):
    """Directions listed in a CSV or NPY file."""

    constructor = patterns.Table

    type: Literal["table"]
    file: str
    rate_hz: float
    pulse_rate_khz: float | None = None

    def build(self, place: Place) -> Pattern:
        """Return the pattern."""
        path = (place / "file").file(self.file)
        return construct(patterns.Table.from_file, self, ["rate_hz", "pulse_rate_khz"], place, path=path)


PATTERNS: dict[str, type[Part]] = {
    "table": Table,
    **_models_of((item for item in _public(patterns) if hasattr(item, "pulses")), "type", Part),
}

if TYPE_CHECKING:
    AnyObject = Object
    AnyPattern = Part
else:
    AnyObject = Annotated[reduce(or_, SHAPES.values()), Discriminator("shape")]
    AnyPattern = Annotated[reduce(or_, PATTERNS.values()), Discriminator("type")]


class StreetKeys(Model):
    """A street, as of `lidarsim.worlds.street`."""

    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    kind: str = "residential"
    length_m: float = 300.0

    def build(self, place: Place) -> worlds.Street:
        """Return a copy of the street, which is made once."""
        with place.refusals({"length": ("length_m", ""), "kind": ("kind", "")}):
            made = _street(self.seed, self.kind, self.length_m)
        return worlds.Street(copy.copy(made.scene), made.ways)


@lru_cache(maxsize=2)
def _street(seed: int, kind: Any, length: float) -> worlds.Street:
    return worlds.street(seed, kind, length=length)


class World(Model):
    """A street, and objects that are added to it."""

    street: StreetKeys
    objects: list[AnyObject] = []


if TYPE_CHECKING:
    AnyScene = list[AnyObject] | World
else:
    AnyScene = either(list[AnyObject], World, lambda value: isinstance(value, dict))


# Sensors

_EXACT = Measurement()


class Effects(model_of(Measurement)):  # type: ignore[misc]
    """Noise and other effects, all off by default."""

    def build(self, place: Place, base: Measurement = _EXACT) -> Measurement:
        """Return `base` with the given effects."""
        return construct(partial(dataclasses.replace, base), self, Measurement.configuration, place)


class _Limits(Model):
    name: str = ""
    measurement: Effects = Effects()
    min_range_m: float = 0.0
    max_range_m: float = float("inf")
    range_offset_m: Numbers = 0.0


_LIMITS = _Limits.model_fields.keys() - {"measurement"}


class Measured(Model):
    """What measurements of a real unit found, where that differs from `datasheet_noise` and the limits."""

    measurement: Effects = Effects()
    min_range_m: float = 0.0
    max_range_m: float = float("inf")


class Sensor(_Limits):
    """A lidar. `datasheet_noise`, `measured` and `modes` are merged in on request; `sources` cites the numbers."""

    pattern: AnyPattern
    model: str = ""
    description: str = ""
    datasheet_noise: Effects | None = None
    measured: Measured | None = None
    modes: dict[str, dict[str, Any]] = {}
    datasheet: dict[str, Any] = {}
    sources: dict[str, str] = {}

    def build(self, place: Place) -> Lidar:
        """Return the lidar."""
        parts = {
            "pattern": self.pattern.build(place / "pattern"),
            "measurement": self.measurement.build(place / "measurement"),
        }
        return construct(Lidar, self, _LIMITS | {"model"}, place, **parts)


class VendorSensor(_Limits):
    """A lidar from a vendor's own file, with values that the file lacks and changes to it."""

    file: str
    mode: str | None = None
    model: str | None = None
    noise: Literal["none", "datasheet", "measured"] = "none"
    rate_hz: float | None = None
    pulse_rate_khz: float | None = None
    firing_times: str | None = None

    def build(self, place: Place) -> Lidar:
        """Return the lidar."""
        files: dict[str, object] = {"path": (place / "file").file(self.file)}
        if self.firing_times is not None:
            files["firing_times"] = (place / "firing_times").file(self.firing_times)
        if self.noise != "none":
            files["noise"] = self.noise
        lidar = construct(Lidar.from_file, self, ["mode", "model", "rate_hz", "pulse_rate_khz"], place, **files)
        measurement = self.measurement.build(place / "measurement", lidar.measurement)
        differ = partial(dataclasses.replace, lidar)
        return construct(differ, self, _LIMITS, place, measurement=measurement)


# Runs

if TYPE_CHECKING:
    AnySensor = Sensor | VendorSensor
else:
    AnySensor = either(Sensor, VendorSensor, _has_file)


class Gyroscope(Model):
    """Errors of the gyroscopes of an IMU."""

    noise_density_deg_per_s_per_sqrt_hz: float = 0.0
    bias_instability_deg_per_h: float = 0.0
    random_walk_deg_per_s2_per_sqrt_hz: float = 0.0
    bias_deg_per_s: float = 0.0
    scale_factor: float = 0.0
    misalignment_deg: float = 0.0
    range_deg_per_s: float = float("inf")

    def build(self, place: Place) -> ImuErrors:
        """Return the errors."""
        return construct(ImuErrors, self, type(self).model_fields, place)


class Accelerometer(Model):
    """Errors of the accelerometers of an IMU."""

    noise_density_m_per_s2_per_sqrt_hz: float = 0.0
    bias_instability_m_per_s2: float = 0.0
    random_walk_m_per_s3_per_sqrt_hz: float = 0.0
    bias_m_per_s2: float = 0.0
    scale_factor: float = 0.0
    misalignment_deg: float = 0.0
    range_m_per_s2: float = float("inf")

    def build(self, place: Place) -> ImuErrors:
        """Return the errors."""
        return construct(ImuErrors, self, type(self).model_fields, place)


class InertialUnit(Model):
    """An IMU."""

    rate_hz: float
    gyroscope: Gyroscope = Gyroscope()
    accelerometer: Accelerometer = Accelerometer()
    gravity_m_per_s2: float = GRAVITY
    latitude_deg: float | None = None

    def build(self, place: Place, name: str, mount: Floats) -> Imu:
        """Return the IMU of this name and pose on the body."""
        errors = {
            "gyroscope": self.gyroscope.build(place / "gyroscope"),
            "accelerometer": self.accelerometer.build(place / "accelerometer"),
        }
        keys = type(self).model_fields.keys() - errors
        return construct(Imu, self, keys, place, name=name, mount=mount, **errors)


class Receiver(Model):
    """A GNSS receiver."""

    rate_hz: float
    position_sigma_m: float | Vector = 0.0
    drift_sigma_m: float | Vector = 0.0
    drift_time_s: float = 300.0

    def build(self, place: Place, name: str, mount: Floats) -> Gnss:
        """Return the receiver of this name and pose on the body."""
        return construct(Gnss, self, type(self).model_fields, place, name=name, mount=mount)


class Mounted(Placement):
    """A lidar, an IMU or a GNSS receiver of a rig: its placement on the body, and the delay of a lidar's frames."""

    sensor: AnySensor | None = None
    imu: InertialUnit | None = None
    gnss: Receiver | None = None
    offset_s: Finite | None = None

    def build(self, place: Place, name: str) -> tuple[Any, ...]:
        """Return the member of the rig of this name."""
        if expected := name_problem(name):  # files get this name
            raise place.error(f"expected {expected}")
        mount = _rigid(self, place)
        kinds = [kind for kind in ("imu", "gnss", "sensor") if getattr(self, kind) is not None]
        if not kinds:
            raise place.error("missing key 'sensor', 'imu' or 'gnss'")
        kind, *more = kinds
        for key in [*more, *(["offset_s"] if "offset_s" in self.model_fields_set and kind != "sensor" else [])]:
            raise (place / key).error(f"expected none beside {'an imu' if kind == 'imu' else 'a gnss'}")
        if self.sensor is not None:
            return self.sensor.build(place / "sensor"), mount, self.offset_s or 0.0
        return getattr(self, kind).build(place / kind, name, mount), None


def build_rig(sensors: dict[str, Mounted], place: Place) -> Rig:
    """Return the rig of these sensors."""
    parts = {name: member.build(place / name, name) for name, member in sensors.items()}
    with place.refusals():
        check_names("sensors", parts)
        return Rig(parts)


class Cloud(Model):
    """Coordinate frame and deskewing of the written points."""

    frame: Literal["sensor", "world"] = "sensor"
    deskew: bool | Literal["start", "middle", "end"] = False
    deskew_s: Finite | None = None

    @field_validator("deskew", mode="before")
    @classmethod
    def _name(cls, value: object) -> object:
        if not isinstance(value, bool) and value not in ("start", "middle", "end"):
            expected = "expected true, false, start, middle, end, or seconds as deskew_s, got {got}"
            raise PydanticCustomError("deskew", expected, {"got": validation.shown(value)})
        return value

    def build(self, place: Place) -> CloudArguments:
        """Return the arguments of `Scan.point_cloud`."""
        if self.deskew_s is None:
            return {"frame": self.frame, "deskew": self.deskew}
        if "deskew" in self.model_fields_set:
            raise (place / "deskew_s").error("expected either deskew or deskew_s, got both")
        return {"frame": self.frame, "deskew": self.deskew_s}


class Origin(Model):
    """Where the origin of a world is on the Earth."""

    latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    longitude_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    altitude_m: float = 0.0

    def build(self, place: Place) -> tuple[float, float, float]:
        """Return latitude and longitude, rad, and altitude, m."""
        origin = math.radians(self.latitude_deg), math.radians(self.longitude_deg), self.altitude_m
        with place.refusals({"origin[2]": ("altitude_m", "")}):
            OnEarth(origin=origin)
        return origin


class Georeference(Model):
    """Where the world is on the Earth, and the start of the run, for GNSS receivers and for files that hold them."""

    crs: int | str | None = None
    origin: Origin | None = None
    start: str | None = None

    def build(self, place: Place) -> tuple[int | str | None, float | datetime]:
        """Return the system and the start, after checking them."""
        if self.crs is not None:
            if self.origin is not None:
                raise (place / "origin").error("expected either crs or origin, got both")
            with (place / "crs").refusals():
                projected(self.crs)
        if self.start is None:
            return self.crs, 0.0
        try:
            start = datetime.fromisoformat(self.start)
        except ValueError:
            got = validation.shown(self.start)
            raise (place / "start").error(f"expected a moment such as 2026-05-01T10:00:00+02:00, got {got}") from None
        with place.refusals({"start": ("start", "")}):
            gps_time(start)
        return self.crs, start


def labelled(names: dict[str, str], place: Place) -> dict[int, str]:
    """Return class names by integer label."""
    for label in names:
        if re.fullmatch(r"0|[1-9][0-9]{0,9}", label) is None or int(label) > validation.UINT32:
            raise (place / label).error("expected a label, 0 to 4294967295")
    return {int(label): name for label, name in names.items()}


class Fog(Model):
    """Fog."""

    visibility_m: float


class Precipitation(Model):
    """Rain or snow."""

    rate_mm_per_h: float


class Air(Model):
    """The atmosphere of a scene: of fog, rain or snow, whose values its other keys replace."""

    fog: Fog | None = None
    rain: Precipitation | None = None
    snow: Precipitation | None = None
    extinction_per_m: float = 0.0
    backscatter_per_m_sr: float = 0.0
    label: int = 0
    aperture_mm: float = 10.0
    divergence_mrad: float = 3.0

    def build(self, place: Place) -> Atmosphere:
        """Return the atmosphere."""
        kinds = [name for name in ("fog", "rain", "snow") if getattr(self, name) is not None]
        if len(kinds) > 1:
            raise (place / kinds[1]).error(f"expected one of fog, rain and snow, got {kinds[0]} beside it")
        air = Atmosphere()
        for name in kinds:
            model = getattr(self, name)
            air = construct(getattr(Atmosphere, name), model, type(model).model_fields, place / name)
        keys = set(type(self).model_fields) - {"fog", "rain", "snow"}
        return construct(partial(dataclasses.replace, air), self, keys, place)


class SceneDocument(Model):
    """A scene in a separate file; its objects are checked with the run."""

    scene: list[object] | dict[str, object]
    class_names: dict[str, str] = {}
    atmosphere: object = None


class Config(Model):
    """A run: scene, sensor or rig, pose and frames."""

    scene: AnyScene
    class_names: dict[str, str] = {}
    atmosphere: Air | None = None
    sensor: AnySensor | None = None
    rig: dict[str, Mounted] | None = None
    pose: PoseOfRun = Pose()
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    first_frame: Annotated[int, Field(ge=0, lt=2**32)] = 0
    frames: Annotated[int, Field(ge=1, le=2**32)] = 1
    cloud: Cloud = Cloud()
    georeference: Georeference = Georeference()
