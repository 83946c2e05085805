"""The command line: ``lidarsim new | scan | generate | stream | view | compare | sensors | check | bench``."""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from itertools import islice
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress
from typer.main import get_command

import lidarsim as ls
from lidarsim import _native as core
from lidarsim._base.extras import import_extra
from lidarsim._base.files import check_folder, check_suffix, told
from lidarsim._base.shown import counted, plain
from lidarsim._base.terminal import facts, paragraph, print_line, say, standard_streams, table, without_native_logs
from lidarsim._base.validation import integer, shown
from lidarsim.comparison import compare_sources, reasons, source, values
from lidarsim.config import starter
from lidarsim.errors import ArgumentError, LidarsimError
from lidarsim.io import packets, raster
from lidarsim.lidar import preset_path
from lidarsim.patterns import describe
from lidarsim.run import Run, RunFrame, checked_output
from lidarsim.run import _output as outputs
from lidarsim.run.packets import pcap
from lidarsim.scan.formats import is_point_cloud
from lidarsim.viewers import pattern, pyvista
from lidarsim.viewers._display import require_display
from lidarsim.viewers._show import check_save, checked_size, frame_title, together_title
from lidarsim.viewers.rerun import NAME as RERUN
from lidarsim.world.scene import is_scene_file

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.io.scenes import Imported

app = typer.Typer(
    help="Exact and fast lidar simulation.", add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
)


Item = TypeVar("Item")

ROWS = 10
"""Maximum rows of the table that a scan of many frames prints."""
NAME = 60
"""Maximum characters of a name in a table."""
MOST_FRAMES = 100
"""Maximum frames of a data set that `view` shows unless it is told otherwise."""
_DRAWN = {
    "screenshot": ("pyvista", "pyvista"),
    "html": ("plotly", "html"),
    "gif": ("pyvista", "pyvista"),
    "mp4": ("imageio_ffmpeg", "video"),
}
"""Package that each kind of picture needs, and the extra that installs it."""


class Viewer(StrEnum):
    """A library that shows point clouds."""

    PYVISTA = "pyvista"
    OPEN3D = "open3d"


class Camera(StrEnum):
    """Camera position of a picture."""

    BEHIND = "behind"
    BIRDS_EYE = "birds-eye"
    FIRST_PERSON = "first-person"
    ORBIT = "orbit"
    TOP = "top"


class ColorMap(StrEnum):
    """Colours of numbers."""

    MAGMA = "magma"
    VIRIDIS = "viridis"
    CIVIDIS = "cividis"
    GREY = "grey"


class Background(StrEnum):
    """Colour of the background of a picture."""

    DARK = "dark"
    WHITE = "white"


def _path(text: str) -> Path:
    if not text:  # `Path` would make it the current folder
        raise typer.BadParameter("expected a path, got an empty one")
    return Path(text)


def _output(text: str) -> str:
    return text if _path(text) else ""


def _integer(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"expected an integer, got {shown(text)}") from None


def _real(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"expected a number, got {shown(text)}") from None


def _option(names: str, metavar: str, text: str, **more: Any) -> Any:
    return typer.Option(*names.split(), metavar=metavar, help=text, show_default=False, **more)


def _file(names: str, metavar: str, text: str) -> Any:
    return _option(names, metavar, text, parser=_path)


OPTIONS = {
    "color_by": "--color-by",
    "limits": "--limits",
    "pictures": "--pictures",
    "sensor": "--sensor",
    "size": "--size",
    **{name: option.flag.partition("/")[0] for name, option in outputs.options().items()},
}
"""Options by the Python arguments that they set: errors of the command line name the option."""

Configuration = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="YAML configuration, or a packaged one: demo, ahead.", parser=_path)
]
Overrides = Annotated[
    list[str] | None, _option("--set", "KEY=VALUE", "Override a value in CONFIG, e.g. scene.0.radius_m=2.")
]
Seed = Annotated[int | None, _option("--seed", "N", "Noise seed; overrides CONFIG.", parser=_integer)]
Frame = Annotated[int | None, _option("--frame", "N", "Number of the first frame; overrides CONFIG.", parser=_integer)]
Frames = Annotated[int | None, _option("--frames", "N", "Number of frames; overrides CONFIG.", parser=_integer)]
Screenshot = Annotated[Path | None, _file("--screenshot", "PNG|JPG", "Write a picture; needs no display.")]
ColorBy = Annotated[str | None, _option("--color-by", "FIELD", "Colour the points by this field, or by height.")]
Surfaces = Annotated[
    bool, typer.Option("--surfaces/--no-surfaces", help="Show the surfaces of the scene with the points.")
]
View = Annotated[Camera, _option("--camera", "|".join(Camera), "Camera position.")]
Size = Annotated[str, _option("--size", "WIDTHxHEIGHT", "Size of windows and pictures in pixels; default 1600x1000.")]


