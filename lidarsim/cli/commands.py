"""The commands."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shlex
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

import lidarsim as ls
from lidarsim import _native as core
from lidarsim._base.extras import import_extra
from lidarsim._base.files import atomic_writer, check_folder, check_suffix
from lidarsim._base.shown import format_size, plain, quantity
from lidarsim._base.terminal import paragraph, print_line, print_markdown, progress_bar, table, without_native_logs
from lidarsim._base.validation import integer
from lidarsim._base.views import Background, ColorMap, Viewer
from lidarsim.cli.options import (
    ColorBy,
    Configuration,
    Frame,
    Frames,
    Overrides,
    Screenshot,
    Seed,
    Size,
    Surfaces,
    Variant,
    View,
    make_choice,
    make_file_argument,
    make_file_option,
    make_option,
    parse_integer,
    parse_limits,
    parse_output,
    parse_part,
    parse_size,
    with_options,
)
from lidarsim.cli.printing import (
    NAME,
    Item,
    describe_terrain,
    format_fit,
    format_list,
    format_measured,
    format_span,
    format_times,
    print_depth,
    print_import,
    print_objects,
    print_others,
    print_sensor,
    print_sent,
    track,
)
from lidarsim.config import starter
from lidarsim.errors import ArgumentError, ArgumentValueError, LidarsimError
from lidarsim.io import packets, raster
from lidarsim.lidar import preset_path
from lidarsim.patterns import describe
from lidarsim.run import Run, RunFrame, checked_output
from lidarsim.run import _output as outputs
from lidarsim.run.packets import pcap
from lidarsim.scan.formats import is_point_cloud
from lidarsim.viewers import pattern, pyvista
from lidarsim.viewers._display import require_display
from lidarsim.viewers._show import check_save, frame_title, together_title
from lidarsim.viewers.rerun import NAME as RERUN
from lidarsim.world.scene import is_scene_file

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.io.scenes import Imported


app = typer.Typer(
    help="Exact and fast lidar simulation.", add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
)

ROWS = 10
"""Maximum rows of the table that a scan of many frames prints."""
MOST_FRAMES = 100
"""Maximum frames of a data set that `view` shows unless it is told otherwise."""
_DRAWN = {
    "screenshot": ("pyvista", "pyvista"),
    "html": ("plotly", "html"),
    "gif": ("pyvista", "pyvista"),
    "mp4": ("imageio_ffmpeg", "video"),
}
"""Package that each kind of picture needs, and the extra that installs it."""


def _version(asked: bool) -> None:
    if asked:
        paragraph(f"lidarsim {ls.__version__}, core with {core.isa()} and {quantity(core.threads(), 'thread')}")
        raise typer.Exit


@app.callback()
def _options(
    _: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


@app.command()
def new(
    folder: Annotated[Path, make_file_argument("FOLDER", "New or empty folder.")],
) -> None:
    """Make a project in FOLDER to start from: scene, sensor, runs, recipes, a script and notes."""
    files = starter.new_project(folder)
    print_line(f"{folder}: {', '.join(path.as_posix() for path in files)}")
    print_line(f"next: cd {shlex.quote(plain(folder))} && lidarsim scan demo.yaml --output street.pcd")
    print_line(f"{folder / 'README.md'} explains the files and lists what else to run")


@app.command()
@with_options
def scan(
    config: Configuration,
    *,
    output: Annotated[
        str,
        make_option(
            "--output -o",
            "OUT",
            "Point cloud file, all frames in a ROS 2 bag (.mcap, .db3, or a folder, ending in /), or packets (.pcap).",
            parser=parse_output,
        ),
    ],
    overrides: Overrides = None,
    seed: Seed = None,
    frame: Frame = None,
    frames: Frames = None,
    screenshot: Screenshot = None,
    color_by: ColorBy = None,
    surfaces: Surfaces = True,
    camera: View = "behind",
    size: Size = "1600x1000",
    **options: Any,
) -> None:
    """Scan the scene in CONFIG and write the point cloud.

    With several frames, each frame gets its own numbered file, and the sensor poses (OUT_poses.tum) and the start times
    of the frames (OUT_times.txt) are written next to them. Each pose is that at the start of its frame, or at the time
    to which the points are deskewed. With a rig, each sensor gets its own files. A ROS 2 bag (.mcap, .db3) holds all
    frames in one file. Packets (.pcap), as the sensors send them, are in one file too, with what decoders need next to
    it. The times next to a bag or packets are Unix times, as their stamps are. Strips and stations are numbered; a
    strip is one LAS or LAZ file.
    """
    place = checked_output(output)
    given = {name: outputs.options()[name].parse(value) for name, value in options.items() if value is not None}
    _check_screenshot(screenshot)
    looks: dict[str, Any] = {"color_by": color_by, "camera": camera, "size": parse_size(size)}
    start = time.perf_counter()
    run = _load(config, overrides, seed=seed, first_frame=frame, frames=frames)
    run.check_places(place, screenshot)
    looks["scene"] = run.scene if surfaces else None
    totals = np.zeros(len(ls.Status), np.int64)
    notes: dict[str, None] = {}
    rows: list[tuple[object, ...]] = []
    points = 0

    with progress_bar() as progress:
        task = progress.add_task("scanning", total=len(run.numbers))

        def tell(frame: RunFrame) -> None:
            nonlocal points
            if screenshot:
                for name, cloud in frame.in_world().items():
                    picture = run.path_of(screenshot, name, frame.number)
                    ls.show(cloud, pose=frame.poses[name], time=frame.scans[name].time, save=picture, **looks)
            for result in frame.scans.values():
                summary = result.summary()
                totals[:] += list(summary.values())
                notes.setdefault(summary.note)
            found = sum(map(len, frame.clouds.values()))
            pulses = sum(map(len, frame.scans.values()))
            rows.append((frame.number, pulses, found, 1e3 * frame.seconds, found / frame.seconds))
            points += found
            progress.advance(task)

        run.write(output, each=tell, **given)
    shown = rows if len(rows) <= ROWS else [*rows[: ROWS // 2], ("…",) * 5, *rows[len(rows) - ROWS // 2 + 1 :]]
    table(("frame", "pulses", "points", "ms", "points/s"), shown)
    paragraph(_format_statuses(totals.tolist()))
    for note in filter(None, notes):
        paragraph(note)
    files = outputs.output_of(place, run).pattern(run) + ([run.path_of(screenshot, "*", "*")] if screenshot else [])
    count = f"{len(rows):,} frames, " * (len(rows) > 1) + quantity(points, "point")
    paragraph(f"{count} in {time.perf_counter() - start:.2f} s: {', '.join(map(str, files))}")


def _format_statuses(counts: Sequence[int]) -> str:
    """Return a line with the number of pulses of each status."""
    named = zip(ls.Status, counts, strict=True)
    listed = ", ".join(f"{count:,} {status.name.replace('_', ' ')}" for status, count in named if count)
    return f"{quantity(sum(counts), 'pulse')}: {listed}"


@app.command()
def generate(
    recipe: Annotated[
        Path | None, make_file_argument("RECIPE", "YAML recipe, or a packaged one: detection, segmentation.")
    ] = None,
    *,
    output: Annotated[
        str, make_option("--output -o", "FOLDER|URL", "Output folder, or a URL such as s3://bucket/folder.")
    ],
    workers: Annotated[
        int | None, make_option("--workers", "N", "Run N single-threaded processes.", parser=parse_integer)
    ] = None,
    scheduler: Annotated[
        str | None, make_option("--scheduler", "ADDRESS", "Run on a Dask cluster, e.g. tcp://host:8786.")
    ] = None,
    shard: Annotated[str | None, make_option("--shard", "I/N", "Make only part I of N, counting from 0.")] = None,
    verify: Annotated[
        bool,
        typer.Option("--verify", help="Compare all existing files with the manifest; with RECIPE, repair them."),
    ] = False,
    pictures: Annotated[
        int,
        make_option("--pictures", "N", "Number of frames to show in the data card; default 3.", parser=parse_integer),
    ] = 3,
    overrides: Annotated[
        list[str] | None, make_option("--set", "KEY=VALUE", "Override a value in RECIPE, e.g. frames=100.")
    ] = None,
) -> None:
    """Make the data set described by RECIPE, resume it, or make its lost files again.

    Existing files are kept: after a crash, a full disk or Ctrl-C, run the same command again to continue. Files that
    are missing or of another size are made again; with --verify, so are those of another content. The files are
    byte-identical for any number of workers. With --workers, Dask's dashboard is reachable only from this machine; from
    another, forward its port: ssh -L PORT:127.0.0.1:PORT.
    """
    if not output:
        raise LidarsimError("--output: expected a folder or URL, got an empty one")
    if verify and recipe is None:
        problems = ls.datasets.verify(output)
        if problems:
            raise LidarsimError(
                f"{output}: {quantity(len(problems), 'file')} not as in the manifest: {problems[0]}; "
                "`lidarsim generate RECIPE -o FOLDER --verify` makes them again"
            )
        paragraph(f"{output}: all files match the manifest")
        return
    if recipe is None:
        raise LidarsimError("RECIPE: expected a recipe, or --verify, got neither")
    from lidarsim.cli.cluster import cluster

    with cluster(workers, scheduler) as client:
        if client is not None and client.dashboard_link:
            paragraph(f"dashboard: {client.dashboard_link}")
        made = ls.generate(
            recipe,
            output,
            client=client,
            part=parse_part(shard),
            overrides=overrides or (),
            pictures=pictures,
            verify=verify,
        )
    paragraph(f"{quantity(made.frames, 'frame')}, {quantity(made.points, 'point')} in {made.seconds:.1f} s: {output}")
    if made.made_again:
        paragraph(f"made again: {format_list([plain(name, most=NAME) for name in made.made_again])}")
    elif verify and not made.frames:
        paragraph(f"{output}: all files match the manifest")
    for line in made.left_out:
        paragraph(f"scattered: {plain(line)}")
    if made.shards_left:
        paragraph(f"still missing: {quantity(made.shards_left, 'shard')} of other parts")


@app.command()
def stream(
    config: Annotated[Path, make_file_argument("CONFIG", "YAML configuration, or a packaged one: ahead.")],
    *,
    to: Annotated[
        str,
        make_option(
            "--to",
            "HOST[:PORT]",
            "Where to send: a name, an IPv4 address or [IPV6]; default 127.0.0.1 and the vendor's port.",
        ),
    ] = "127.0.0.1",
    fast: Annotated[bool, typer.Option("--fast", help="Send as fast as possible, not at the sensor's rate.")] = False,
    variant: Variant = None,
    metadata: Annotated[
        Path | None,
        make_file_option("--metadata", "FILE", "Write what decoders need besides the packets, such as Ouster's JSON."),
    ] = None,
    repeat: Annotated[bool, typer.Option("--repeat", help="Begin again after the last frame, until Ctrl-C.")] = False,
    overrides: Overrides = None,
    seed: Seed = None,
    frame: Frame = None,
    frames: Frames = None,
) -> None:
    """Scan the scene in CONFIG and send the packets of its sensors by UDP, each at its time.

    Frames are scanned while others are sent. Packets that are late are sent at once, and packets that the system
    refuses are dropped, as by a sensor; the last line counts both. With a rig, each further sensor sends to the next
    two ports. UDP does not tell whether packets are received: a receiver that is too slow loses some.
    """
    run = _load(config, overrides, seed=seed, first_frame=frame, frames=frames)
    run.check_coverage()
    if metadata:
        check_folder(metadata)
        run.check_unread(*pcap(run, metadata.with_suffix(".pcap"), variant=variant).files[1:])
    with packets.Sender(run.lidars, to, start=run.clock, variant=variant, fast=fast) as sender:
        if metadata:
            for path in (written := sender.save_metadata(metadata)):
                print_line(path)
            if not written:
                paragraph("--metadata: the decoders of these packets need no file")
        try:
            if repeat:
                sender.send(run.scans, repeat=math.inf, period=run.period)
            else:
                sender.send(track(run.scans(), len(run.numbers)))
        except KeyboardInterrupt:
            print_sent(to, sender.sent, None if fast else 1.0 / run.rate)
            raise
        print_sent(to, sender.sent, None if fast else 1.0 / run.rate)


@app.command()
def view(
    path: Annotated[
        Path,
        make_file_argument(
            "PATH",
            "Point cloud, bag, data set of any layout, folder of these, configuration, recipe, or scene file: "
            "GLB, MJCF, GeoTIFF, …; or a packaged configuration: demo.",
        ),
    ],
    *,
    viewer: Annotated[Viewer | None, make_choice("--with", Viewer, "Library of the window; default: pyvista.")] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Show the frames of a configuration in Rerun while they are scanned.")
    ] = False,
    expose: Annotated[
        bool, typer.Option("--expose", help="Let other machines reach the viewer that --live opens.")
    ] = False,
    rrd: Annotated[Path | None, make_file_option("--rrd", "RRD", "Write the same to a file for Rerun.")] = None,
    screenshot: Screenshot = None,
    html: Annotated[Path | None, make_file_option("--html", "HTML", "Write a self-contained web page.")] = None,
    gif: Annotated[
        Path | None,
        make_file_option("--gif", "GIF", "Write an animation of all frames, or an orbit around a single one."),
    ] = None,
    mp4: Annotated[Path | None, make_file_option("--mp4", "MP4", "Same as --gif, but as a video.")] = None,
    color_by: ColorBy = None,
    surfaces: Surfaces = True,
    camera: View = "behind",
    size: Size = "1600x1000",
    limits: Annotated[
        str | None,
        make_option("--limits", "LOW,HIGH", "Values at the ends of the colours; default: those of the points."),
    ] = None,
    color_map: Annotated[ColorMap | None, make_choice("--color-map", ColorMap, "Colours of numbers.")] = None,
    background: Annotated[Background, make_choice("--background", Background, "Colour.")] = "dark",
    title: Annotated[
        str | None, make_option("--title", "TEXT", "Title; default: number and time of the frame.")
    ] = None,
    accumulate: Annotated[bool, typer.Option("--accumulate", help="Show all frames in one picture, as a map.")] = False,
    overrides: Overrides = None,
    seed: Seed = None,
    frame: Frame = None,
    frames: Frames = None,
) -> None:
    """Show point clouds or a scene in a window, or write pictures of them.

    A configuration or recipe is scanned first; its points are shown in world coordinates, together with the surfaces of
    the scene. Data sets are shown with their classes and boxes, and point clouds with the .label beside them. With
    several frames, windows and web pages have a slider, and a screenshot shows the first, or that of --frame, from 0;
    with --accumulate, all of them.

    With --live, the frames of a configuration are shown in Rerun while they are scanned, at the sensor's rate, with
    boxes. The viewer can be reached from this machine alone, unless you --expose it. Foxglove opens the bags of
    lidarsim scan (.mcap).
    """
    path = path if path.is_dir() else starter.configuration(path)
    if expose and (rrd or not live):
        raise LidarsimError("--expose: expected only with --live")
    if live or rrd:
        used: dict[str, object] = {
            "--with": viewer,
            "--screenshot": screenshot,
            "--html": html,
            "--gif": gif,
            "--mp4": mp4,
        }
        used |= {"--limits": limits, "--color-map": color_map, "--title": title, "--accumulate": accumulate}
        _check_live(path, [name for name, value in used.items() if value], rrd)
        run, names = _describe(path, overrides, seed=seed, first_frame=frame, frames=frames)
        _stream(run, rrd or RERUN, names, expose=expose, color_by=color_by, surfaces=surfaces)
        return
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    viewer = viewer or "pyvista"
    saves = _check_saves({"screenshot": screenshot, "html": html, "gif": gif, "mp4": mp4}, viewer)
    looks: dict[str, Any] = {
        "color_by": color_by, "camera": camera, "size": parse_size(size), "viewer": viewer,
        "limits": parse_limits(limits), "color_map": color_map, "background": background,
        "title": title,
    }  # fmt: skip
    wanted = 1 if saves == [screenshot] and not accumulate else None
    clouds: tuple[ls.PointCloud | Mapping[str, ls.PointCloud], ...]
    if path.suffix.lower() in (".yaml", ".yml"):
        run, names = _describe(path, overrides, seed=seed, first_frame=frame, frames=frames)
        run.check_unread(*saves)
        clouds, places, count = _scan(path, run, wanted)
        looks |= {"scene": run.scene if surfaces else None, "class_names": names}
    else:
        is_scene = not is_point_cloud(path) and is_scene_file(path)
        given = {"--set": overrides, "--seed": seed}
        given |= {"--frame": frame, "--frames": frames} if is_scene else {}
        unused = [name for name, value in given.items() if value is not None]
        if unused:
            raise LidarsimError(f"{', '.join(unused)}: expected only with a configuration or recipe, got {path}")
        if is_scene:
            _view_scene(path, saves, looks)
            return
        most = MOST_FRAMES if frames is None else integer("--frames", frames, at_least=1)
        clouds, places, count = _read(path, frame or 0, wanted or most)
    usual = places.pop("color_by", None)
    looks["color_by"] = color_by or usual
    looks["title"], titles = title, places.pop("title", None)
    if accumulate:
        looks |= {"accumulate": True, "title": title or together_title(len(clouds), places.get("time", ()))}
    elif title is None and titles is not None:
        places["title"] = titles
        looks.pop("title")
    targets: list[Path | None] = [*saves] or [None]
    for save in targets:
        seen = slice(1 if save and save is screenshot and not accumulate else None)
        ls.show(clouds[seen], save=save, **{name: of[seen] for name, of in places.items()}, **looks)
        if count > 1 and save and save is screenshot and not accumulate:
            which = "the first" if frame is None else f"frame {frame}"
            paragraph(f"{save}: {which} of {quantity(count, 'frame')}; --html, --gif and --mp4 show all")


def _check_saves(saves: Mapping[str, Path | None], viewer: Viewer) -> list[Path]:
    """Return the pictures to write, by option, after checking that they can be, or that a window can be opened."""
    wanted = {option: save for option, save in saves.items() if save}
    for option, save in wanted.items():
        check_suffix(save, pyvista.STILLS if option == "screenshot" else {f".{option}"})
        check_save(save)
        import_extra(*_DRAWN[option], f"--{option}")
    if wanted and viewer == "open3d":
        raise LidarsimError(
            "--with open3d: Open3D only opens windows; leave it out with --screenshot, --html, --gif or --mp4"
        )
    if not wanted:
        require_display()
    return list(wanted.values())


def _check_live(path: Path, pictures: list[str], rrd: Path | None) -> None:
    """Raise an error unless the arguments of `view` are those of frames shown while they are scanned."""
    what = "--rrd" if rrd else "--live"
    if pictures:
        raise LidarsimError(f"{what}: expected no option of pictures, got {', '.join(pictures)}")
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise LidarsimError(f"{what}: expected a configuration or recipe, got {path}")
    if rrd:
        check_suffix(rrd, {".rrd"})


def _stream(run: Run, to: str | Path, names: Mapping[int, str] | None, **looks: Any) -> None:
    """Show a run while it is scanned, and tell where and how much."""
    count = len(run.numbers)
    with without_native_logs(), progress_bar() as progress:
        task = progress.add_task("scanning", total=count)
        start = time.perf_counter()
        shown = ls.stream(run, to, class_names=names, each=lambda done: progress.update(task, completed=done), **looks)
    paragraph(f"{quantity(shown, 'frame')} in {time.perf_counter() - start:.2f} s: {to}")


def _view_scene(path: Path, saves: Sequence[Path], looks: dict[str, Any]) -> None:
    """Show a scene file without points; terrain from all around, since there is no sensor, coloured by height."""
    if raster.recognise(path):
        camera = "orbit" if looks["camera"] == "behind" else looks["camera"]
        looks = {**looks, "color_by": looks["color_by"] or "height", "camera": camera}
    scene = ls.Scene.from_file(path)
    for save in saves or (None,):
        ls.show(scene, save=save, **looks)


@app.command()
def compare(
    real: Annotated[Path, make_file_argument("REAL", "Real points: a file, a bag, or a folder of these.")],
    simulated: Annotated[Path, make_file_argument("SIM", "Simulated points, likewise.")],
    *,
    output: Annotated[Path | None, make_file_option("--output -o", "HTML", "Write a report with plots.")] = None,
    json: Annotated[Path | None, make_file_option("--json", "JSON", "Write all numbers.")] = None,
    sensor: Annotated[
        str | None,
        make_option("--sensor", "NAME|FILE", "Sensor, a preset or a file, for clouds without rings or columns."),
    ] = None,
) -> None:
    """Say how simulated point clouds differ from real ones.

    REAL and SIM hold points in the sensor frame, as drivers give them. What cannot be measured, such as pulses without
    a return if there are no columns, is listed with the reason.
    """
    from lidarsim.comparison import compare_sources, reasons, source, values

    for path, suffix in ((output, ".html"), (json, ".json")):
        if path:
            check_suffix(path, {suffix})
            check_folder(path)
    sides = source("real", real), source("simulated", simulated)
    counts = [side.count for side in sides]
    total = None if None in counts else sum(filter(None, counts))
    with (
        without_native_logs(),
        progress_bar() as progress,
    ):
        task = progress.add_task("comparing", total=total)
        one, other = (
            dataclasses.replace(side, frames=_count(side.frames, lambda: progress.advance(task))) for side in sides
        )
        comparison = compare_sources(one, other, sensor)
    measured = [measure for measure in comparison if measure.verdict != "not measured"]
    paragraph(f"real {comparison.real}")
    paragraph(f"simulated {comparison.simulated}")
    columns = ("measure", "real", "simulated", "unit", "where", "verdict")
    table(columns, [(m.name, *values(m), m.unit, m.where, m.verdict) for m in measured], left=columns)
    for why, names in reasons(comparison).items():
        paragraph(f"not measured, since {why}: {', '.join(names)}")
    for note in comparison.notes:
        paragraph(f"note: {note}")
    few = sum(measure.verdict == "cannot tell" for measure in measured)
    untold = f"; of {few} these data cannot tell" if few else ""
    paragraph(f"{len(comparison.differing)} of {quantity(len(measured), 'measure')} differ{untold}")
    for path in filter(None, (output, json)):
        comparison.save(path)
        print_line(path)


def _count(items: Iterable[Item], tell: Callable[[], None]) -> Iterator[Item]:
    """Yield the items, and call a function after each."""
    for item in items:
        yield item
        tell()


@app.command()
def fit(
    real: Annotated[Path, make_file_argument("REAL", "Points of your unit: a file, a bag, or a folder.")],
    *,
    output: Annotated[Path, make_file_option("--output -o", "YAML", "Write the sensor.")],
    preset: Annotated[
        str | None,
        make_option(
            "--preset", "NAME|FILE", "Sensor to start from; default: the preset on whose beams the points are."
        ),
    ] = None,
    ground: Annotated[
        str | None, make_option("--ground", "MATERIAL", "What the ground is made of, such as asphalt.")
    ] = None,
) -> None:
    """Fit a sensor to point clouds of your own unit.

    REAL holds points in the sensor frame, as drivers give them. The table has each value of the preset, the fitted one
    with its 95 % interval, and the number of samples; values that cannot be fitted are kept, and the table says why. To
    use the file as the sensor of a run: --set 'sensor={file: SENSOR.yaml}'.
    """
    from lidarsim.comparison import fit_source, recognise, sensor_of, source, values

    check_suffix(output, {".yaml", ".yml"})
    check_folder(output)
    try:
        material = None if ground is None else ls.materials.named(ground)
    except ArgumentError as error:
        raise ArgumentValueError("--ground", error.expected, error.got, error.hint) from None
    frames = source("real", real)
    if preset is None:
        frames, preset = recognise(frames)
    start, noise = sensor_of(preset)
    if Path(preset).suffix:
        own = Path(preset).resolve()
        if own == output.resolve():
            raise ArgumentValueError("--output", "another file than --preset", str(output))
        base = {"file": json.dumps(Path(os.path.relpath(own, output.parent.resolve())).as_posix(), ensure_ascii=False)}
    else:
        base = {"preset": preset, "noise": noise or "none"}
    with without_native_logs(), progress_bar() as progress:
        task = progress.add_task("fitting", total=frames.count)
        counting = dataclasses.replace(frames, frames=_count(frames.frames, lambda: progress.advance(task)))
        lidar, comparison = fit_source(counting, start, material)
    paragraph(f"real {comparison.real}")
    paragraph(f"sensor {preset}" + (f", noise {noise}" if noise else ""))
    columns = ("value", "preset", "fitted", "unit", "samples")
    rows = [
        (measure.name, *values(measure)[::-1], measure.unit, f"{measure.n_real:,}")
        if measure.verdict != "not measured"
        else (measure.name, "", f"left: {measure.why}", "", "")
        for measure in comparison
    ]
    table(columns, rows, left=columns[:4], whole=("value",))
    for note in comparison.notes:
        paragraph(f"note: {note}")
    with atomic_writer(output) as file:
        file.write(format_fit(start, lidar, comparison, base).encode())
    print_line(output)


CHECKED = 3
"""Sequences of a recipe that `check` draws unless it is told otherwise."""


@app.command()
def check(
    config: Annotated[
        Path | None,
        make_file_argument(
            "CONFIG", "YAML configuration or recipe, or a packaged one: demo, ahead, detection, segmentation."
        ),
    ] = None,
    *,
    keys: Annotated[
        str | None,
        make_option("--keys", "SECTION", "Print the keys of a section, such as run, sensor, sphere or recipe; or all."),
    ] = None,
    sequences: Annotated[
        int | None,
        make_option("--sequences", "N", f"Sequences of a recipe to draw; default {CHECKED}.", parser=parse_integer),
    ] = None,
    screenshot: Annotated[
        Path | None, make_file_option("--screenshot", "PNG|JPG", "Draw the first frame of each sequence of a recipe.")
    ] = None,
    overrides: Overrides = None,
) -> None:
    """Check CONFIG: build all of it, scan its first and last frame, and print a summary.

    Of a recipe, draw a few sequences, and print how many objects of each group were asked for and placed, which rules
    refused places for the others, and which objects of the scene are in the sensor's way.
    """
    if keys is not None:
        from lidarsim.cli.keys import page

        if config is not None:
            raise LidarsimError(f"CONFIG: expected none with --keys, got {config}")
        print_markdown(page(keys))
        return
    if config is None:
        raise LidarsimError("CONFIG: expected a configuration or a recipe, or --keys SECTION, got none")
    path = starter.configuration(config)
    if _is_recipe(path):
        _check_recipe(path, overrides, integer("--sequences", sequences or CHECKED, at_least=1), screenshot)
        return
    for option, value in {"--sequences": sequences, "--screenshot": screenshot}.items():
        if value is not None:
            raise LidarsimError(f"{option}: expected only with a recipe, got {config}")
    _check_run(config, overrides)


def _check_run(config: Path, overrides: list[str] | None) -> None:
    """Scan the first and the last frame of a run, and print a summary."""
    run = _load(config, overrides)
    run.check_coverage()
    for part in run.parts:  # raises an error if an IMU or a receiver cannot measure along the path
        part.samples()
    notes: dict[str, None] = {}
    totals = np.zeros(len(ls.Status), np.int64)
    numbers = sorted({run.numbers[0], run.numbers[-1]})
    for number in numbers:
        for result in next(run.only(number).measured()).scans.values():
            summary = result.summary()
            totals += list(summary.values())
            notes.setdefault(summary.note)
    spans = {item.id: item.motion.span for item in run.scene if item.motion}
    print_objects(run.scene)
    for item in run.scene:
        if isinstance(item.shape, ls.TriangleMesh) and item.shape.grid:
            paragraph(describe_terrain(item.id, item.shape))
    for file in run.imports:
        print_import(file)
    for lidar in run.lidars.values():
        print_sensor(lidar, run.scene.atmosphere)
    which = f"frames {numbers[0]} and {numbers[-1]}" if len(numbers) > 1 else f"frame {numbers[0]}"
    paragraph(f"{which}: {_format_statuses(totals.tolist())}")
    for note in filter(None, notes):
        paragraph(note)
    for name, lidar in run.lidars.items():
        print_depth(name, lidar, run.scene)
    print_others(run)
    moving = [part.pose for part in run.parts if isinstance(part.pose, ls.Trajectory)]
    pose = [(moving[0].span[0], moving[-1].span[1])] if moving else []
    kinds = {"pose": pose, "objects": [*spans.values()], "all": [*pose, *spans.values()] if pose and spans else []}
    defined = {name: (max(of)[0], min(end for _, end in of)) for name, of in kinds.items() if of}
    if defined:
        defined["frames"] = run.span
        paragraph("defined: " + ", ".join(f"{name} {format_times(span)}" for name, span in defined.items()))
    legs = [quantity(len(run.legs), "strip" if moving else "station")] if run.legs else []
    counts = [quantity(len(run.scene), "object"), *legs, quantity(len(run.numbers), "frame")]
    paragraph(f"{config}: ok, {', '.join(counts)}, seed {run.seed}")


def _check_recipe(path: Path, overrides: list[str] | None, count: int, screenshot: Path | None) -> None:
    """Draw the first sequences of a recipe, and print and draw what is in them."""
    from lidarsim.datasets import recipe
    from lidarsim.datasets.sampling import samples
    from lidarsim.datasets.scattered import Scattered

    _check_screenshot(screenshot)
    made = recipe.load(path, overrides or ())

    def check(run: Run) -> None:
        run.check_coverage()
        made.layout.check(run)
        made.layout.check_labels(made.class_names, run.scene)

    for run in made.source.extremes():
        check(run)
    count = min(count, made.sequences)
    total, warnings, pictures = Scattered(), [], []
    imports: list[Imported] = []
    for sequence in track(range(count), count):
        run = made.source.run(sequence, 0)
        check(run)
        counts = made.source.scatter_counts(sequence)
        total += counts
        imports += run.imports
        meets = "comes nearer than clear_m to" if counts.near else "meets"
        for name, moment in made.source.nearby(sequence).items():
            warnings.append(f"in sequence {sequence}, the sensor {meets} {plain(name)} of the scene at {moment:.1f} s")
        (scans,) = dataclasses.replace(run, frames=range(run.frames.start, run.frames.start + 1)).scans()
        for _ in samples(made, run, sequence, 0, scans):
            pass  # raises an error if the layout cannot hold the cloud, or `after_scan` fails
        if screenshot:
            picture = screenshot.with_stem(f"{screenshot.stem}-{sequence}") if sequence else screenshot
            ls.show(scans, scene=run.scene, color_by="label", class_names=made.class_names, save=picture)
            pictures.append(picture)
    if total.groups:
        rows = [
            (plain(name, most=NAME), tally.asked, tally.placed, plain(tally.rules))
            for name, tally in total.groups.items()
        ]
        table(("group", "asked", "placed", "places refused by"), rows, left=("group", "places refused by"))
    if sizes := made.source.sizes():
        models = [f"{plain(file, most=NAME)} ({format_size(size)} m)" for file, size in sizes.items()]
        paragraph(f"models: {format_list(models)}")
    for file in dict.fromkeys(imports):
        print_import(file)
    for warning in warnings:
        paragraph(f"warning: {warning}")
    for picture in pictures:
        paragraph(f"picture: {picture}")
    drawn = f"drew {count} of {quantity(made.sequences, 'sequence')} of {quantity(made.frames, 'frame')}"
    paragraph(f"{path}: ok, {drawn}, layout {made.layout.type}, seed {made.seed}")


@app.command()
def sensors(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Preset, or file of a sensor; default: list all.")
    ] = None,
    yaml: Annotated[bool, typer.Option("--yaml", help="Print the preset's file, a template for your own.")] = False,
    screenshot: Annotated[Path | None, make_file_option("--screenshot", "PNG|SVG", "Draw the scan pattern.")] = None,
) -> None:
    """List the sensor presets, or describe one, or a sensor of your own."""
    if name is None:
        if yaml or screenshot:
            raise LidarsimError("--yaml, --screenshot: expected the NAME of a sensor with them, got none")
        rows: list[tuple[object, ...]] = []
        for preset in ls.Lidar.presets():
            lidar = ls.Lidar.preset(preset)
            does = describe(lidar.pattern)
            ends = (*np.degrees([does.azimuth, does.elevation]), (lidar.min_range, lidar.max_range))
            spans = (format_span(span, digits=3).replace(" ", "") for span in ends)
            rows.append((preset, does.rings, round(does.pulses_per_second), lidar.pattern.rate, *spans))
        columns = ("sensor", "rings", "pulses/s", "Hz", "azimuth °", "elevation °", "range m")
        table(columns, rows, left=("sensor",), whole=("sensor",))
        from lidarsim.config.loader import measured_presets

        paragraph(f"Presets with measured noise: {', '.join(measured_presets())}.")
        return
    path = Path(name) if Path(name).suffix else preset_path(name)
    lidar = ls.Lidar.from_file(path)
    if screenshot:
        pattern.draw(lidar, screenshot)
    if yaml:
        for line in path.read_text(encoding="utf-8").splitlines():
            print_line(line)
    else:
        from lidarsim.config.document import plain, read

        preset = plain(read(path)) if path.suffix in (".yaml", ".yml") else {}
        paragraph(preset.get("description", ""))
        print_sensor(lidar)
        for key in ("modes", "datasheet_noise"):
            if key in preset:
                paragraph(f"{key.replace('_', ' ')}: {', '.join(preset[key])}")
        sources = dict(preset.get("sources", {}))
        if values := format_measured(preset):
            rows = [(key, value, sources.pop(f"measured.{key}", "")) for key, value in values.items()]
            names = ("measured", "value", "source")
            table(names, rows, left=names, whole=("measured",))
        if sources:
            table(("value", "source"), list(sources.items()), left=("value", "source"), whole=("value",))


@app.command(context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []})
def bench(context: typer.Context) -> None:
    """Compare speed and accuracy with other ray casters."""
    from lidarsim.bench import main as benchmark

    raise typer.Exit(benchmark(context.args))


def _load(config: Path, overrides: list[str] | None, **settings: int | None) -> Run:
    return ls.config.load(config, _assignments(overrides, settings))


def _assignments(overrides: list[str] | None, settings: Mapping[str, int | None]) -> list[str]:
    """Return the overrides, and those that options of the command stand for."""
    return [*(overrides or []), *(f"{key}={value}" for key, value in settings.items() if value is not None)]


def _is_recipe(path: Path) -> bool:
    """Return whether a YAML file is a recipe, which has the configuration that it varies under ``run``."""
    from lidarsim.config.document import entries, read

    return "run" in entries(read(path))


def _describe(path: Path, overrides: list[str] | None, **settings: int | None) -> tuple[Run, Mapping[int, str] | None]:
    """Return the run of a configuration, or the first run of a recipe with its class names."""
    if not _is_recipe(path):
        return _load(path, overrides, **settings), None
    from lidarsim.datasets import recipe

    made = recipe.load(path, _assignments(overrides, settings))
    return made.source.run(0), made.class_names


def _check_screenshot(path: Path | None) -> None:
    """Raise an error, before any work, if a picture cannot be written."""
    if path:
        pyvista.check_screenshot(path)
        import_extra("pyvista", "pyvista", "--screenshot")


def _look_at(run: Run) -> Iterator[tuple[ls.PointCloud, Floats, float, int]]:
    """Yield the points of each frame in world coordinates, the sensor's pose, the start time and the frame number."""
    for frame in run.measured():
        if frame.scans:  # a frame of a rig may have no scans
            cloud = ls.PointCloud.concatenate(list(frame.in_world().values()))
            start = min(scan.time for scan in frame.scans.values())
            yield cloud, next(iter(frame.poses.values())), start, frame.number


