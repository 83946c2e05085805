"""What the commands print of sensors, scenes and packets."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

import lidarsim as ls
from lidarsim._base.shown import format_size, plain, quantity
from lidarsim._base.terminal import facts, paragraph, print_line, progress_bar, table
from lidarsim.config.units import argument_of
from lidarsim.io import packets
from lidarsim.patterns import describe
from lidarsim.run import Run

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.comparison import Contrast, Measure
    from lidarsim.io.scenes import Imported


Item = TypeVar("Item")
NAME = 60
"""Maximum characters of a name in a table."""


def print_sent(to: str, sent: packets.Sent, period: float | None) -> None:
    """Print what was sent, and whether scanning was slower than a sensor with frames of that period, s."""
    ports = ", ".join(map(str, sorted(sent.ports)))
    late = "" if period is None else f", largest lag {1e3 * sent.lag:.3g} ms"
    paragraph(
        f"{quantity(sent.packets, 'packet')} ({sent.size / 1e6:,.3g} MB) to {to}, {quantity(len(sent.ports), 'port')}"
        f" {ports} in {sent.seconds:.2f} s: {sent.rate:,.0f} packets/s, {sent.dropped:,} dropped{late}"
    )
    if period is not None and sent.lag > period and sent.span:
        paragraph(
            f"the sensor is faster than this machine scans: {sent.span:.2f} s of it took {sent.seconds:.2f} s;"
            " packets were late, none was left out"
        )


def print_others(run: Run) -> None:
    """Print the IMUs and GNSS receivers of a rig, with their errors."""
    units = {"gyroscope": "rad/s", "accelerometer": "m/s²"}
    for name, imu in run.imus.items():
        turns = "" if imu.latitude is None else f", Earth rotation at latitude {np.degrees(imu.latitude):.6g}°"
        print_line(f"{name}: IMU, {imu.rate:g} Hz, {_at(imu.mount)}, gravity {imu.gravity:.7g} m/s²{turns}")
        for kind, unit in units.items():
            errors = getattr(imu, kind)
            named = {
                "noise density": (errors.noise_density, f"{unit}/√Hz"),
                "bias instability": (errors.bias_instability, unit),
                "random walk": (errors.random_walk, f"{unit}/s/√Hz"),
                "bias": (errors.bias, unit),
                "scale factor": (errors.scale_factor, ""),
                "misalignment": (errors.misalignment, "rad"),
            }
            told = [f"{what} {value:.4g} {of}".rstrip() for what, (value, of) in named.items() if value]
            if np.isfinite(errors.range):
                told.append(f"range ±{errors.range:.4g} {unit}")
            print_line(f"  {kind}: {', '.join(told) or 'no errors'}")
    for name, gnss in run.receivers.items():
        given = {"noise": gnss.position_sigma, "drift": gnss.drift_sigma}
        told = [f"{what} {_sigmas(sigma)} m" for what, sigma in given.items() if np.any(sigma)]
        print_line(f"{name}: GNSS receiver, {gnss.rate:g} Hz, {_at(gnss.mount)}, {', '.join(told) or 'no errors'}")


def _at(mount: Floats) -> str:
    """Return where a sensor is on its body."""
    return f"at {', '.join(f'{value:.4g}' for value in mount[:3, 3].tolist())} m"


def _sigmas(values: Any) -> str:
    """Return the standard deviations of three axes, or the one of all."""
    told = [f"{value:.4g}" for value in np.broadcast_to(values, 3).tolist()]
    return told[0] if len(set(told)) == 1 else ", ".join(told)


MOST_NAMES = 10
"""Maximum names in a line."""


OBJECT = ("object", "shape", "name", "label", "reflectivity")
MORE = ("triangles", "size, m", "degenerate", "moves")
"""Columns of a table of objects, and those that it has if an object has a value."""
WHOLE = ("shape", "reflectivity", "size, m")
"""Columns that are not wrapped."""
MOST_OBJECTS = 100
"""Maximum rows of a table of objects: a street has thousands."""


def print_import(file: Imported) -> None:
    """Print what a scene file brought in, what it did not, and which nodes no rule matched."""
    meshes = (item.shape for item in file.objects if isinstance(item.shape, ls.TriangleMesh))
    triangles = quantity(sum(map(len, meshes)), "triangle")
    extent = format_size(np.ptp(file.bounds, axis=0))
    instances = quantity(len({instance for _, instance in file.instances(0)}), "instance")
    paragraph(f"{file.path}: {quantity(len(file.objects), 'object')}, {instances}, {triangles}, {extent} m")
    for what, names in (
        ("materials", Counter(item.material_name for item in file.objects if item.material_name)),
        ("labels", Counter(str(item.label) for item in file.objects if item.label is not None)),
    ):
        if names:
            paragraph(
                f"  {what}: {format_list([f'{plain(name, most=NAME)} ({count})' for name, count in names.items()])}"
            )
    if file.left_out:
        paragraph(f"  left out: {', '.join(file.left_out)}")
    if file.skipped:
        paragraph(f"  skipped by rules: {quantity(file.skipped, 'part')}")
    if file.without_rule:
        paths = [plain(path, most=NAME) for path in file.without_rule]
        paragraph(f"  no rule matches {quantity(len(paths), 'node')}: {format_list(paths)}")


def format_list(names: list[str]) -> str:
    """Return the first names, and how many there are beside them."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {more:,} more" if more > 0 else "")