def _with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of all kinds of output, which it takes as ``**options``."""
    own = inspect.signature(command, eval_str=True)
    texts = {int: _integer, float: _real}
    named = [parameter for parameter in own.parameters.values() if parameter.kind is not inspect.Parameter.VAR_KEYWORD]
    for name, option in outputs.options().items():
        if option.kind is bool:
            info = typer.Option(option.flag, help=option.help)
        else:
            info = _option(option.flag, option.metavar, option.help, parser=texts.get(option.kind))
        annotation = Annotated[option.kind | None, info]  # type: ignore[name-defined] # known when it runs
        named.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation))
    command.__signature__ = own.replace(parameters=named)  # type: ignore[attr-defined]
    return command


def _version(asked: bool) -> None:
    if asked:
        paragraph(f"lidarsim {ls.__version__}, core with {core.isa()} and {core.threads()} threads")
        raise typer.Exit


@app.callback()
def _options(
    _: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


@app.command()
def new(folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="New or empty folder.", parser=_path)]) -> None:
    """Make a project in FOLDER to start from: scene, sensor, runs, a recipe, a script and notes."""
    files = starter.new_project(folder)
    print_line(f"{folder}: {', '.join(path.as_posix() for path in files)}")
    print_line(f"next: cd {plain(folder)} && lidarsim scan demo.yaml --output street.pcd")
    print_line(f"{folder / 'README.md'} explains the files and lists what else to run")


@app.command()
@_with_options
def scan(
    config: Configuration,
    *,
    output: Annotated[
        str,
        _option(
            "--output -o",
            "OUT",
            "Point cloud file, all frames in a ROS 2 bag (.mcap, .db3, or a folder, ending in /), or packets (.pcap).",
            parser=_output,
        ),
    ],
    overrides: Overrides = None,
    seed: Seed = None,
    frame: Frame = None,
    frames: Frames = None,
    screenshot: Screenshot = None,
    color_by: ColorBy = None,
    surfaces: Surfaces = True,
    camera: View = Camera.BEHIND,
    size: Size = "1600x1000",
    **options: Any,
) -> None:
    """Scan the scene in CONFIG and write the point cloud.

    With several frames, each frame gets its own numbered file, and the sensor poses (OUT_poses.tum) and the start times
    of the frames (OUT_times.txt) are written next to them. Each pose is that at the start of its frame, or at the time
    to which the points are deskewed. With a rig, each sensor gets its own files. A ROS 2 bag (.mcap, .db3) holds all of
    this in one file. Packets (.pcap), as the sensors send them, are in one file too; next to it are the poses, the
    times and what decoders need. Strips and stations are numbered; a strip is one LAS or LAZ file.
    """
    place = checked_output(output)
    given = {name: outputs.options()[name].parse(value) for name, value in options.items() if value is not None}
    _check_screenshot(screenshot)
    looks: dict[str, Any] = {"color_by": color_by, "camera": camera.value, "size": _size(size)}
    start = time.perf_counter()
    run = _load(config, overrides, seed=seed, first_frame=frame, frames=frames)
    run.check_places(place, screenshot)
    looks["scene"] = run.scene if surfaces else None
    totals = np.zeros(len(ls.Status), np.int64)
    notes: dict[str, None] = {}
    rows: list[tuple[object, ...]] = []
    points = 0

    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress:
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
    fates = {status.name.lower().replace("_", " "): count for status, count in zip(ls.Status, totals, strict=True)}
    paragraph(f"{totals.sum():,} pulses: " + ", ".join(f"{count:,} {name}" for name, count in fates.items() if count))
    for note in filter(None, notes):
        paragraph(note)
    files = ", ".join(
        map(str, [*run.output(place).pattern(run), *([run.path_of(screenshot, "*", "*")] if screenshot else [])])
    )
    count = f"{len(rows):,} frames, " * (len(rows) > 1)
    paragraph(f"{count}{points:,} points in {time.perf_counter() - start:.2f} s: {files}")


@app.command()
def generate(
    recipe: Annotated[
        Path | None,
        typer.Argument(metavar="RECIPE", help="YAML recipe, or a packaged one: detection, segmentation.", parser=_path),
    ] = None,
    *,
    output: Annotated[str, _option("--output -o", "FOLDER|URL", "Output folder, or a URL such as s3://bucket/folder.")],
    workers: Annotated[
        int | None, _option("--workers", "N", "Run N single-threaded processes.", parser=_integer)
    ] = None,
    scheduler: Annotated[
        str | None, _option("--scheduler", "ADDRESS", "Run on a Dask cluster, e.g. tcp://host:8786.")
    ] = None,
    shard: Annotated[str | None, _option("--shard", "I/N", "Make only part I of N, counting from 0.")] = None,
    verify: Annotated[
        bool,
        typer.Option("--verify", help="Compare all existing files with the manifest; with RECIPE, repair them."),
    ] = False,
    pictures: Annotated[
        int, _option("--pictures", "N", "Number of frames to show in the data card; default 3.", parser=_integer)
    ] = 3,
    overrides: Annotated[
        list[str] | None, _option("--set", "KEY=VALUE", "Override a value in RECIPE, e.g. frames=100.")
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
                f"{output}: {counted(len(problems), 'file')} not as in the manifest: {problems[0]}; "
                "`lidarsim generate RECIPE -o FOLDER --verify` makes them again"
            )
        paragraph(f"{output}: all files match the manifest")
        return
    if recipe is None:
        raise LidarsimError("RECIPE: expected a recipe, or --verify, got neither")
    from lidarsim.datasets.engine import cluster

    with cluster(workers, scheduler) as client:
        if client is not None and client.dashboard_link:
            paragraph(f"dashboard: {client.dashboard_link}")
        made = ls.generate(
            recipe,
            output,
            client=client,
            part=_part(shard),
            overrides=overrides or (),
            pictures=pictures,
            verify=verify,
        )
    paragraph(f"{counted(made.frames, 'frame')}, {made.points:,} points in {made.seconds:.1f} s: {output}")
    if made.made_again:
        paragraph(f"made again: {_listed([plain(name, most=NAME) for name in made.made_again])}")
    elif verify and not made.frames:
        paragraph(f"{output}: all files match the manifest")
    for line in made.left_out:
        paragraph(f"scattered: {plain(line)}")
    if made.shards_left:
        paragraph(f"still missing: {counted(made.shards_left, 'shard')} of other parts")


def _part(text: str | None) -> tuple[int, int]:
    if text is None:
        return 0, 1
    found = re.fullmatch(r"([0-9]{1,18})/([0-9]{1,18})", text)
    if found is None or not int(found[1]) < int(found[2]):
        raise LidarsimError(f"--shard: expected I/N with I from 0 to N - 1, got {shown(text)}")
    return int(found[1]), int(found[2])


@app.command()
def stream(
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="YAML configuration, or a packaged one: ahead.", parser=_path)
    ],
    *,
    to: Annotated[
        str,
        _option(
            "--to",
            "HOST[:PORT]",
            "Where to send: a name, an IPv4 address or [IPV6]; default 127.0.0.1 and the vendor's port.",
        ),
    ] = "127.0.0.1",
    fast: Annotated[bool, typer.Option("--fast", help="Send as fast as possible, not at the sensor's rate.")] = False,
    variant: Annotated[
        str | None, _option("--variant", "NAME", "Layout of the packets; default: the first of the vendor's.")
    ] = None,
    metadata: Annotated[
        Path | None, _file("--metadata", "FILE", "Write what decoders need besides the packets, such as Ouster's JSON.")
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
        run.check_unread(*pcap(run, metadata.with_suffix(".pcap"), variant=variant).files[1:])
    with packets.Sender(run.lidars, to, start=run.clock, variant=variant, fast=fast) as sender:
        if metadata:
            for path in (written := sender.save_metadata(metadata)):
                print_line(path)
            if not written:
                paragraph("--metadata: the decoders of these packets need no file")
        start, end = run.span
        try:
            if repeat:
                sender.send(run.scans, repeat=math.inf, period=end - start)
            else:
                sender.send(_progress(run.scans(), len(run.numbers)))
        except KeyboardInterrupt:
            _print_sent(to, sender.sent, None if fast else 1.0 / run.rate)
            raise
        _print_sent(to, sender.sent, None if fast else 1.0 / run.rate)


def _print_sent(to: str, sent: packets.Sent, period: float | None) -> None:
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


@app.command()
def view(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="Point cloud, bag, data set (SemanticKITTI, nuScenes, KITTI detection, shards), folder of these, "
            "configuration, recipe, or scene file: GLB, MJCF, GeoTIFF, …; or a packaged configuration: demo.",
            parser=_path,
        ),
    ],
    *,
    viewer: Annotated[
        Viewer | None,
        _option("--with", "|".join(Viewer), "Library of the window; default: pyvista."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Show the frames of a configuration in Rerun while they are scanned.")
    ] = False,
    expose: Annotated[
        bool, typer.Option("--expose", help="Let other machines reach the viewer that --live opens.")
    ] = False,
    rrd: Annotated[Path | None, _file("--rrd", "RRD", "Write the same to a file for Rerun.")] = None,
    screenshot: Screenshot = None,
    html: Annotated[Path | None, _file("--html", "HTML", "Write a self-contained web page.")] = None,
    gif: Annotated[
        Path | None, _file("--gif", "GIF", "Write an animation of all frames, or an orbit around a single one.")
    ] = None,
    mp4: Annotated[Path | None, _file("--mp4", "MP4", "Same as --gif, but as a video.")] = None,
    color_by: ColorBy = None,
    surfaces: Surfaces = True,
    camera: View = Camera.BEHIND,
    size: Size = "1600x1000",
    limits: Annotated[
        str | None, _option("--limits", "LOW,HIGH", "Values at the ends of the colours; default: those of the points.")
    ] = None,
    color_map: Annotated[ColorMap | None, _option("--color-map", "|".join(ColorMap), "Colours of numbers.")] = None,
    background: Annotated[Background, _option("--background", "|".join(Background), "Colour.")] = Background.DARK,
    title: Annotated[str | None, _option("--title", "TEXT", "Title; default: number and time of the frame.")] = None,
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
    path = starter.configuration(path)
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
        run, names = _described(path, overrides, seed=seed, first_frame=frame, frames=frames)
        _stream(run, rrd or RERUN, names, expose=expose, color_by=color_by, surfaces=surfaces)
        return
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    viewer = viewer or Viewer.PYVISTA
    saves = _checked_saves({"screenshot": screenshot, "html": html, "gif": gif, "mp4": mp4}, viewer)
    looks: dict[str, Any] = {
        "color_by": color_by, "camera": camera.value, "size": _size(size), "viewer": viewer.value,
        "limits": _limits(limits), "color_map": color_map and color_map.value, "background": background.value,
        "title": title,
    }  # fmt: skip
    wanted = 1 if saves == [screenshot] and not accumulate else None
    clouds: tuple[ls.PointCloud | Mapping[str, ls.PointCloud], ...]
    if path.suffix.lower() in (".yaml", ".yml"):
        run, names = _described(path, overrides, seed=seed, first_frame=frame, frames=frames)
        run.check_unread(*saves)
        clouds, places, count = _scanned(path, run, wanted)
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
        clouds, places, count = _read(path, frame or 0, wanted or frames or MOST_FRAMES)
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
            paragraph(f"{save}: {which} of {counted(count, 'frame')}; --html, --gif and --mp4 show all")


def _checked_saves(saves: Mapping[str, Path | None], viewer: Viewer) -> list[Path]:
    """Return the pictures to write, by option, after checking that they can be, or that a window can be opened."""
    wanted = {option: save for option, save in saves.items() if save}
    for option, save in wanted.items():
        check_suffix(save, pyvista.STILLS if option == "screenshot" else {f".{option}"})
        check_save(save)
        import_extra(*_DRAWN[option], f"--{option}")
    if wanted and viewer is Viewer.OPEN3D:
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
    with (
        without_native_logs(),
        Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress,
    ):
        task = progress.add_task("scanning", total=count)
        start = time.perf_counter()
        shown = ls.stream(run, to, class_names=names, each=lambda done: progress.update(task, completed=done), **looks)
    paragraph(f"{counted(shown, 'frame')} in {time.perf_counter() - start:.2f} s: {to}")


def _view_scene(path: Path, saves: Sequence[Path], looks: dict[str, Any]) -> None:
    """Show a scene file without points; terrain from all around, since there is no sensor, coloured by height."""
    if raster.recognise(path):
        camera = Camera.ORBIT.value if looks["camera"] == Camera.BEHIND else looks["camera"]
        looks = {**looks, "color_by": looks["color_by"] or "height", "camera": camera}
    scene = ls.Scene.from_file(path)
    for save in saves or (None,):
        ls.show(scene, save=save, **looks)


@app.command()
def compare(
    real: Annotated[
        Path, typer.Argument(metavar="REAL", help="Real points: a file, a bag, or a folder of these.", parser=_path)
    ],
    simulated: Annotated[Path, typer.Argument(metavar="SIM", help="Simulated points, likewise.", parser=_path)],
    *,
    output: Annotated[Path | None, _file("--output -o", "HTML", "Write a report with plots.")] = None,
    json: Annotated[Path | None, _file("--json", "JSON", "Write all numbers.")] = None,
    sensor: Annotated[
        str | None,
        _option(
            "--sensor", "NAME|FILE", "Sensor, a preset or a file, that tells the columns of clouds which have none."
        ),
    ] = None,
) -> None:
    """Say how simulated point clouds differ from real ones.

    REAL and SIM hold points in the sensor frame, as drivers give them. What a cloud does not tell, such as the pulses
    without a return if there are no columns, is not measured, and the output says why.
    """
    for path, suffix in ((output, ".html"), (json, ".json")):
        if path:
            check_suffix(path, {suffix})
            check_folder(path)
    sides = source("real", real), source("simulated", simulated)
    counts = [side.count for side in sides]
    total = None if None in counts else sum(filter(None, counts))
    with (
        without_native_logs(),
        Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress,
    ):
        task = progress.add_task("comparing", total=total)
        one, other = (
            dataclasses.replace(side, frames=_counted(side.frames, lambda: progress.advance(task))) for side in sides
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
    paragraph(f"{len(comparison.differing)} of {counted(len(measured), 'measure')} differ{untold}")
    for path in filter(None, (output, json)):
        comparison.save(path)
        print_line(path)


def _counted(items: Iterable[Item], tell: Callable[[], None]) -> Iterator[Item]:
    """Yield the items, and call a function after each."""
    for item in items:
        yield item
        tell()


CHECKED = 3
"""Sequences of a recipe that `check` draws unless it is told otherwise."""


@app.command()
def check(
    config: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG",
            help="YAML configuration or recipe, or a packaged one: demo, detection, segmentation.",
            parser=_path,
        ),
    ],
    *,
    sequences: Annotated[
        int | None, _option("--sequences", "N", f"Sequences of a recipe to draw; default {CHECKED}.", parser=_integer)
    ] = None,
    screenshot: Annotated[
        Path | None, _file("--screenshot", "PNG|JPG", "Draw the first frame of each sequence of a recipe.")
    ] = None,
    overrides: Overrides = None,
) -> None:
    """Check CONFIG: build all of it, scan its first and last frame, and print a summary.

    Of a recipe, draw a few sequences, and print how many objects of each group were asked for and placed, which rules
    refused places for the others, and which objects of the scene are in the sensor's way.
    """
    path = starter.configuration(config)
    if _is_recipe(path):
        _check_recipe(path, overrides, integer("--sequences", sequences or CHECKED, at_least=1), screenshot)
        return
    for option, value in {"--sequences": sequences, "--screenshot": screenshot}.items():
        if value is not None:
            raise LidarsimError(f"{option}: expected only with a recipe, got {config}")
    run = _load(config, overrides)
    run.check_coverage()
    notes: dict[str, None] = {}
    for number in sorted({run.numbers[0], run.numbers[-1]}):
        frame = next(run.only(number).measured())
        notes |= dict.fromkeys(scan.summary().note for scan in frame.scans.values())
    spans = {item.id: item.motion.span for item in run.scene if item.motion}
    meshes = [item.shape for item in run.scene if isinstance(item.shape, ls.TriangleMesh)]
    degenerate = any(mesh.degenerate_count for mesh in meshes)
    columns: tuple[str, ...] = ("object", "shape", "name", "label", "reflectivity")
    columns += ("triangles",) * bool(meshes) + ("degenerate",) * degenerate + ("moves",) * bool(spans)
    rows = []
    for item in run.scene:
        mesh = item.shape if isinstance(item.shape, ls.TriangleMesh) else None
        triangles: tuple[int | None, ...] = (None, None) if mesh is None else (len(mesh), mesh.degenerate_count)
        triangles = triangles[: bool(meshes) + degenerate]
        label = "by face" if isinstance(item.label, np.ndarray) else item.label
        moves = (_times(spans[item.id]) if item.id in spans else None,) if spans else ()
        rows.append(
            (
                item.id,
                type(item.shape).__name__,
                plain(item.name, most=NAME),
                label,
                item.material.reflectivity if item.material.per == "object" else f"by {item.material.per}",
                *triangles,
                *moves,
            )
        )
    table(columns, rows, left=("shape", "name"), whole=("shape", "reflectivity"))
    for item in run.scene:
        if isinstance(item.shape, ls.TriangleMesh) and item.shape.grid:
            paragraph(_terrain(item.id, item.shape))
    for file in run.imports:
        _print_import(file)
    for lidar in run.lidars.values():
        _print_sensor(lidar, run.scene.atmosphere)
    for note in filter(None, notes):
        paragraph(note)
    for name, lidar in run.lidars.items():
        _print_depth(name, lidar, run.scene)
    _print_others(run)
    moving = [part.pose for part in run.parts if isinstance(part.pose, ls.Trajectory)]
    pose = [(moving[0].span[0], moving[-1].span[1])] if moving else []
    kinds = {"pose": pose, "objects": [*spans.values()], "all": [*pose, *spans.values()] if pose and spans else []}
    defined = {name: (max(of)[0], min(end for _, end in of)) for name, of in kinds.items() if of}
    if defined:
        defined["frames"] = run.span
        paragraph("defined: " + ", ".join(f"{name} {_times(span)}" for name, span in defined.items()))
    legs = [counted(len(run.legs), "strip" if moving else "station")] if run.legs else []
    counts = [counted(len(run.scene), "object"), *legs, counted(len(run.numbers), "frame")]
    paragraph(f"{config}: ok, {', '.join(counts)}, seed {run.seed}")


def _check_recipe(path: Path, overrides: list[str] | None, count: int, screenshot: Path | None) -> None:
    """Draw the first sequences of a recipe, and print and draw what is in them."""
    from lidarsim.datasets import recipe
    from lidarsim.datasets.scattered import Scattered

    _check_screenshot(screenshot)
    made = recipe.load(path, overrides or ())
    count = min(count, made.sequences)
    total, warnings, pictures = Scattered(), [], []
    for sequence in _progress(range(count), count):
        run = made.source.run(sequence, 0)
        run.check_coverage()
        made.layout.check(run)
        made.layout.check_labels(made.class_names, run.scene)
        total += made.source.scattered(sequence)
        for name, moment in made.source.nearby(sequence).items():
            warnings.append(f"in sequence {sequence}, the sensor meets {plain(name)} of the scene at {moment:.1f} s")
        (scans,) = dataclasses.replace(run, frames=range(run.frames.start, run.frames.start + 1)).scans()
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
    for warning in warnings:
        paragraph(f"warning: {warning}")
    for picture in pictures:
        paragraph(f"picture: {picture}")
    drawn = f"drew {count} of {counted(made.sequences, 'sequence')} of {counted(made.frames, 'frame')}"
    paragraph(f"{path}: ok, {drawn}, layout {made.layout.type}, seed {made.seed}")


def _print_others(run: Run) -> None:
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


def _print_import(file: Imported) -> None:
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
            paragraph(f"  {what}: {_listed([f'{plain(name, most=NAME)} ({count})' for name, count in names.items()])}")
    if file.left_out:
        paragraph(f"  left out: {', '.join(file.left_out)}")
    if file.skipped:
        paragraph(f"  skipped by rules: {counted(file.skipped, 'part')}")
    if file.without_rule:
        paths = [plain(path, most=NAME) for path in file.without_rule]
        paragraph(f"  no rule matches {counted(len(paths), 'node')}: {_listed(paths)}")
    if size.max() > LARGEST or size.max() < SMALLEST:
        wrong = f"larger than {LARGEST / 1e3:g} km" if size.max() > LARGEST else f"smaller than {SMALLEST * 100:g} cm"
        paragraph(f"  warning: {wrong}; is unit_m right?")


def _listed(names: list[str]) -> str:
    """Return the first names, and how many there are beside them."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {more:,} more" if more > 0 else "")


