"""From a YAML file to a run: read, merge, override, check, build."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

import pydantic
import yaml

from lidarsim._base.files import noting_reads
from lidarsim._base.validation import short_repr
from lidarsim.config.document import (
    Loaded,
    Node,
    Place,
    entries,
    merge,
    node_of,
    parse_assignment,
    plain,
    read,
    replace,
    without,
)
from lidarsim.config.factories import Model
from lidarsim.config.objects import World
from lidarsim.config.poses import Drive, Stations, Strips, build_pose
from lidarsim.config.schema import Config, SceneDocument, names_by_label
from lidarsim.config.sensors import Sensor, VendorSensor, build_rig
from lidarsim.config.starter import configuration
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.io.raster import same_crs
from lidarsim.io.scenes import Imported
from lidarsim.lidar import OWN, PRESETS, Lidar, kind_of, preset_path
from lidarsim.motion.georeference import projected_crs
from lidarsim.motion.trajectory import Trajectory
from lidarsim.rig import Rig
from lidarsim.run import Leg, Run
from lidarsim.world.atmosphere import check_sensor
from lidarsim.world.scene import Scene

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

    from lidarsim._base.validation import Floats
    from lidarsim.config.objects import AnyObject
    from lidarsim.worlds import Ways


M = TypeVar("M", bound=Model)

# These keys choose what a document includes, so they are overridden first, and all others once it is complete.
ALTERNATIVES = {"columns": "column_period_us", "column_period_us": "columns"}
"""Keys of a pattern that state the same quantity: a change to one replaces the other."""
CHOICES = re.compile(r"rig(\.[^.]+(\.sensor)?)?|sensor|(rig\.[^.]+\.)?sensor\.(preset|file|mode|noise)|scene(\.file)?")

NEEDED_IN_AIR = {
    "near_threshold": ("measurement.near_threshold", ""),
    "min_range": ("min_range_m", ""),
    "detection": ("measurement.detection", ""),
}
"""Keys of a sensor that fog, rain or snow may need, by argument."""

Change = tuple[list[str], Node]
"""Path of a value in a document, as keys and indices, and its new value."""


def load(path: Path, overrides: Sequence[str]) -> Run:
    """Return the run that a file describes; see `lidarsim.config.load`."""
    if isinstance(overrides, str) or not isinstance(overrides, Sequence):
        raise ArgumentTypeError("overrides", "a sequence of assignments", short_repr(overrides))
    for i, text in enumerate(overrides):
        if not isinstance(text, str):
            raise ArgumentTypeError("overrides", "texts such as 'frames=2'", f"overrides[{i}] = {short_repr(text)}")
    with noting_reads() as sources:
        run = build_run(whole(read(configuration(path)), [parse_assignment(text) for text in overrides]))
    return dataclasses.replace(run, sources=frozenset(sources))


def whole(root: Node, changes: Iterable[Change] = ()) -> Node:
    """Return the document of a run with its files and presets included and `changes` applied."""
    later = []
    for path, value in changes:
        if CHOICES.fullmatch(".".join(path)):
            root = assign(root, path, value)
        else:
            later.append((path, value))
    root = _include(root)
    for path, value in later:
        root = replace(_without_alternative(root, path), path, value)
    return root


def assign(root: Node, path: list[str], value: Node) -> Node:
    """Return `root` with a value replaced; a file replaces a scene without one as a whole."""
    if path[-2:] == ["scene", "file"]:
        scene: Node | None = root
        for key in path[:-1]:
            scene = entries(scene).get(key, (None, None))[1]
        if "file" not in entries(scene):
            root = replace(root, path[:-1], node_of({}, value))
    return replace(root, path, value)


def _without_alternative(root: Node, path: Sequence[str]) -> Node:
    """Return `root` without the key of a pattern that the key at `path` stands in for."""
    *above, key = path
    if above[-1:] != ["pattern"] or key not in ALTERNATIVES:
        return root
    pattern: Node | None = root
    for name in above:
        found = entries(pattern)
        pattern = found[name][1] if name in found else None
    if ALTERNATIVES[key] not in entries(pattern):
        return root
    return replace(root, above, without(cast("Node", pattern), ALTERNATIVES[key]))


def build_run(root: Node, loaded: Loaded | None = None) -> Run:
    """Return the run that a complete document describes; `loaded` caches the objects that it loads from files."""
    config, place = validate(Config, root), Place(root, (), {} if loaded is None else loaded)
    if config.first_frame + config.frames > 2**32:
        raise (place / "frames").error(f"expected at most 4294967296 with first_frame, got {config.frames}")
    where = place / "georeference"
    crs, start = config.georeference.build(where)
    origin = None if config.georeference.origin is None else config.georeference.origin.build(where / "origin")
    scene, ways = _scene(config, place)
    if crs is not None:
        _check_crs(crs, scene, where / "crs")
    sensor = _sensor_or_rig(config, place)
    _check_air(scene, sensor, place)
    receivers = sensor.receivers if isinstance(sensor, Rig) else {}
    if crs is not None and config.cloud.frame != "world" and not receivers:
        raise (where / "crs").error("expected points in the world, with cloud.frame: world")
    for name in receivers if crs is None and origin is None else ():
        raise (place / "rig" / name / "gnss").error("expected a georeference with the origin or the crs of the world")
    frames = range(config.first_frame, config.first_frame + config.frames)
    legs = _legs(config, sensor, frames, place)
    if isinstance(config.pose, Strips | Stations):
        pose, frames = legs[0].pose, range(legs[0].frames.start, legs[-1].frames.stop)
    elif isinstance(config.pose, Drive):
        pose = config.pose.build(place / "pose", ways)
    else:
        pose = build_pose(config.pose, place / "pose")
    if isinstance(config.scene, World):
        _carry(config.scene.vehicle, None if legs else pose, scene, place / "scene" / "vehicle")
    return Run(
        scene=scene,
        sensor=sensor,
        pose=pose,
        seed=config.seed,
        frames=frames,
        cloud=config.cloud.build(place / "cloud"),
        imports=place.find_loaded(Imported),
        crs=crs,
        start=start,
        origin=origin,
        legs=legs,
        ways=ways,
    )


def _legs(config: Config, sensor: Lidar | Rig, frames: range, place: Place) -> tuple[Leg, ...]:
    """Return the strips or stations of a run, if it has some."""
    legs: tuple[Leg, ...] = ()
    if isinstance(config.pose, Strips):
        for key in ("frames", "first_frame"):
            if key in config.model_fields_set:
                raise (place / key).error("expected none, since the strips are as long as their area")
        legs = config.pose.build(place / "pose", sensor)
    elif isinstance(config.pose, Stations):
        legs = config.pose.build(place / "pose", frames)
        if isinstance(sensor, Rig):
            for name, part in sensor.items():
                if not all(sensor._numbers(part, leg.frames.start, leg.frames.stop) for leg in legs):
                    least = math.ceil(sensor.rate / part.lidar.pattern.rate)
                    expected = f"expected at least {least} frames at each station, so that {name} scans there"
                    raise (place / "frames").error(f"{expected}, got {config.frames}")
    if legs and legs[-1].frames.stop > 2**32:
        raise (place / "pose").error(f"expected frames up to number 4294967295, got {legs[-1].frames[-1]}")
    return legs


def _scene(config: Config, place: Place) -> tuple[Scene, Ways | None]:
    """Return the scene, and the ways of a street."""
    names, there, ways = names_by_label(config.class_names, place / "class_names"), place / "scene", None
    if isinstance(config.scene, World):
        street = config.scene.street.build(there / "street")
        scene, ways, items, there = street.scene, street.ways, config.scene.objects, there / "objects"
        scene._class_names.update(names)
    else:
        scene, items = Scene(class_names=names), config.scene
    for index, item in enumerate(items):
        item.add_to(scene, there / index)
    if config.atmosphere is not None:
        scene.atmosphere = config.atmosphere.build(place / "atmosphere")
    return scene, ways


def _check_air(scene: Scene, sensor: Lidar | Rig, place: Place) -> None:
    """Raise `ConfigError` if a sensor lacks what it needs in the air of the scene."""
    if isinstance(sensor, Rig):
        lidars = [(place / "rig" / name / "sensor", part.lidar) for name, part in sensor.items()]
    else:
        lidars = [(place / "sensor", sensor)]
    for where, lidar in lidars:
        with where.refusals(NEEDED_IN_AIR):
            check_sensor(scene.atmosphere, lidar)


def _check_crs(crs: int | str, scene: Scene, place: Place) -> None:
    """Raise `ConfigError` if a raster is in another system; its heights may be above another surface."""
    level = projected_crs(crs).to_2d().to_wkt()
    for item in scene:
        other = getattr(item.shape, "crs", None)
        if other and not same_crs(level, other):
            raise place.error(f"expected the system of object {item.id}, {short_repr(other)}, got {short_repr(crs)}")


def _carry(items: list[AnyObject], pose: Floats | Trajectory | None, scene: Scene, place: Place) -> None:
    """Add objects that move along with the sensor."""
    for index, item in enumerate(items):
        if not isinstance(pose, Trajectory):
            raise place.error("expected none, since the sensor does not move along one trajectory")
        if item.motion is not None:
            raise (place / index / "motion").error("expected none, since the object moves along with the sensor")
        carried = Scene()
        item.add_to(carried, place / index)
        instance = len(scene) + 1 if item.instance is None else item.instance
        for part in carried:
            keys = ("name", "label", "material", "transform")
            more = {key: getattr(part, key) for key in keys}
            scene.add(part.shape, motion=pose, instance=instance, **more)


def read_scene(path: Path) -> Scene:
    """Return the scene that a file describes: a list of objects, or a configuration with one."""
    root = read(path)
    root = replace(None, ["scene"], root) if isinstance(root, yaml.SequenceNode) else _include(root)
    return _scene(validate(Config, root), Place(root))[0]


def _sensor_or_rig(config: Config, place: Place) -> Lidar | Rig:
    if config.sensor is not None and config.rig is not None:
        raise (place / "rig").error("expected either sensor or rig, got both")
    if config.rig is not None:
        return build_rig(config.rig, place / "rig")
    if config.sensor is not None:
        return config.sensor.build(place / "sensor")
    raise place.error("missing key 'sensor' or 'rig'")


def read_lidar(path: Path, *, mode: str | None, noise: str | None) -> Lidar:
    """Return the sensor that a file describes; see `lidarsim.config.read_lidar`."""
    document = _preset(path) if path.parent == PRESETS else read(path)
    root = _variant(_sensor(document, Place(document)), mode, noise)
    if "file" in entries(root):
        return validate(VendorSensor, root).build(Place(root))
    return validate(Sensor, root).build(Place(root))


_preset = cache(read)
"""Read a preset once: neither its file nor its nodes ever change."""


def _include(root: Node) -> Node:
    """Return `root` with its files and presets included."""
    found, place = entries(root), Place(root)
    if "sensor" in found:
        root = replace(root, ["sensor"], _sensor(found["sensor"][1], place / "sensor"))
    for name, (_, mounted) in entries(found["rig"][1] if "rig" in found else None).items():
        if "sensor" in entries(mounted):
            sensor = _sensor(entries(mounted)["sensor"][1], place / "rig" / name / "sensor")
            root = replace(root, ["rig", name, "sensor"], sensor)
    if "scene" in found and (file := _text(found["scene"][1], "file", place / "scene")) is not None:
        root = _with_scene(root, read((place / "scene" / "file").file(file)))
        for path, value in _leaves(without(found["scene"][1], "file")):
            root = replace(root, ["scene", *path], value)
    return root


def _leaves(node: Node) -> Iterator[Change]:
    """Yield the paths and values in a mapping, and in the mappings in it."""
    for key, (_, value) in entries(node).items():
        if isinstance(value, yaml.MappingNode):
            yield from (([key, *path], below) for path, below in _leaves(value))
        else:
            yield [key], value


def _with_scene(root: Node, scene: Node) -> Node:
    """Return `root` with the scene of a file: a list of objects, or a mapping with the list and class names."""
    if isinstance(scene, yaml.SequenceNode):
        return replace(root, ["scene"], scene)
    validate(SceneDocument, scene)
    found, own = entries(scene), entries(root)
    if "class_names" in found:
        names = found["class_names"][1]
        root = replace(root, ["class_names"], merge(names, own["class_names"][1]) if "class_names" in own else names)
    if "atmosphere" in found and "atmosphere" not in own:
        root = replace(root, ["atmosphere"], found["atmosphere"][1])
    return replace(root, ["scene"], found["scene"][1])


def _sensor(node: Node, place: Place, above: tuple[Path, ...] = ()) -> Node:
    """Return the sensor `node` merged with its preset or file, mode and noise; a vendor's file stays a ``file``."""
    if not isinstance(node, yaml.MappingNode):
        raise place.error(f"expected a mapping with preset, file or pattern, got {_describe(plain(node))}")
    preset, file, mode, noise = (_text(node, key, place) for key in ("preset", "file", "mode", "noise"))
    if preset is not None and file is not None:
        raise (place / "file").error("expected a preset or a file, got both")
    difference: Node | None = without(node, "preset", "file", "mode", "noise")
    if preset is not None:
        with (place / "preset").refusals({"preset": ("", "")}):
            base = replace(_preset(preset_path(preset)), ["model"], entries(node)["preset"][1])
    elif file is not None:
        path = (place / "file").file(file)
        if kind_of(path) != OWN:
            return node
        if path.resolve() in above:
            raise (place / "file").error("expected another file, got one that includes this one")
        included = read(path)
        base = _sensor(included, Place(included), (*above, path.resolve()))
    elif "pattern" in entries(node):
        base, difference = without(node, "mode", "noise"), None
    else:
        raise place.error("expected one of the keys preset, file, pattern, got none of them")
    with place.refusals({"mode": ("mode", ""), "noise": ("noise", "")}):
        base = _variant(base, mode, noise)
    if difference is None:
        return base
    own = entries(difference)
    for key in entries(own["pattern"][1]) if "pattern" in own else ():
        base = _without_alternative(base, ["pattern", key])
    return merge(base, difference)


