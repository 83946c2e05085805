"""What the commands print of sensors, scenes and packets."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from rich.console import Console
from rich.progress import Progress

import lidarsim as ls
from lidarsim._base.shown import counted, plain
from lidarsim._base.terminal import facts, paragraph, print_line
from lidarsim.io import packets
from lidarsim.patterns import describe
from lidarsim.run import Run

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.io.scenes import Imported


Item = TypeVar("Item")
NAME = 60
"""Maximum characters of a name in a table."""


def print_sent(to: str, sent: packets.Sent, period: float | None) -> None:
    """Print what was sent, and whether scanning was slower than a sensor with frames of that period, s."""
    ports = ", ".join(map(str, sorted(sent.ports)))
    late = "" if period is None else f", largest lag {1e3 * sent.lag:.3g} ms"
    paragraph(
        f"{counted(sent.packets, 'packet')} ({sent.size / 1e6:,.3g} MB) to {to}, {counted(len(sent.ports), 'port')}"
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


LARGEST, SMALLEST = 20e3, 0.01
"""Sizes of a scene, m, beyond which its unit is probably wrong."""
MOST_NAMES = 10
"""Maximum names in a line."""


def print_import(file: Imported) -> None:
    """Print what a scene file brought in, what it did not, and which nodes no rule matched."""
    low, high = file.bounds
    size = high - low
    meshes = (item.shape for item in file.objects if isinstance(item.shape, ls.TriangleMesh))
    triangles = counted(sum(map(len, meshes)), "triangle")
    extent = " × ".join(f"{round(length, 6):,.6g}" for length in size.tolist())
    instances = counted(len({instance for _, instance in file.instances(0)}), "instance")
    paragraph(f"{file.path}: {counted(len(file.objects), 'object')}, {instances}, {triangles}, {extent} m")
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
        paragraph(f"  skipped by rules: {counted(file.skipped, 'part')}")
    if file.without_rule:
        paths = [plain(path, most=NAME) for path in file.without_rule]
        paragraph(f"  no rule matches {counted(len(paths), 'node')}: {format_list(paths)}")
    if size.max() > LARGEST or size.max() < SMALLEST:
        wrong = f"larger than {LARGEST / 1e3:g} km" if size.max() > LARGEST else f"smaller than {SMALLEST * 100:g} cm"
        paragraph(f"  warning: {wrong}; is unit_m right?")


def format_list(names: list[str]) -> str:
    """Return the first names, and how many there are beside them."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {more:,} more" if more > 0 else "")


def track(items: Iterable[Item], count: int) -> Iterator[Item]:
    """Yield the items, with a progress bar if stderr is a terminal."""
    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress:
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


def format_times(span: tuple[float, float]) -> str:
    """Return an interval of time, s."""
    return "always" if math.isinf(span[0]) else f"{format_span(span, digits=12)} s"


def describe_terrain(number: int, mesh: ls.TriangleMesh) -> str:
    """Return the size, the holes, the extent and the coordinate reference system of a mesh of heights."""
    rows, columns = mesh.grid or (0, 0)
    holes = rows * columns - len(mesh.vertices)
    x, y, z = (format_span(ends, digits=10) for ends in mesh.bounds.T)
    crs = f", {plain(mesh.crs, most=NAME)}" if mesh.crs else ""
    return (
        f"object {number}: heights in {rows:,} rows and {columns:,} columns, {counted(holes, 'hole')};"
        f" x {x} m, y {y} m, z {z} m{crs}"
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
            f"{counted(count, 'material')} {does}{'s' if count == 1 else ''}" for does, count in found.items() if count
        )
        whose = f"{name}: " if name else ""
        paragraph(f"{whose}{does}, but depth is 1: give the measurement a depth of 2 or more to see what is behind")


LONGEST_SIGMA, SLOWEST_SCAN, LONGEST_GATE = 1.0, 200.0, (1e3, 1e5)
"""Errors of ranges, m, rates of turns, Hz, and limits of ranges, m, beyond which the unit is probably another one."""


def _questions(lidar: ls.Lidar) -> Iterator[str]:
    """Yield what may be mistaken in the numbers of a sensor."""
    errors = lidar.measurement
    for name in ("range_sigma", "range_sigma_limit", "range_bias", "channel_bias_sigma", "range_resolution"):
        values = np.atleast_2d(np.asarray(getattr(errors, name), dtype=np.float64))[:, -1]
        if np.abs(values).max() > LONGEST_SIGMA:
            yield f"measurement.{name}: {np.abs(values).max():g} m; mm?"
    for name, value, most in zip(
        ("min_range", "max_range"), (lidar.min_range, lidar.max_range), LONGEST_GATE, strict=True
    ):
        if most < value < np.inf:
            yield f"{name}: {value:g} m; mm?"
    if not isinstance(lidar.pattern, ls.patterns.Spinning):
        return
    if lidar.pattern.rate > SLOWEST_SCAN:
        yield f"pattern.rate: {lidar.pattern.rate:g} turns per second; rpm?"
    if lidar.model and lidar.model in ls.Lidar.presets():
        return
    channels = np.column_stack([lidar.pattern.azimuth_offsets, lidar.pattern.elevations])
    known, first, counts = np.unique(channels, axis=0, return_index=True, return_counts=True)
    for i in np.flatnonzero(counts > 1):
        yield f"elevations: {np.degrees(known[i, 1]):g}° twice or more, first in channel {first[i]}"
    for offset in np.unique(channels[:, 0]):
        rows = np.flatnonzero(channels[:, 0] == offset)
        steps = np.diff(channels[rows, 1])
        rising = int((steps > 0).sum())
        falling = int((steps < 0).sum())
        if rising and falling:
            odd = np.flatnonzero(steps > 0 if rising <= falling else steps < 0)[0]
            told = ", ".join(f"{value:g}" for value in np.degrees(channels[rows[odd : odd + 2], 1]))
            yield f"elevations: out of order at channel {rows[odd]} ({told} degrees); a decimal comma?"


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
    for question in _questions(lidar):
        paragraph(f"  warning: {question}")