@app.command()
def sensors(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Preset; default: list all.")] = None,
    yaml: Annotated[bool, typer.Option("--yaml", help="Print the preset's file, a template for your own.")] = False,
    screenshot: Annotated[Path | None, _file("--screenshot", "PNG|SVG", "Draw the scan pattern.")] = None,
) -> None:
    """List the sensor presets, or describe one."""
    if name is None:
        if yaml or screenshot:
            raise LidarsimError("--yaml, --screenshot: expected the NAME of a sensor with them, got none")
        rows: list[tuple[object, ...]] = []
        for preset in ls.Lidar.presets():
            lidar = ls.Lidar.preset(preset)
            does = describe(lidar.pattern)
            ends = (*np.degrees([does.azimuth, does.elevation]), (lidar.min_range, lidar.max_range))
            spans = (_span(span, digits=3).replace(" ", "") for span in ends)
            rows.append((preset, does.rings, round(does.pulses_per_second), lidar.pattern.rate, *spans))
        columns = ("sensor", "rings", "pulses/s", "Hz", "azimuth °", "elevation °", "range m")
        table(columns, rows, left=("sensor",), whole=("sensor",))
        from lidarsim.config.loader import measured

        paragraph(f"Presets with measured noise: {', '.join(measured())}.")
        return
    path = preset_path(name)
    if screenshot:
        pattern.draw(ls.Lidar.preset(name), screenshot)
    if yaml:
        for line in path.read_text(encoding="utf-8").splitlines():
            print_line(line)
    else:
        from lidarsim.config.document import plain, read

        preset = plain(read(path))
        paragraph(preset.get("description", ""))
        _print_sensor(ls.Lidar.preset(name))
        for key in ("modes", "datasheet_noise"):
            if key in preset:
                paragraph(f"{key.replace('_', ' ')}: {', '.join(preset[key])}")
        sources = dict(preset.get("sources", {}))
        if values := _measured(preset):
            rows = [(key, value, sources.pop(f"measured.{key}", "")) for key, value in values.items()]
            names = ("measured", "value", "source")
            table(names, rows, left=names, whole=("measured",))
        table(("value", "source"), list(sources.items()), left=("value", "source"), whole=("value",))