def _variant(sensor: Node, mode: str | None, noise: str | None) -> Node:
    """Return `sensor` in one of its modes, with its datasheet or measured noise if requested."""
    found = entries(sensor)
    if mode is not None:
        modes = entries(found["modes"][1]) if "modes" in found else {}
        if not (isinstance(mode, str) and mode in modes):
            expected = f"one of {', '.join(modes)}" if modes else "none, since the sensor has no modes"
            raise ArgumentValueError("mode", expected, short_repr(mode))
        sensor = merge(sensor, modes[mode][1])
    if noise is not None and not (isinstance(noise, str) and noise in {"none", "datasheet", "measured"}):
        raise ArgumentValueError("noise", "none, datasheet or measured", short_repr(noise))
    if noise == "datasheet" and "datasheet_noise" not in found:
        raise ArgumentValueError("noise", "none, since the sensor has no datasheet_noise", "'datasheet'")
    if noise == "measured" and "measured" not in found:
        expected = "none or datasheet" if "datasheet_noise" in found else "none"
        hint = f"the presets with measured noise are {', '.join(measured_presets())}"
        raise ArgumentValueError("noise", expected, "'measured'", hint)
    if noise in {"datasheet", "measured"} and "datasheet_noise" in found:
        measurement = found["datasheet_noise"][1]
        if "measurement" in found:
            measurement = merge(found["measurement"][1], measurement)
        sensor = replace(sensor, ["measurement"], measurement)
    return merge(sensor, found["measured"][1]) if noise == "measured" else sensor


