"""The figures of `lidarsim.bench.speed` as JSON, Markdown tables and plots."""

from __future__ import annotations

import json
import os
import platform
import re
import statistics
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from lidarsim import _native
from lidarsim._base.files import atomic_writer
from lidarsim.bench import presets
from lidarsim.bench.peers import ABSENT, FAILING
from lidarsim.viewers import _plots as plots

Results = dict[str, Any]
Row = dict[str, Any]

COLORS = {
    "lidarsim": "#c2410c",
    "Open3D": "#331177",
    "embreex": "#335577",
    "MuJoCo-LiDAR": "#aa33ff",
    "MuJoCo": "#008866",
    "textbook": "#552222",
}
"""Colours of the methods, distinct with any kind of colour vision."""
NEAREST = 10.0
"""Position of a distance of 0 on a logarithmic axis, m."""
INK, FAINT = "#1f2937", "#e5e7eb"

CASTING = """\
Median time of a cast; all methods take turns in one process. The ratio is to Open3D on the same rays with as many
threads; for the analytic shapes, to its coarsest tessellation with a median error of 1 mm or less. Errors of the range
are relative to the exact hit, on a sample of the rays; for the analytic shapes, errors in mm are of hits on round
shapes. Wrong: hits lost + invented + on a triangle or object other than the nearest. All methods get the same
coordinates, including those that float32 cannot represent."""

BUILDING = """\
Time from arrays to the first answered ray, with all threads. Memory is the growth of a fresh process that builds the
scene (resident pages, after unused ones were released); for lidarsim, also the memory counted by its core."""

MOTION = """\
128 channels: moving scenes relative to the same scenes at rest. One ray: a scene after one object was moved, relative
to the same scene built anew."""

FRAMES = """\
A Velodyne HDL-64E in a street with 16 moving cars and 16 people who walk, one thread, in its time of the processor,
which waiting for the disk is no part of. A labelled frame is the scan, the deskewed cloud with movers, the boxes of
cars and people, and the files with their hashes."""

CHANGING = """\
Scenes that change between frames, one thread, in its time of the processor: 1,000 instances of 1,280 faces are moved,
or a sheet is bent, and one ray is cast. Embree runs in float32, robust, by its own API; its refitted hierarchy is that
of scenes of low quality. Open3D's scenes cannot be changed."""

ROBOTS = """\
1,000 robots with a lidar of 360 beams each, from new poses at each step, in a scene of 100 shapes and a mesh of 100,352
triangles. The other simulators have only the shapes. They scan from the same poses again and again, so they need not
update them."""

IN_PLANE = """\
541 horizontal rays all around, in the plane z = 0 in which the surfaces lie. They hit only the box and the height
field. The table gives the time of the same rays 0.5 m above the plane, and the ratios to it of rays at z = 0 exactly
and at z = 1e-300 m. Where it says tilted, rays and vertices are rotated by 30° about x and rounded, so that most rays
hit the floor somewhere."""

PATTERNS = """\
Each frame differs from the one before; the scene is the city; one thread. The table gives the times of a pulse: to make
the pulses of a frame, to cast its rays, and to scan a new frame, which makes the pulses, casts their rays and
measures."""

PRESETS = """\
The rays of one frame of each sensor, which start where its beams do, cast with all threads. The table gives the times
of a ray, and the ratio to Open3D."""

REALISTIC = """\
Scans of new frames in the city, with all threads: without noise, with the noise of the data sheet, and with the noise
and beam of a real unit, whose sub-rays form a waveform. Open3D casts the same number of rays around the axis of each
pulse, and makes no waveform of them."""

SCENES = """\
Random scenes of spheres, boxes, cylinders and ellipsoids over a plane, each with label and material. Each scene is
built and scanned once. Mean times of a scene, and the share of building."""

INSTANCES = """\
50 overlapping instances of one mesh, 128 channels, and the same merged into one mesh of {triangles:,} triangles. Of
{rays:,} rays: hits on a triangle other than that of the instances, and the greatest difference of the range."""