@app.command(context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []})
def bench(context: typer.Context) -> None:
    """Compare speed and accuracy with other ray casters."""
    from lidarsim.bench import main as benchmark

    raise typer.Exit(benchmark(context.args))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with 0, or with 2 and one line on stderr after an error.

    The exit code is 130 after Ctrl-C and 141 after a broken pipe, as in shells. The traceback of an error is shown in
    Python's development mode (``python -X dev -m lidarsim``).

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: the arguments of the process.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    code: object = 0
    with standard_streams():
        try:
            with _insistent_interrupts():
                _run(given or ["--help"])
        except (typer.Exit, SystemExit) as end:
            code = end.exit_code if isinstance(end, typer.Exit) else end.code
        except KeyboardInterrupt:
            code = 130
        except BrokenPipeError:  # of stdout; errors of files name the file
            code = 141
        except BaseException as error:  # a panic of the core is not an `Exception`
            if sys.flags.dev_mode:
                raise
            say(_reason(error))
            code = 2
    sys.exit(code)  # type: ignore[arg-type]


def _run(arguments: list[str]) -> None:
    try:
        with get_command(app).make_context("lidarsim", arguments) as context:
            context.command.invoke(context)
    finally:
        sys.stdout.flush()  # output of libraries; a failure must not wait for interpreter exit