def measured_presets() -> list[str]:
    """Return the names of the presets whose files have a ``measured`` block."""
    return [name for name in Lidar.presets() if "measured" in entries(_preset(preset_path(name)))]


def _text(node: Node, key: str, place: Place) -> str | None:
    if key not in entries(node):
        return None
    value = plain(entries(node)[key][1])
    if not isinstance(value, str):
        expected = {"mode": "the name of a mode", "noise": "none, datasheet or measured"}.get(key, "text")
        raise (place / key).error(f"expected {expected}, got {_describe(value)}")
    return value


def validate(model: type[M], root: Node) -> M:
    """Return `root` as `model`; the error names the first problem in the file and counts the others.

    If it has none of the keys of `model`, nor one like them, it may be any file, of which the error shows nothing.
    """
    found = entries(root)
    if found and not any(key in model.model_fields or model.nearest(key) for key in found):
        raise Place(root).error(f"expected a mapping with keys {', '.join(model.model_fields)}, got others")
    try:
        return model.model_validate(plain(root))
    except pydantic.ValidationError as invalid:
        start = Place(root)
        problems = [_problem(start.at(tuple(error["loc"])), error) for error in invalid.errors()]
        place, problem = min(problems, key=lambda item: item[0].order)
        count = len({str(where.error(what)) for where, what in problems})
        more = f" (and {count - 1} more)" if count > 1 else ""
        raise place.error(problem + more) from None