COINCIDENT = """\
Scenes in which one surface lies in another, so that each hit is on both. Times are relative to the scenes without the
second surface. The hit must be on the first; wrong: rays whose hit differs from that without the second."""

MESHES = """\
Triangle meshes: million rays per second on the same rays, in turns; wrong hits (lost + invented + on another triangle)
of {rays:,} rays judged by exact arithmetic; the worst range, mm."""

DISTANCE = """\
Greatest error of the range, mm, by the distance of a terrain from the origin of coordinates."""

SHAPES = """\
{shapes} spheres, boxes, cylinders and ellipsoids over a plane, for Open3D in triangles; 128 channels."""


def machine() -> dict[str, str]:
    """Return a description of this machine."""
    return {
        "cpu": _cpu(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "instructions": _native.isa(),
    }


def _cpu() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    known = dict(re.findall(r"^(model name|cpu family|model)\s*:\s*(.+)$", text, re.MULTILINE))
    if "model name" not in known:
        return platform.machine()
    # The model name in a virtual machine may hide the generation.
    numbers = [f"{name.split()[-1]} {known[name]}" for name in ("cpu family", "model") if name in known]
    return " ".join([known["model name"], *([f"({', '.join(numbers)})"] if numbers else [])])


def write(results: Results, folder: Path) -> None:
    """Write ``speed.json``, ``speed.md``, and the plots ``speed``, ``growth`` and ``distance`` as PNG and SVG."""
    for name, text in (("speed.json", json.dumps(results, indent=1)), ("speed.md", to_markdown(results))):
        with atomic_writer(folder / name) as file:
            file.write(text.encode())
    for suffix in plots.SUFFIXES:
        plot_speed(results, folder / f"speed{suffix}")
        plot_growth(results, folder / f"growth{suffix}")
        plot_distance(results, folder / f"distance{suffix}")


def to_markdown(results: Results) -> str:
    """Return the full report."""
    parts = [
        "# Speed against error",
        overview(results),
        "## Casting",
        CASTING,
        _table(
            "scene, rays | threads | method | Mray/s | × Open3D | median, mm | p99, mm | max, mm | max, ulp | wrong",
            (
                [
                    f"{row['scene']}, {row['rays']}",
                    _threads(row),
                    _method(row),
                    _short(row["mrays"]),
                    _short(row["ratio"]),
                    *_errors(row["error"]),
                ]
                for row in _once(results["speed"])
            ),
        ),
        "## Building",
        BUILDING,
        _table(
            "scene | triangles | method | s | × Open3D | bytes per triangle | counted",
            (
                [
                    row["scene"],
                    _count(row["triangles"]),
                    _method(row),
                    _short(row["seconds"]),
                    _short(row["ratio"]),
                    _count(row["resident"]),
                    _count(row["counted"]),
                ]
                for row in results["builds"]
            ),
        ),
        "## More triangles",
        "A terrain of one size in ever finer triangles, 128 channels.",
        "![Time per ray against the number of triangles](growth.png)",
        _table(
            "triangles | threads | method | ns per ray | × Open3D",
            (
                [
                    _count(row["triangles"]),
                    _threads(row),
                    _method(row),
                    _short(1e3 / row["mrays"]),
                    _short(row["ratio"]),
                ]
                for row in results["growth"]
            ),
        ),
        "## A whole scan",
        "In the city, 128 channels, over the bare cast of the same rays.",
        _table(
            "what | ms | × cast",
            ([row["what"], *_ms(row)] for row in results["scan"]),
        ),
        "## Instances",
        INSTANCES.format(**results["instances"][0]),
        _table(
            "what | ns per ray | × Open3D | on another triangle | farthest off, mm",
            (
                [row["what"], _short(row["ns"]), _short(row["ratio"]), f"{row['other']:,}", _short(row["off_mm"])]
                for row in results["instances"]
            ),
        ),
        "## Coincident surfaces",
        COINCIDENT,
        _table(
            "scene | ns per ray | × without the second surface | wrong",
            (
                [row["what"], _short(row["ns"]), _short(row["ratio"]), f"{row['wrong']} of {row['rays']:,}"]
                for row in results["coincident"]
            ),
        ),
        "## Threads",
        "`Scene.cast` by one thread and by more, in turns.",
        _table(
            "scene, rays | threads | Mray/s | × one",
            (
                [f"{row['scene']}, {row['rays']}", str(row["threads"]), _short(row["mrays"]), _short(row["ratio"])]
                for row in results["scaling"]
            ),
        ),
        "## Lines of sight",
        "In the city: `Scene.occluded`, whether there is a hit, beside `Scene.cast`, which finds the nearest.",
        _table(
            "rays | cast, ns per ray | occluded, ns per ray | × as fast | wrong",
            (
                [row["rays"], _short(row["cast"]), _short(row["occluded"]), _short(row["ratio"]), str(row["wrong"])]
                for row in results["sight"]
            ),
        ),
        "## Motion",
        MOTION,
        _table(
            "what | over | ms | ×",
            ([row["what"], row["over"] * (row["over"] != row["what"]), *_ms(row)] for row in results["motion"]),
        ),
        "## Labelled frames",
        FRAMES,
        _table(
            "what | ms | × its scan",
            ([row["what"], *_ms(row)] for row in results["frames"]),
        ),
        "## Scenes that change",
        CHANGING,
        _table(
            "what | ms | ×",
            ([row["what"], *_ms(row)] for row in results["changing"]),
        ),
        "## Robots",
        ROBOTS,
        _table(
            "robots | over | ms | ×",
            ([row["what"], row["over"] * (row["over"] != row["what"]), *_ms(row)] for row in results["robots"]),
        ),
        "## Rays in the plane of a surface",
        IN_PLANE,
        _table(
            "surface | above, µs | in the plane, × | next to it, ×",
            (
                [row["what"], _short(1e6 * row["seconds"]), _short(row["in_plane"]), _short(row["next"])]
                for row in results["in_plane"]
            ),
        ),
        "## Sensors",
        PRESETS,
        _table(
            "scene | sensor | rays | lidarsim, ns | Open3D, ns | ratio",
            (
                [
                    row["scene"],
                    row["sensor"],
                    f"{row['rays']:,}",
                    _short(1e9 * row["lidarsim"]),
                    *(
                        "" if row[key] is None else _short(factor * row[key])
                        for key, factor in (("Open3D", 1e9), ("ratio", 1))
                    ),
                ]
                for row in results["presets"]
            ),
        ),
        "## New frames",
        PATTERNS,
        _table(
            "sensor | pattern | pulses | pulses, ns | cast, ns | scan, ns | scan / cast",
            (
                [
                    row["sensor"],
                    row["pattern"],
                    f"{row['pulses']:,}",
                    *(_short(1e9 * row[kind]) for kind in ("make", "cast", "scan")),
                    _short(row["ratio"]),
                ]
                for row in results["patterns"]
            ),
        ),
        "## Random scenes",
        SCENES,
        _table(
            "scenes | objects | what | rays | threads | build, µs | scan, µs | share of building",
            (
                [
                    str(row["scenes"]),
                    str(row["objects"]),
                    row["what"],
                    f"{row['rays']:,}",
                    str(row["threads"]),
                    _short(1e6 * row["build"]),
                    _short(1e6 * row["scan"]),
                    f"{row['share']:.1%}",
                ]
                for row in results["scenes"]
            ),
        ),
        "## Methods",
        _table("method | version", ([name, state] for name, state in results["casters"].items())),
    ]
    return "\n\n".join(parts) + "\n"


def overview(results: Results, pictures: str = "") -> str:
    """Return the summary tables in Markdown: meshes beside Open3D, analytic shapes, scans with the noise of real units.

    `pictures` is the prefix of the pictures' names, such as ``"../images/"``.
    """
    cells: dict[tuple[str, str], dict[str, Row]] = {}
    for row in _most_threads(results):
        if not row["scene"].startswith("analytic"):
            cells.setdefault((row["scene"], row["rays"]), {})[row["method"]] = row
    meshes = []
    for (scene, rays), methods in cells.items():
        own, peer = methods["lidarsim"], methods.get("Open3D")
        meshes.append(
            [
                scene,
                rays,
                _short(own["mrays"]),
                _short(peer["mrays"]) if peer else "—",
                f"**{_short(own['ratio'])}**",
                f"{_wrong(own['error'])}; {_short(own['error']['max_mm'])}",
                f"{_wrong(peer['error'])}; {_short(peer['error']['max_mm'])}" if peer else "—",
            ]
        )
    shapes = [
        [_method(row), _threads(row), _short(row["mrays"]), _short(row["ratio"]), *_errors(row["error"])]
        for row in _analytic(results)
    ]
    sample = max(row["error"]["rays"] for row in results["speed"])
    missing = [name for name, state in results["casters"].items() if state.startswith((ABSENT, FAILING))]
    parts = [
        f"![Speed against error]({pictures}speed.png)",
        _machine(results) + (f" Not available on that machine: {'; '.join(missing)}." if missing else ""),
        MESHES.format(rays=sample),
        _table("scene | rays | lidarsim | Open3D | ratio | lidarsim: wrong; worst | Open3D: wrong; worst", meshes),
        SHAPES.format(shapes=results["plan"]["shapes"]),
        _table("method | threads | Mray/s | × Open3D | median, mm | p99, mm | max, mm | max, ulp | wrong", shapes),
        REALISTIC,
        _table(
            "sensor | pulses | sub-rays | clean, ns | data sheet, ns | real, ns | real / clean | Open3D, ns | × Open3D",
            (
                [
                    row["sensor"],
                    f"{row['pulses']:,}",
                    str(row["sub_rays"]),
                    *(_short(1e9 * row[kind]) for kind in ("clean", "datasheet", "measured")),
                    _short(row["ratio"]),
                    _short(None if row["Open3D"] is None else 1e9 * row["Open3D"]),
                    _short(row["over_open3d"]),
                ]
                for row in results["realistic"]
            ),
        ),
        f"![Error against the distance from the origin]({pictures}distance.png)",
        DISTANCE,
        _distances(results),
        summary(results),
    ]
    return "\n\n".join(parts)


def _distances(results: Results) -> str:
    """Return the greatest errors by method and distance."""
    found: dict[str, dict[float, Row]] = {}
    for row in results["distance"]:
        found.setdefault(row["method"], {})[row["distance"]] = row["error"]
    distances = sorted({row["distance"] for row in results["distance"]})
    cells = (
        [_method({"method": name}), *(_short(errors[d]["max_mm"]) if d in errors else "—" for d in distances)]
        for name, errors in found.items()
    )
    return _table(" | ".join(["method", *map(_kilometres, distances)]), cells)


def _kilometres(distance: float) -> str:
    return f"{distance / 1000:g} km" if distance else "0"


def _machine(results: Results) -> str:
    m = results["machine"]
    threads = max(results["plan"]["threads"])
    place = f"{m['cpu']}, {m['cores']} cores, {m['system']}, Python {m['python']}"
    return f"Measured on {place}, with {threads} threads where a method has them; lidarsim with {m['instructions']}."


def summary(results: Results) -> str:
    """Return the main figures of the tables as a list."""
    own = [row for row in _most_threads(results) if row["method"] == "lidarsim"]
    lines = []
    for name, first in (("128 channels", "128"), ("16 channels", "16"), ("random rays", "random")):
        ratios = [
            row["ratio"]
            for row in own
            if row["rays"].startswith(first) and row["scene"] in {"city", "terrain", "scans"} and row["ratio"]
        ]
        if ratios:
            mean = statistics.geometric_mean(ratios)
            lines.append(f"meshes, {name}: {_short(mean)} × Open3D (geometric mean; least {_short(min(ratios))} ×)")
    analytic = {row["method"]: row for row in _analytic(results)}
    lines += [
        f"analytic shapes: {_short(analytic['lidarsim']['ratio'])} × {row['method']}"
        for row in analytic.values()
        if row["reference"]
    ]
    lidars = [row["mrays"] for name, row in analytic.items() if name.startswith("MuJoCo-LiDAR")]
    if lidars:
        ratio = analytic["lidarsim"]["mrays"] / max(lidars)
        lines.append(f"analytic shapes: {_short(ratio)} × the fastest back end of MuJoCo-LiDAR")
    placed = results["instances"][0]
    if placed["ratio"]:
        lines.append(f"50 instances that overlap: {_short(placed['ratio'])} × Open3D on one mesh")
    most = max(row["threads"] for row in results["scaling"])
    ratios = [_short(row["ratio"]) for row in results["scaling"] if row["threads"] == most]
    lines.append(f"{most} threads: {', '.join(ratios)} × one, on the meshes by 128 channels")
    builds = {(row["scene"], row["method"]): row for row in results["builds"]}
    for (scene, method), row in builds.items():
        peer = builds.get((scene, "Open3D"))
        if method == "lidarsim" and peer is not None:
            line = f"{scene}: built in {_short(row['seconds'])} s, Open3D {_short(peer['seconds'])} s"
            if row["resident"]:
                line += f"; {_count(row['resident'])} bytes per triangle, Open3D {_count(peer['resident'])}"
            lines.append(line)
    lines += [f"{row['what']}: {_short(row['ratio'])} × the bare cast" for row in results["scan"][1:]]
    lines += [f"{row['what']}: {_short(row['ratio'])} × its scan" for row in results["frames"][1:]]
    lines += [
        f"robots, {row['what']}: {_short(row['ratio'])} × {row['over']}"
        for row in results["robots"]
        if row["what"] != row["over"]
    ]
    lines += [
        f"{row['scenes']} random scenes of {row['objects']} objects, a {row['what']} by 32 channels each: "
        f"building takes {row['share']:.1%} of the time"
        for row in results["scenes"]
        if row["threads"] == max(results["plan"]["threads"])
    ]
    slowest = max(results["in_plane"], key=lambda row: max(row["in_plane"], row["next"]), default=None)
    if slowest is not None:
        most = max(slowest["in_plane"], slowest["next"])
        lines.append(f"rays in the plane of a surface: at most {_short(most)} × of rays above ({slowest['what']})")
    together = presets.mean(results["presets"])
    if together is not None:
        least = min(results["presets"], key=lambda row: row["ratio"])
        lines.append(
            f"rays of {len(presets.SENSORS)} sensors: {_short(together)} × Open3D, "
            f"at least {_short(least['ratio'])} ({least['sensor']}, {least['scene']})"
        )
    errors = [row["error"] for row in results["speed"] + results["growth"] if row["method"] == "lidarsim"]
    wrong = sum(error["lost"] + error["invented"] + error["other"] for error in errors)
    worst = max((error["max_ulp"] for error in errors if error["max_ulp"] is not None), default=0.0)
    lines.append(
        f"lidarsim against exact arithmetic: {wrong} wrong of {sum(error['rays'] for error in errors):,} rays, "
        f"ranges within {_short(worst)} ulp"
    )
    return "\n".join(f"- {line}" for line in lines)


def _most_threads(results: Results) -> list[Row]:
    threads = max(results["plan"]["threads"])
    return [row for row in results["speed"] if row["threads"] == threads]


def _analytic(results: Results) -> list[Row]:
    return [row for row in _most_threads(results) if row["scene"] == "analytic" and row["rays"].startswith("128")]


def _once(rows: Iterable[Row]) -> list[Row]:
    """Return the rows without repetitions of single-threaded methods for more threads."""
    seen: dict[tuple[str, ...], Row] = {}
    for row in rows:
        seen.setdefault((row["scene"], row["rays"], row["method"], _threads(row)), row)
    return list(seen.values())


def _table(header: str, rows: Iterable[Sequence[str]]) -> str:
    head = [f"| {header} |", "|---" * len(header.split(" | ")) + "|"]
    return "\n".join([*head, *(f"| {' | '.join(row)} |" for row in rows)])


def _method(row: Row) -> str:
    name: str = row["method"]
    return f"**{name}**" if name == "lidarsim" else name


def _threads(row: Row) -> str:
    return "1" if row.get("one_thread") else str(row["threads"])


def _ms(row: Row) -> list[str]:
    """Return the time of a row, ms, and its ratio."""
    return [_short(1e3 * row["seconds"]), _short(row["ratio"])]


def _errors(error: Row) -> list[str]:
    figures = [_short(error[key]) for key in ("median_mm", "p99_mm", "max_mm", "max_ulp")]
    return [*figures, f"{_wrong(error)} of {error['rays']:,}"]


def _wrong(error: Row) -> str:
    counts = [error["lost"], error["invented"], error["other"]]
    return " + ".join("?" if count is None else str(count) for count in counts) if any(counts) else "0"


def _short(value: float | None) -> str:
    if value is None:
        return "—"
    if value == 0 or 0.01 <= value < 1e4:
        return f"{value:.3g}" if value < 1000 else f"{value:.0f}"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def _count(value: float | None) -> str:
    return f"{value:,.0f}" if value else "—"


def _round(value: float) -> str:
    """Return the number rounded to two significant digits."""
    return f"{float(f'{value:.2g}'):,.0f}"


def plot_speed(results: Results, path: Path) -> None:
    """Plot speed against error on the analytic shapes: the median of each method, and a line to its maximum."""
    rows = [row for row in _analytic(results) if row["error"]["median_mm"] is not None]

    def draw(axes: Any) -> None:
        meshed = [row for row in rows if row["method"].startswith("Open3D")]
        x, y = [row["error"]["median_mm"] for row in meshed], [row["mrays"] for row in meshed]
        axes.plot(x, y, color=_color("Open3D"), alpha=0.4, linewidth=1.2, linestyle=(0, (4, 3)))
        labels = []
        for row in sorted(rows, key=lambda row: -row["mrays"]):
            own, color = row["method"] == "lidarsim", _color(row["method"])
            median, largest, speed = row["error"]["median_mm"], row["error"]["max_mm"], row["mrays"]
            axes.plot([median, largest], [speed, speed], color=color, alpha=0.35, linewidth=1.5)
            axes.plot(median, speed, marker="D" if own else "o", markersize=10 if own else 7, color=color, mec="white")
            if row not in meshed[1:-1]:
                name = f"Open3D, {_round(row['triangles'])} triangles" if row in meshed else row["method"]
                labels.append((name, median, speed, color, "bold" if own else "normal"))
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
        axes.margins(x=0.08, y=0.15)
        _label(axes, labels)
        axes.set_xlabel("error of the range, mm: its median, and a line up to its maximum", color=INK)
        axes.set_ylabel("million rays per second", color=INK)
        _title(axes, results, f"{results['plan']['shapes']} analytic shapes, 128 channels")

    _figure(draw, path)


def plot_growth(results: Results, path: Path) -> None:
    """Plot the time per ray against the number of triangles."""

    def draw(axes: Any) -> None:
        labels = []
        for method in dict.fromkeys(row["method"] for row in results["growth"]):
            rows = [row for row in results["growth"] if row["method"] == method]
            x, y = [row["triangles"] for row in rows], [1e3 / row["mrays"] for row in rows]
            _curve(axes, x, y, method)
            name = method + (", 1 thread" if rows[-1]["one_thread"] else "")
            labels.append((name, x[-1], y[-1], _color(method), "bold" if method == "lidarsim" else "normal"))
        step = (x[-1] / x[0]) ** 0.1
        axes.set_xlim(x[0] / step, x[-1] * step**3)  # room for the labels
        axes.set_ylim(bottom=0)
        _label(axes, sorted(labels, key=lambda label: -label[2]), RIGHT)
        axes.set_xlabel("triangles", color=INK)
        axes.set_ylabel("ns per ray", color=INK)
        _title(axes, results, "A terrain, 128 channels")

    _figure(draw, path)


def plot_distance(results: Results, path: Path) -> None:
    """Plot the greatest range error against the distance from the origin of coordinates."""

    def draw(axes: Any) -> None:
        labels = []
        for method in dict.fromkeys(row["method"] for row in results["distance"]):
            rows = [
                row for row in results["distance"] if row["method"] == method and row["error"]["max_mm"] is not None
            ]
            x, y = [max(row["distance"], NEAREST) for row in rows], [row["error"]["max_mm"] for row in rows]
            _curve(axes, x, y, method)
            if rows:
                labels.append((method, x[-1], y[-1], _color(method), "bold" if method == "lidarsim" else "normal"))
        axes.set_yscale("log")
        ticks = sorted({max(row["distance"], NEAREST) for row in results["distance"]})
        axes.set_xticks(ticks, [_kilometres(0.0 if tick == NEAREST else tick) for tick in ticks])
        axes.set_xlim(ticks[0] / 2, ticks[-1] * 8)  # room for the labels
        _label(axes, sorted(labels, key=lambda label: -label[2]), RIGHT)
        axes.set_xlabel("distance from the origin of coordinates", color=INK)
        axes.set_ylabel("greatest error of the range, mm", color=INK)
        axes.set_title("A terrain of 10,000 triangles, 16 channels", fontsize=10, color=INK, loc="left")

    _figure(draw, path)


def _curve(axes: Any, x: Sequence[float], y: Sequence[float], method: str) -> None:
    """Draw the curve of a method: those after the first with gaps and smaller marks, so that none hides another."""
    drawn = len(axes.lines)
    style = "solid" if drawn == 0 else (4.0 * drawn, (4, 8))
    look = {"linestyle": style, "marker": "osD^v"[drawn % 5], "markersize": 9 - 1.5 * min(drawn, 3)}
    axes.plot(x, y, linewidth=2, color=_color(method), mec="white", mew=0.5, **look)


# Places of a label: its offset from the mark in points, and its alignment. The first free place is taken.
AROUND = (
    ((0, 9), "center", "bottom"),
    ((-4, 4), "right", "bottom"),
    ((-9, 0), "right", "center"),
    ((0, -9), "center", "top"),
    ((-5, -5), "right", "top"),
    ((5, -5), "left", "top"),
    ((5, 5), "left", "bottom"),
)
RIGHT = tuple(((9, 8 * rise), "left", "center") for rise in (0, -1, -2))


def _label(axes: Any, labels: Iterable[tuple[str, float, float, str, str]], places: Iterable[Any] = AROUND) -> None:
    """Put each label (text, x, y, color, weight) beside its mark, so that it covers no mark or earlier label."""
    renderer = axes.figure.canvas.get_renderer()
    axes.figure.draw_without_rendering()
    marks = axes.transData.transform([mark for line in axes.lines for mark in line.get_xydata()])
    boxes: list[Any] = []
    for text, x, y, color, weight in labels:
        for offset, ha, va in places:
            note = axes.annotate(
                text,
                (x, y),
                xytext=offset,
                textcoords="offset points",
                ha=ha,
                va=va,
                fontsize=9,
                color=color,
                weight=weight,
                in_layout=False,
            )
            box = note.get_window_extent(renderer).padded(2)
            inside = axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1
            if inside and not any(box.contains(*mark) for mark in marks) and not box.count_overlaps(boxes):
                break
            note.set_visible(False)
        else:  # no place is free: overlap rather than omit
            note.set_visible(True)
        boxes.append(box)


def _title(axes: Any, results: Results, what: str) -> None:
    place = f"{results['machine']['cpu']}, {max(results['plan']['threads'])} threads"
    axes.set_title(f"{what}; {place}", fontsize=10, color=INK, loc="left")


def _color(method: str) -> str:
    return next(color for name, color in COLORS.items() if method.startswith(name))


def _figure(draw: Callable[[Any], None], path: Path) -> None:
    """Draw on axes with a logarithmic x axis, and write a PNG or SVG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.8), dpi=160, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_xscale("log")
    axes.grid(color=FAINT, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[:].set_visible(False)
    axes.tick_params(which="both", length=0, colors=INK, labelsize=9)
    draw(axes)
    plots.write(figure, path, dpi=160)