@contextmanager
def _insistent_interrupts() -> Iterator[None]:
    """Make Ctrl-C end the block; if the exception is lost, raise it again a second later or at the end of the block.

    Python drops exceptions in callbacks, of which imports run many, and some libraries drop any exception.
    """
    main = threading.main_thread()
    if threading.current_thread() is not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    repeats: list[threading.Timer] = []

    def repeat(number: int) -> None:
        if sys.platform == "win32":
            signal.raise_signal(number)
        else:  # which also wakes a sleeping thread
            signal.pthread_kill(main.ident or 0, number)

    def interrupt(number: int, frame: FrameType | None) -> None:
        repeats.append(threading.Timer(1.0, repeat, [number]))
        repeats[-1].daemon = True
        repeats[-1].start()
        signal.default_int_handler(number, frame)

    report = sys.unraisablehook

    def report_others(dropped: sys.UnraisableHookArgs) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            report(dropped)

    signal.signal(signal.SIGINT, interrupt)
    sys.unraisablehook = report_others
    try:
        yield
        if repeats:
            raise KeyboardInterrupt
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = report
        for timer in repeats:
            timer.cancel()


def _reason(error: BaseException) -> str:
    """Return the message of an error for the user."""
    if isinstance(error, OSError) and error.errno is not None:  # from the system; the message of ours names the path
        return told(error)
    if hasattr(error, "format_message"):  # typer's errors about arguments, whichever module defines them
        return str(error.format_message())
    text = str(error) or type(error).__name__
    if isinstance(error, ArgumentError):
        option = OPTIONS.get(error.argument.partition("[")[0], error.argument)
        return f"{option}{text.removeprefix(error.argument)}"
    if isinstance(error, MemoryError):
        return text if "memory" in text else f"out of memory: {text}"
    if isinstance(error, LidarsimError | OSError | ValueError | TypeError):
        return text
    return f"internal error, please report it: {type(error).__name__}: {text}"


