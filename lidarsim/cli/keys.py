"""The reference of YAML keys, made from the models that read them: ``lidarsim check --keys SECTION``."""

from __future__ import annotations

import ast
import difflib
import inspect
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from lidarsim import materials, worlds
from lidarsim._base.validation import short_repr
from lidarsim.config import objects, poses, schema, sensors
from lidarsim.config.units import argument_of, in_si, unit_of
from lidarsim.datasets import draws, layouts, recipe
from lidarsim.datasets.layouts import _layout, kitti
from lidarsim.datasets.scatter import Scatter, _instances
from lidarsim.errors import LidarsimError
from lidarsim.motion.trajectory import Trajectory
from lidarsim.sensor.gnss import Gnss
from lidarsim.sensor.imu import Imu, ImuErrors
from lidarsim.world.atmosphere import Atmosphere


@dataclass(frozen=True)
class Section:
    """The keys of a model.

    Attributes
    ----------
    model : type of Model
        The model.
    constructor : callable, optional
        What documents the keys that the model itself does not document. Default: what the model constructs.
    base : type of Model, optional
        A model whose keys have a section of their own.
    """

    model: type[BaseModel]
    constructor: Callable[..., Any] | None = None
    base: type[BaseModel] | None = None

    @property
    def documented(self) -> Any:
        """What documents the keys that the model itself does not document."""
        return self.constructor or getattr(self.model, "constructor", self.model)

    @property
    def fields(self) -> dict[str, FieldInfo]:
        """The keys and their fields."""
        shared = self.base.model_fields.keys() - self.model.__annotations__.keys() if self.base else set()
        return {key: field for key, field in self.model.model_fields.items() if key not in {*shared, "shape", "type"}}


def _model_at(model: type[BaseModel], key: str) -> Section:
    """Return the section of the model that a key of another model takes."""
    kinds = [model.model_fields[key].annotation]
    for kind in kinds:
        if inspect.isclass(kind) and issubclass(kind, BaseModel):
            return Section(kind)
        kinds.extend(get_args(kind))
    raise AssertionError(key)


class _Sensor(sensors.Sensor):
    __doc__ = sensors.Sensor.__doc__

    preset: str = ""
    """Preset to start from, instead of a `pattern`: one of those that `lidarsim sensors` lists."""
    mode: str = ""
    """One of the modes of the preset."""
    noise: Literal["none", "datasheet", "measured"] = "none"
    """Noise of the preset: none, that of the data sheet, or that of real units."""


GROUPS: dict[str, dict[str, Section]] = {
    "A run": {
        "run": Section(schema.Config),
        "cloud": Section(schema.Cloud),
        "georeference": Section(schema.Georeference),
        "atmosphere": Section(schema.Air, Atmosphere),
    },
    "Poses": {
        "pose": Section(poses.Pose),
        "waypoint": Section(poses.Waypoint, base=poses.Placement),
        "poses": Section(poses.TrajectoryFile, base=poses.Placement),
        "strips": Section(poses.Plan, Trajectory.strips),
        "stations": Section(poses.Stations, base=poses.Placement),
        "way": Section(poses.Drive, base=poses.Placement),
    },
    "Scenes": {
        "scene": Section(objects.World),
        "street": Section(objects.StreetKeys, worlds.street),
        "object": Section(objects.Object, materials.Material),
        "motion": Section(poses.Twist),
        **{
            name: Section(model, getattr(model, "generator", None), objects.Object)
            for name, model in sorted(objects.SHAPES.items())
        },
        "rule": Section(objects.SceneRule),
    },
    "Sensors": {
        "sensor": Section(_Sensor),
        "file": Section(sensors.VendorSensor),
        "measurement": Section(sensors.Effects),
        **{name: _model_at(sensors.Effects, name) for name in ("detection", "beam", "response")},
        **{name: Section(model) for name, model in sorted(sensors.PATTERNS.items())},
        "prism": _model_at(sensors.PATTERNS["risley"], "prisms"),
        "rig": Section(sensors.Mounted, base=poses.Placement),
        "imu": Section(sensors.InertialUnit, Imu),
        "gyroscope": Section(sensors.Gyroscope, ImuErrors),
        "accelerometer": Section(sensors.Accelerometer, ImuErrors),
        "gnss": Section(sensors.Receiver, Gnss),
    },
    "Data sets": {
        "recipe": Section(recipe.Settings),
        "draw": Section(draws.Draw),
        "scatter": Section(Scatter),
        "compound": Section(_instances.Compound, base=poses.Placement),
        "walker": Section(_instances.Walker, base=objects.Object),
        **{name: Section(model) for name, model in sorted(layouts.LAYOUTS.items())},
        "boxes": Section(_layout.BoxFilter),
        "camera": Section(kitti.Camera),
    },
}
SECTIONS = {name: section for group in GROUPS.values() for name, section in group.items()}