_EXPECTED = {
    "bool_type": "true or false",
    "dict_type": "a mapping",
    "finite_number": "a finite number",
    "float_type": "a number",
    "greater_than": "a value > {gt}",
    "greater_than_equal": "a value >= {ge}",
    "int_from_float": "an integer",
    "int_type": "an integer",
    "less_than": "a value < {lt}",
    "less_than_equal": "a value <= {le}",
    "list_type": "a list",
    "literal_error": "{expected}",
    "model_attributes_type": "a mapping",
    "model_type": "a mapping with keys {keys}",
    "string_type": "text",
    "too_long": "at most {max_length} items",
    "too_short": "at least {min_length} items",
}


def _problem(place: Place, error: ErrorDetails) -> tuple[Place, str]:
    """Return the place of pydantic's `error`, and its message in lidarsim's words."""
    kind, context, got = error["type"], error.get("ctx", {}), error["input"]
    if kind == "missing":
        return place, f"missing key {error['loc'][-1]!r}"
    if kind == "unknown_key":
        return place / context["key"], error["msg"]
    if kind == "union_tag_not_found":
        return place, f"missing key {context['discriminator']}"
    if kind == "union_tag_invalid":
        key = context["discriminator"].strip("'")
        return place / key, f"expected one of {context['expected_tags']}, got {_describe(got[key])}"
    if kind in _EXPECTED:
        keys = ", ".join(_keys_of(Model, context["class_name"])) if kind == "model_type" else ""
        return place, f"expected {_EXPECTED[kind].format(keys=keys, **context)}, got {_describe(got)}"
    return place, error["msg"]


def _keys_of(base: type[Model], name: str) -> Iterator[str]:
    """Yield the keys of the model `name`."""
    for model in base.__subclasses__():
        yield from model.model_fields if model.__name__ == name else _keys_of(model, name)


def _describe(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, bool):
        return str(value).lower()
    return short_repr(value)