def _load(config: Path, overrides: list[str] | None, **settings: int | None) -> Run:
    given = [f"{key}={value}" for key, value in settings.items() if value is not None]
    return ls.config.load(config, [*(overrides or []), *given])


def _is_recipe(path: Path) -> bool:
    """Return whether a YAML file is a recipe, which has the configuration that it varies under ``run``."""
    from lidarsim.config.document import entries, read

    return "run" in entries(read(path))


def _described(path: Path, overrides: list[str] | None, **settings: int | None) -> tuple[Run, Mapping[int, str] | None]:
    """Return the run of a configuration, or the first run of a recipe with its class names."""
    if not _is_recipe(path):
        return _load(path, overrides, **settings), None
    from lidarsim.datasets import recipe

    given = [f"{key}={value}" for key, value in settings.items() if value is not None]
    made = recipe.load(path, [*(overrides or []), *given])
    return made.source.run(0), made.class_names


def _check_screenshot(path: Path | None) -> None:
    """Raise an error, before any work, if a picture cannot be written."""
    if path:
        pyvista.check_screenshot(path)
        import_extra("pyvista", "pyvista", "--screenshot")


def _seen(run: Run) -> Iterator[tuple[ls.PointCloud, Floats, float, int]]:
    """Yield the points of each frame in world coordinates, the sensor's pose, the start time and the frame number."""
    for frame in run.measured():
        if frame.scans:  # a frame of a rig may have no scans
            cloud = ls.PointCloud.concatenate(list(frame.in_world().values()))
            start = min(scan.time for scan in frame.scans.values())
            yield cloud, next(iter(frame.poses.values())), start, frame.number