EXAMPLES = {
    "run": "scene: [{shape: plane, normal: [0, 0, 1]}]\nsensor: {preset: ouster-os1-64}\n"
    "pose: {position_m: [0, 0, 1.8]}\nseed: 7",
    "cloud": "{frame: world, deskew: middle}",
    "georeference": "origin: {latitude_deg: 48.137, longitude_deg: 11.575, altitude_m: 520}\n"
    "start: 2026-05-01T10:00:00+02:00",
    "atmosphere": "{rain: {rate_mm_per_h: 20}, label: 99}",
    "pose": "{position_m: [0, 0, 1.8], rotation_deg: {yaw: 90}, linear_m_per_s: [8, 0, 0]}",
    "waypoint": "{time_s: 2.5, position_m: [10, 0, 1.8]}",
    "poses": "{file: poses.txt, times: times.txt, axes: camera, position_m: [0, 0, 1.65]}",
    "strips": "{area_m: [0, 0, 1000, 800], height_m: 600, speed_m_per_s: 60, overlap: 0.3, field_of_view_deg: 60}",
    "stations": "stations: [{position_m: [0, 0, 0]}, {position_m: [12, 5, 0]}]\nposition_m: [0, 0, 1.6]",
    "way": "{way: lanes, number: 0, start_m: 40, speed_m_per_s: 8, position_m: [0, 0, 1.73]}",
    "scene": "street: {kind: city, seed: 3}\nobjects: [{shape: vehicle, kind: bus, position_m: [0, -1.5, 0]}]",
    "street": "{kind: residential, seed: 3, length_m: 300}",
    "object": "{shape: sphere, center_m: [12, 0, 1], radius_m: 1, name: tank, label: 52, material: painted_metal}",
    "motion": "{linear_m_per_s: [8, 0, 0], angular_deg_per_s: [0, 0, 10]}",
    "box": "{shape: box, size_m: [12, 7, 5], center_m: [9, 10, 2.5]}",
    "building": "{shape: building, kind: house, seed: 4, storeys: 2}",
    "capsule": "{shape: capsule, start_m: [5, 0, 0.3], end_m: [5, 0, 1.5], radius_m: 0.3}",
    "cylinder": "{shape: cylinder, start_m: [5, 0, 0], end_m: [5, 0, 4], radius_m: 0.1}",
    "disk": "{shape: disk, center_m: [10, 0, 1], normal: [-1, 0, 0], radius_m: 0.5}",
    "disks": "{shape: disks, centers_m: [[5, 0, 1], [6, 0, 1]], normals: [[1, 0, 0], [0, 0, 1]], radii_m: 0.1}",
    "ellipsoid": "{shape: ellipsoid, center_m: [8, 0, 5], radii_m: [2.5, 2.5, 5]}",
    "furniture": "{shape: furniture, kind: lamp, seed: 1}",
    "heightfield": "{shape: heightfield, file: heights.npy, spacing_m: 0.5}",
    "mesh": "{shape: mesh, file: car.ply}",
    "pedestrian": "{shape: pedestrian, posture: walking, load: rucksack}",
    "plane": "{shape: plane, normal: [0, 0, 1], distance_m: 0}",
    "polygon": "{shape: polygon, vertices_m: [[8, -2, 0], [8, 2, 0], [8, 0, 3]]}",
    "raster": "{shape: raster, file: dem.tif, stride: 4}",
    "scene_file": "{shape: scene_file, file: town.glb, rules: [{node: 'cars/*', label: 10, instance: node}]}",
    "sphere": "{shape: sphere, center_m: [12, 3, 1], radius_m: 1}",
    "spheres": "{shape: spheres, centers_m: [[5, 0, 1], [6, 0, 1]], radii_m: [0.2, 0.3]}",
    "surfels": "{shape: surfels, file: survey.laz}",
    "tree": "{shape: tree, kind: broadleaf, seed: 2, clearance_m: 4.5}",
    "triangle": "{shape: triangle, a_m: [8, -4, 0], b_m: [8, -1, 0], c_m: [8, -2.5, 3]}",
    "vehicle": "{shape: vehicle, kind: van, seed: 7}",
    "rule": '{material: "asphalt*", label: 40, reflectivity: asphalt}',
    "sensor": "pattern: {type: spinning, elevations_deg: [-10, -5, 0], columns: 1800, rate_hz: 10}\n"
    "min_range_m: 0.5\nmax_range_m: 120\nmeasurement: {range_sigma_m: 0.02}",
    "file": "{file: metadata.json, noise: measured}",
    "measurement": "{range_sigma_m: [[10, 0.01], [100, 0.03]], range_resolution_m: 0.002, dropout: 0.01}",
    "detection": "{reflectivity: 0.1, range_m: 90}",
    "beam": "{divergence_azimuth_mrad: 3, divergence_elevation_mrad: 1.5, pulse_length_ns: 6}",
    "response": "{exponent: 0.5, limit: 255}",
    "grid": "{type: grid, azimuths_deg: [-10, 0, 10], elevations_deg: [-5, 5], rate_hz: 30}",
    "mid360": "{type: mid360}",
    "oscillating_mirror": "{type: oscillating_mirror, field_of_view_deg: 60, scan_rate_hz: 50, "
    "pulse_rate_khz: 200, rate_hz: 10}",
    "palmer": "{type: palmer, half_angle_deg: 20, scan_rate_hz: 70, pulse_rate_khz: 100, rate_hz: 10}",
    "polygon_mirror": "{type: polygon_mirror, sweep_deg: 180, field_of_view_deg: 60, line_rate_hz: 100, "
    "pulse_rate_khz: 300, rate_hz: 10}",
    "risley": "type: risley\nprisms:\n  - {rotation_rate_rpm: 7294, entry_tilt_deg: 0, exit_tilt_deg: 10}\n"
    "  - {rotation_rate_rpm: -4664, entry_tilt_deg: 10, exit_tilt_deg: 0}\n"
    "refractive_index: 1.51\npulse_rate_khz: 100\nrate_hz: 10",
    "spinning": "{type: spinning, elevations_deg: [-10, -5, 0], columns: 1800, rate_hz: 10}",
    "table": "{type: table, file: directions.csv, rate_hz: 10}",
    "prism": "{rotation_rate_hz: 121.6, entry_tilt_deg: 0, exit_tilt_deg: 10}",
    "rig": "{sensor: {file: mine.yaml}, position_m: [0, 0, 2], offset_s: 0.05}",
    "imu": "{rate_hz: 200, gyroscope: {bias_deg_per_s: 0.2}, latitude_deg: 48}",
    "gyroscope": "{noise_density_deg_per_s_per_sqrt_hz: 0.005, bias_instability_deg_per_h: 2, range_deg_per_s: 450}",
    "accelerometer": "{noise_density_m_per_s2_per_sqrt_hz: 0.001, bias_m_per_s2: 0.05, range_m_per_s2: 150}",
    "gnss": "{rate_hz: 5, position_sigma_m: [0.5, 0.5, 1], drift_sigma_m: 1.5}",
    "recipe": "sequences: 20\nframes: 40\nlayout: semantickitti\nvary: {scene.street.seed: {integer: [0, 999]}}\n"
    "splits: {train: 0.8, val: 0.2}",
    "draw": "{choice: [residential, city], weights: [3, 1]}",
    "scatter": "objects: [{shape: vehicle, kind: van}, {shape: vehicle, kind: bicycle}]\nweights: [1, 2]\non: [road]\n"
    "count: {integer: [5, 10]}\nalong: lanes\nspeed_m_per_s: {uniform: [3, 11]}\ngap_m: 4",
    "compound": 'shape: compound\nwheels: "wheel*"\nparts:\n  - {shape: box, size_m: [0.8, 0.6, 0.4]}\n'
    "  - {shape: cylinder, name: wheel, start_m: [0, -0.4, 0.2], end_m: [0, -0.35, 0.2], radius_m: 0.2}",
    "walker": "{shape: walker, height_m: 1.6, label: 30, material: cloth}",
    "bags": "{type: bags, cut: driver}",
    "kitti": "{type: kitti, boxes: [Car, Cyclist, Pedestrian]}",
    "mmdetection3d": "{type: mmdetection3d, boxes: [Car, Cyclist, Pedestrian]}",
    "nuscenes": "{type: nuscenes, key_every: 5}",
    "openpcdet": "{type: openpcdet, boxes: [Car, Cyclist, Pedestrian]}",
    "semantickitti": "{type: semantickitti}",
    "shards": "{type: shards, fields: [intensity, label], boxes: true}",
    "boxes": "{classes: [Car, Pedestrian], min_points: 5, max_range_m: 70}",
    "camera": "{width: 1242, height: 375, focal: 721.5}",
}
"""An example of each section in YAML."""