def track(items: Iterable[Item], count: int) -> Iterator[Item]:
    """Yield the items, with a progress bar if stderr is a terminal."""
    with progress_bar() as progress:
        yield from progress.track(items, total=count, description="reading")


def format_span(ends: Iterable[float], *, digits: int = 4) -> str:
    """Return the ends of an interval, or the one value that it has."""
    low, high = (f"{end:.{digits}g}" for end in ends)
    return low if low == high else f"{low} … {high}"


def format_measured(preset: Mapping[str, Any]) -> dict[str, str]:
    """Return the values in the ``measured`` block of a preset's document, by their keys there."""
    block = dict(preset.get("measured", {}))
    effects = {f"measurement.{key}": value for key, value in block.pop("measurement", {}).items()}
    return {key: _yaml_line(value) for key, value in (effects | block).items()}


def _yaml_line(value: object) -> str:
    """Return a plain value as YAML has it on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_yaml_line(item)}" for key, item in value.items()) + "}"
    return str(value)


def format_fit(start: ls.Lidar, lidar: ls.Lidar, comparison: ls.Comparison, base: Mapping[str, str]) -> str:
    """Return a fitted sensor as YAML: what it starts from, and the values that differ, with their intervals."""
    measures = {measure.name: measure for measure in comparison}
    lines = [
        f"# {start.name}, fitted to {plain(comparison.real)}. In comments: 95 % intervals, numbers of samples.",
        *(f"{key}: {value}" for key, value in base.items()),
    ]
    if lidar.measurement != start.measurement:
        lines += ["measurement:", *_differences(start.measurement, lidar.measurement, measures, "")]
    if lidar.min_range != start.min_range:
        lines.append(f"min_range_m: {lidar.min_range:.6g}{_interval(measures['min_range'])}")
    left = [f"# Left: {measure.name}: {measure.why}." for measure in comparison if measure.verdict == "not measured"]
    return "\n".join([*lines, *left]) + "\n"


def _differences(old: Any, new: Any, measures: Mapping[str, Measure], above: str) -> Iterator[str]:
    """Yield the lines of the values of a measurement, or a part of it, that differ."""
    indent = "  " * (above.count(".") + 1)
    for key in type(new).configuration:
        name = argument_of(key)
        before, after = getattr(type(new) if old is None else old, name, None), getattr(new, name)
        if before == after:
            continue
        if hasattr(after, "configuration"):
            yield f"{indent}{key}:"
            yield from _differences(before, after, measures, f"{above}{name}.")
        else:
            measure = measures.get(above + name)
            told = measure is not None and measure.verdict != "not measured"
            if measure is not None and isinstance(after, tuple):
                yield f"{indent}{key}:"
                for (at, value), cell in zip(after, measure.cells, strict=True):
                    yield f"{indent}- [{at!r}, {value!r}]{_interval(cell)}"
            else:
                value = list(after) if isinstance(after, tuple) else after
                yield f"{indent}{key}: {value!r}{_interval(measure) if measure and told else ''}"


def _interval(of: Contrast) -> str:
    """Return the interval of a value, and the number of its samples, as a comment."""
    return "  # {:.4g} to {:.4g}; {:,}".format(*of.real_interval, of.n_real)


def format_times(span: tuple[float, float]) -> str:
    """Return an interval of time, s."""
    return "always" if math.isinf(span[0]) else f"{format_span(span, digits=12)} s"


def print_objects(scene: ls.Scene) -> None:
    """Print a table of the first objects of a scene, and count the others by name.

    Sizes of meshes are along their own axes.
    """
    rows: list[dict[str, object]] = []
    objects = list(scene)
    for item in objects[:MOST_OBJECTS]:
        row: dict[str, object] = {
            "object": item.id,
            "shape": type(item.shape).__name__,
            "name": plain(item.name, most=NAME),
            "label": "by face" if isinstance(item.label, np.ndarray) else item.label,
            "reflectivity": item.material.reflectivity if item.material.per == "object" else f"by {item.material.per}",
        }
        if isinstance(item.shape, ls.TriangleMesh):
            scale = np.ones(3) if item.transform is None else np.linalg.norm(item.transform[:3, :3], axis=0)
            row["triangles"] = len(item.shape)
            row["size, m"] = format_size(np.ptp(item.shape.bounds, axis=0) * scale)
            if item.shape.degenerate_count:
                row["degenerate"] = item.shape.degenerate_count
        if item.motion:
            row["moves"] = format_times(item.motion.span)
        rows.append(row)
    columns = [*OBJECT, *(name for name in MORE if any(name in row for row in rows))]
    table(columns, [[row.get(name) for name in columns] for row in rows], left=("shape", "name"), whole=WHOLE)
    if others := Counter((item.name or "without a name").partition("/")[0] for item in objects[MOST_OBJECTS:]):
        names = [f"{plain(name, most=NAME)} ({count:,})" for name, count in others.most_common()]
        paragraph(f"and {quantity(others.total(), 'more object')}: {format_list(names)}")


def describe_terrain(number: int, mesh: ls.TriangleMesh) -> str:
    """Return the size, the holes, the extent and the coordinate reference system of a mesh of heights."""
    rows, columns = mesh.grid or (0, 0)
    holes = rows * columns - len(mesh.vertices)
    x, y, z = (format_span(ends, digits=10) for ends in mesh.bounds.T)
    crs = f", {plain(mesh.crs, most=NAME)}" if mesh.crs else ""
    return (
        f"object {number}: heights in {quantity(rows, 'row')} and {quantity(columns, 'column')},"
        f" {quantity(holes, 'hole')}; x {x} m, y {y} m, z {z} m{crs}"
    )


def _air(air: ls.Atmosphere, lidar: ls.Lidar) -> str:
    """Return what echoes of the air a sensor gets in front of no surface."""
    seen = []
    if echo := air.fog_echo(lidar):
        seen.append(f"on average an echo of intensity {echo[1]:.3g} at {echo[0]:.3g} m")
        if lidar.measurement.near_threshold:
            seen.append(f"{air.patches_seen(lidar):.3g} detected echoes of fog per pulse")
    if air.intercept:
        seen.append(f"{air.particles_seen(lidar):.3g} echoes of drops or flakes per pulse")
    return " and ".join(seen) or "without echoes"


def print_depth(name: str, lidar: ls.Lidar, scene: ls.Scene) -> None:
    """Print how many materials transmit or mirror light that the sensor does not follow."""
    materials = {item.material for item in scene if item.material.transmission + item.material.mirror > 0.0}
    found = {
        "transmit": sum(material.transmission > 0.0 for material in materials),
        "mirror": sum(material.mirror > 0.0 for material in materials),
    }
    if lidar.measurement.depth == 1 and any(found.values()):
        does = " and ".join(
            f"{quantity(count, 'material')} {does}{'s' if count == 1 else ''}" for does, count in found.items() if count
        )
        whose = f"{name}: " if name else ""
        paragraph(f"{whose}{does}, but depth is 1: give the measurement a depth of 2 or more to see what is behind")


def print_sensor(lidar: ls.Lidar, air: ls.Atmosphere | None = None) -> None:
    """Print the properties of a sensor, and what it sees of the air, one per line."""
    does = describe(lidar.pattern)
    seconds = does.time[1] - does.time[0]
    exact = ls.Measurement()
    effects = {field.name: getattr(lidar.measurement, field.name) for field in dataclasses.fields(exact)}
    effects = {name: value for name, value in effects.items() if value != getattr(exact, name)}
    if lidar.measurement.max_returns == 1 and effects.get("returns") not in {None, "first", "last", 1}:
        effects["returns"] = f"{effects['returns']} (one: a pulse has one echo without a beam)"
    lines = {
        "pattern": f"{type(lidar.pattern).__name__}, {'the same' if does.repeats else 'another'} in each frame",
        "rings, columns": f"{does.rings:,}, {does.columns:,}",
        "rate": f"{does.pulses_per_second:,.0f} pulses/s at {lidar.pattern.rate:g} Hz",
        "azimuth": f"{format_span(np.degrees(does.azimuth))} °",
        "elevation": f"{format_span(np.degrees(does.elevation))} °",
        "ring to ring": f"{format_span(np.degrees(does.elevation_gap))} °",
        "pulse to pulse": f"{format_span(np.degrees(does.pulse_gap))} °",
        "time": f"{1e3 * seconds:.4g} ms from first to last pulse, longest pause {1e3 * does.pause:.4g} ms",
        "range": f"{format_span((lidar.min_range, lidar.max_range))} m",
        "measurement": ", ".join(f"{name} {value}" for name, value in effects.items()) or "exact",
    }
    if air:
        lines["air"] = f"{air}, {_air(air, lidar)}"
    known = {name: value for name, value in lines.items() if "nan" not in value}
    facts({"sensor": lidar.name or "(no name)", **known})