def _scanned(path: Path, run: Run, wanted: int | None) -> tuple[tuple[ls.PointCloud, ...], dict[str, Any], int]:
    """Return the clouds of a run, what else `show` takes for them, and the number of frames."""
    count = len(run.numbers)
    found = list(_progress(islice(_seen(run), wanted), min(count, wanted or count)))
    if not found:
        raise LidarsimError(f"{path}: expected a frame with scans, got none in {counted(count, 'frame')}")
    clouds, poses, times, numbers = zip(*found, strict=True)
    places: dict[str, Any] = {"pose": poses, "time": times}
    if count > 1:
        places["title"] = tuple(
            frame_title(number, run.numbers.index(number) + 1, count, time)
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
        frames = list(_progress(islice(found.read(first), left), left))
    if not frames:
        there = "" if found.count is None else f" of {counted(found.count, 'frame')}"
        raise LidarsimError(f"{path}: --frame: expected the number of a frame{there}, got {first}")
    if found.note:
        paragraph(f"{path}: {found.note}")
    if found.count is not None and 1 < len(frames) < found.count:
        last = first + len(frames) - 1
        paragraph(f"{path}: frames {first} to {last} of {counted(found.count, 'frame')}; --frame and --frames choose")
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


def _progress(items: Iterable[Item], count: int) -> Iterator[Item]:
    """Yield the items, with a progress bar if stderr is a terminal."""
    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress:
        yield from progress.track(items, total=count, description="reading")


def _limits(text: str | None) -> tuple[float, float] | None:
    """Parse limits such as 0,50; `lidarsim.show` checks their order."""
    if text is None:
        return None
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        raise LidarsimError(f"--limits: expected LOW,HIGH, such as 0,50, got {shown(text)}") from None
    return low, high


def _size(text: str) -> tuple[int, int]:
    """Parse a size such as 1600x1000 as width and height."""
    found = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    if found is None:
        raise LidarsimError(f"--size: expected WIDTHxHEIGHT in pixels, such as 1600x1000, got {shown(text)}")
    return checked_size((int(found[1]), int(found[2])))


def _span(ends: Iterable[float], *, digits: int = 4) -> str:
    low, high = (f"{end:.{digits}g}" for end in ends)
    return low if low == high else f"{low} … {high}"


def _measured(preset: Mapping[str, Any]) -> dict[str, str]:
    """Return the values in the ``measured`` block of a preset's document, by their keys there."""
    block = dict(preset.get("measured", {}))
    effects = {f"measurement.{key}": value for key, value in block.pop("measurement", {}).items()}
    return {key: _yaml_line(value) for key, value in (effects | block).items()}


def _yaml_line(value: object) -> str:
    """Return a plain value as YAML has it on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_yaml_line(item)}" for key, item in value.items()) + "}"
    return str(value)


def _times(span: tuple[float, float]) -> str:
    return "always" if math.isinf(span[0]) else f"{_span(span, digits=12)} s"


def _terrain(number: int, mesh: ls.TriangleMesh) -> str:
    """Return the size, the holes, the extent and the coordinate reference system of a mesh of heights."""
    rows, columns = mesh.grid or (0, 0)
    holes = rows * columns - len(mesh.vertices)
    x, y, z = (_span(ends, digits=10) for ends in mesh.bounds.T)
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


def _print_depth(name: str, lidar: ls.Lidar, scene: ls.Scene) -> None:
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


def _print_sensor(lidar: ls.Lidar, air: ls.Atmosphere | None = None) -> None:
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
        "azimuth": f"{_span(np.degrees(does.azimuth))} °",
        "elevation": f"{_span(np.degrees(does.elevation))} °",
        "ring to ring": f"{_span(np.degrees(does.elevation_gap))} °",
        "pulse to pulse": f"{_span(np.degrees(does.pulse_gap))} °",
        "time": f"{1e3 * seconds:.4g} ms from first to last pulse, longest pause {1e3 * does.pause:.4g} ms",
        "range": f"{_span((lidar.min_range, lidar.max_range))} m",
        "measurement": ", ".join(f"{name} {value}" for name, value in effects.items()) or "exact",
    }
    if air:
        lines["air"] = f"{air}, {_air(air, lidar)}"
    known = {name: value for name, value in lines.items() if "nan" not in value}
    facts({"sensor": lidar.name or "(no name)", **known})
    for question in _questions(lidar):
        paragraph(f"  warning: {question}")