NAMES: dict[Any, str] = {bool: "true or false", int: "integer", float: "number", str: "text", NoneType: "null"}
NAMES |= {section.model: f"[{name}](#{name})" for name, section in SECTIONS.items()}
NAMES |= {poses.Strips: "[strips](#strips)", sensors.Sensor: "[sensor](#sensor)"}
UNIONS: dict[frozenset[Any], str] = {
    frozenset(kinds.values()): "[object](#object)" for kinds in (objects.SHAPES, _instances.KINDS)
}
UNIONS |= {
    frozenset(kinds.values()): ", ".join(f"[{name}](#{name})" for name in sorted(kinds))
    for kinds in (sensors.PATTERNS, layouts.LAYOUTS)
}
SYMBOLS = {"deg": "°", "sqrt_hz": "√Hz", "khz": "kHz", "hz": "Hz", "us": "µs", "s2": "s²", "s3": "s³", "m_sr": "(m·sr)"}
INTRODUCTION = """# Keys

Every key of a configuration and of a recipe, made from the code that reads it: `lidarsim check --keys SECTION` prints
one section, `--keys all` this page. [Configurations](README.md) explains how the keys go together.
"""


def page(name: str) -> str:
    """Return the reference of a section, or of ``all`` of them, in Markdown.

    Raises
    ------
    LidarsimError
        If there is no such section.
    """
    if name == "all":
        groups = (f"## {title}\n\n" + "\n".join(map(page, group)) for title, group in GROUPS.items())
        return "\n".join([INTRODUCTION, *groups, f"## Surfaces\n\n{_materials()}"])
    if name == "materials":
        return _materials()
    if name not in SECTIONS:
        known = [*SECTIONS, "materials", "all"]
        near = difflib.get_close_matches(name, known)
        hint = f"did you mean {' or '.join(near)}?" if near else f"expected one of {', '.join(known)}"
        raise LidarsimError(f"--keys: no section {short_repr(name)}; {hint}")
    section = SECTIONS[name]
    told = _meanings(section)
    rows = [
        (f"`{key}`", _value(key, field), _default(section, key, field), told.get(key, ""))
        for key, field in section.fields.items()
    ]
    example = ["```yaml", EXAMPLES[name], "```", ""] if name in EXAMPLES else []
    return "\n".join([f"### {name}", "", _about(section), "", *example, *_table("key value default meaning", rows)])