def _scan(path: Path, run: Run, wanted: int | None) -> tuple[tuple[ls.PointCloud, ...], dict[str, Any], int]:
    """Return the clouds of a run, what else `show` takes for them, and the number of frames."""
    count = len(run.numbers)
    found = list(track(islice(_look_at(run), wanted), min(count, wanted or count)))
    if not found:
        raise LidarsimError(f"{path}: expected a frame with scans, got none in {quantity(count, 'frame')}")
    clouds, poses, times, numbers = zip(*found, strict=True)
    places: dict[str, Any] = {"pose": poses, "time": times}
    if count > 1:
        places["title"] = tuple(
            frame_title(number, run.numbers.index(number) + 1, count, time - run.time(run.numbers[0]))
            for number, time in zip(numbers, times, strict=True)
        )
    return clouds, places, count


def _read(
    path: Path, first: int, most: int
) -> tuple[tuple[ls.PointCloud | Mapping[str, ls.PointCloud], ...], dict[str, Any], int]:
    """Return clouds of a data set, a folder or a file, what else `show` takes for them, and the number of frames."""
    from lidarsim.datasets import reading

    first, most = integer("--frame", first, at_least=0), integer("--frames", most, at_least=1)
    found = reading.open_frames(path)
    left = most if found.count is None else max(0, min(most, found.count - first))
    with without_native_logs():  # such as lazrs's of damaged data
        frames = list(track(islice(found.read(first), left), left))
    if not frames:
        there = "" if found.count is None else f" of {quantity(found.count, 'frame')}"
        raise LidarsimError(f"{path}: --frame: expected the number of a frame{there}, got {first}")
    if found.note:
        paragraph(f"{path}: {found.note}")
    if found.count is not None and 1 < len(frames) < found.count:
        last = first + len(frames) - 1
        paragraph(f"{path}: frames {first} to {last} of {quantity(found.count, 'frame')}; --frame and --frames choose")
    places: dict[str, Any] = {
        "pose": tuple(frame.pose for frame in frames), "boxes": tuple(frame.boxes for frame in frames)
    }  # fmt: skip
    if found.count != 1:
        start = (frames[0] if first == 0 else next(found.read(0))).time or 0.0
        places["title"] = tuple(
            frame_title(number, number + 1, found.count, None if frame.time is None else frame.time - start)
            for number, frame in enumerate(frames, first)
        )
    if all("label" in cloud.fields for frame in frames for cloud in frame.clouds):
        places["color_by"] = "label"
    elif any(len(frame.clouds) > 1 for frame in frames):
        places["color_by"] = "sensor"
    return tuple(frame.cloud for frame in frames), places, found.count or len(frames)