def _table(columns: str, rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table and an empty one; no lines without rows."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return [f"| {columns.replace(' ', ' | ')} |", "|---" * len(columns.split()) + "|", *lines, ""] if lines else []


def _about(section: Section) -> str:
    """Return what a section is, in a paragraph."""
    own = vars(section.model).get("__doc__") or inspect.getdoc(section.documented) or ""
    text = _paragraph(inspect.cleandoc(own).split("\n\n")[0]).removeprefix("Make ")
    also = " The keys of an [object](#object) apply, too." if section.base is objects.Object else ""
    return text[:1].upper() + text[1:] + also


def _paragraph(text: str) -> str:
    """Return a docstring's text as Markdown on one line."""
    return " ".join(text.replace("``", "`").replace("See the notes", "See `help(lidarsim.Measurement)`").split())


def _meanings(section: Section) -> dict[str, str]:
    """Return what each key means: what its model says below it, or else the documentation of the argument."""
    said: dict[str, str] = {}
    for documented in (section.documented, section.model):
        for names, text in re.findall(ENTRY, _parameters(inspect.getdoc(documented) or ""), re.MULTILINE):
            said |= dict.fromkeys(names.split(", "), text)
    found = {key: _in_unit(_paragraph(said.get(argument_of(key), said.get(key, ""))), key) for key in section.fields}
    return found | _own_meanings(section.model)


@cache
def _own_meanings(of: type[BaseModel]) -> dict[str, str]:
    """Return what a model says below its keys."""
    found: dict[str, str] = {}
    for model in reversed(of.__mro__):
        if "__annotations__" in vars(model) and model.__module__ != "pydantic.main":
            with suppress(OSError):  # a model that has no source, since it was made of a constructor
                (body,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
                for field, text in pairwise(body.body):  # type: ignore[attr-defined]
                    if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                        found[field.target.id] = _paragraph(text.value.value)  # type: ignore[attr-defined,union-attr]
    return found


ENTRY = r"^(\w+(?:, \w+)*) : .*\n((?:(?: .*)?\n?)*)"
"""A parameter of a docstring: its names and its text."""


def _parameters(doc: str) -> str:
    """Return the section of a docstring that documents parameters or attributes."""
    found = re.search(r"^(?:Parameters|Attributes)\n-+\n(.*?)(?=\n\n\w+\n-+\n|\Z)", doc, re.DOTALL | re.MULTILINE)
    return found[1] if found else ""


def _in_unit(text: str, key: str) -> str:
    """Return a text about an argument without its unit, and with angles in the unit of the key."""
    if unit_of(key) == "deg":
        for radians, degrees in {"2 pi": "360", "4 pi": "720", "pi/2": "90", "π/2": "90", "than π": "than 180"}.items():
            text = text.replace(radians, degrees)
    return (
        re.sub(r", (?:rad|m/s|m|s|Hz|1/m|1/\(m·sr\)|U(?:/s)?(?:/√Hz)?)(?=[.,;:]|$)", "", text) if unit_of(key) else text
    )


def _value(key: str, field: FieldInfo) -> str:
    """Return what a key takes, and its unit."""
    unit = unit_of(key)
    return _kind(field.rebuild_annotation()) + (f", {_symbol(unit)}" if unit else "")


def _symbol(unit: str) -> str:
    """Return the symbol of the unit of a key."""
    parts = [SYMBOLS.get(part, part) for part in re.split(r"_?per_", unit)]
    return "/".join([parts[0] or "1", *parts[1:]])


def _kind(kind: Any) -> str:
    """Return a type in words."""
    origin, inner = get_origin(kind), get_args(kind)
    models = frozenset(part for part in inner if part is not NoneType)
    if kind in NAMES or models in UNIONS:
        words = NAMES[kind] if kind in NAMES else UNIONS[models]
    elif origin is Annotated:
        words = _describe_bounds(inner[0], inner[1:])
    elif origin is Literal:
        words = " or ".join(f"`{value}`" for value in inner)
    elif origin in {list, dict}:
        words = f"{'list of' if origin is list else 'mapping to'} {_kind(inner[-1])}"
    elif inner:
        words = " or ".join(dict.fromkeys(_kind(part) for part in inner if part is not NoneType))
    elif inspect.isclass(kind) and issubclass(kind, BaseModel):
        keys = (f"{key}: {_kind(field.rebuild_annotation())}" for key, field in kind.model_fields.items())
        words = f"{{{', '.join(keys)}}}"
    else:
        words = "any"
    return words


def _describe_bounds(kind: Any, limits: Iterable[Any]) -> str:
    """Return a type with limits in words."""
    known = {
        name: value
        for limit in limits
        for part in (limit, *getattr(limit, "metadata", ()))
        for name in ("ge", "gt", "le", "lt", "min_length", "max_length")
        if (value := getattr(part, name, None)) is not None
    }
    words = _kind(kind)
    if words == "list of number" and known.get("max_length") in POINTS:
        return POINTS[known["max_length"]]
    signs = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
    return ", ".join([words, *(f"{signs[key]} {known[key]:g}" for key in signs if abs(known.get(key, 1e9)) < 1e9)])


POINTS = {2: "[a, b]", 3: "[x, y, z]", 4: "[a, b, c, d]"}


def _default(section: Section, key: str, field: FieldInfo) -> str:
    """Return the default of a key in its unit."""
    if field.is_required():
        return "required"
    value, unit = field.default, unit_of(key)
    told = "Default:" in _own_meanings(section.model).get(key, "")
    if value is None and not told and section.documented is not section.model:  # the constructor has one
        parameters = inspect.signature(section.documented).parameters
        value = getattr(parameters.get(argument_of(key)), "default", None)
        if isinstance(value, float) and unit and math.isfinite(value):
            value = round(value / float(in_si(1.0, unit)), 9)
    if value is None or value is inspect.Parameter.empty or value in ("", (), [], {}) or isinstance(value, BaseModel):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_number, value))}]"
    return _number(value)


def _number(value: object) -> str:
    """Return a number or a text of a default."""
    return f"{value:g}".replace("inf", "∞") if isinstance(value, float) else str(value)


def _materials() -> str:
    """Return the materials that a key ``material`` may name."""
    rows = []
    for name in materials.SOURCES:
        if not name.endswith("_1550"):
            here, far = materials.named(name), materials.SOURCES.get(f"{name}_1550") and materials.named(f"{name}_1550")
            values = [here.reflectivity, far.reflectivity if far else 0.0, round(math.degrees(here.roughness))]
            values += [here.transmission, here.mirror, here.variation]
            rows.append((f"`{name.lower()}`", *(f"{value:g}" if value else "" for value in values)))
    about = "Reflectivities at 905 nm and, as `NAME_1550`, at 1550 nm; `lidarsim.materials.SOURCES` cites each."
    columns = "material reflectivity 1550_nm roughness_deg transmission mirror variation"
    return "\n".join(["### materials", "", about, "", *_table(columns, rows)])
