"""Readers, writers and pictures, each in six threads at once, change nothing that all threads of the process share."""

from __future__ import annotations

import decimal
import faulthandler
import gc
import importlib
import locale
import logging
import multiprocessing
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim import lidar
from lidarsim._base import views
from lidarsim.comparison._sources import source
from lidarsim.datasets.layouts import LAYOUTS
from lidarsim.datasets.reading import open_frames
from lidarsim.io import las, packets, rosbag
from lidarsim.io.meshes import SUFFIXES
from lidarsim.io.packets import _format
from lidarsim.motion import formats as trajectories
from lidarsim.run import Run
from lidarsim.run._output import OUTPUTS
from lidarsim.scan.formats import FORMATS
from lidarsim.viewers import pattern
from lidarsim.viewers.open3d import import_open3d
from lidarsim.world import scene as scenes
from tests.io import mutations

THREADS = 6
HEAVY = (
    "laspy",
    "matplotlib.pyplot",
    "mujoco",
    "plotly.graph_objects",
    "plotly.graph_objs._deprecations",
    "plotly.io",
    "plotly.tools",
    "pye57",
    "pyproj",
    "pyvista",
    "rasterio",
    "rerun",
    "rich.console",
    "rosbags.rosbag2",
    "vtkmodules.vtkRenderingFreeType",
)
"""Packages whose import may set up the process: they are imported before the first look."""


def state() -> dict[str, Any]:
    """What threads share, as far as Python and the packages in use tell."""
    import matplotlib as mpl
    import mujoco
    import open3d
    import plotly.io
    from vtkmodules.vtkCommonCore import vtkLogger
    from vtkmodules.vtkRenderingCore import vtkTextRenderer

    umask = os.umask(0o22)
    os.umask(umask)
    return {
        "hooks": (sys.excepthook, sys.unraisablehook, sys.displayhook, warnings.showwarning),
        "warnings": list(warnings.filters),
        "streams": (sys.stdin, sys.stdout, sys.stderr, *(os.fstat(number).st_ino for number in (0, 1, 2))),
        "folder": os.getcwd(),  # noqa: PTH109 - as text
        "environment": dict(os.environ),
        "path": list(sys.path),
        "locale": locale.setlocale(locale.LC_ALL),
        "umask": umask,
        "signals": {number: signal.getsignal(number) for number in signal.valid_signals()},
        "logging": (logging.root.level, list(logging.root.handlers), logging.root.manager.disable),
        "printing": np.get_printoptions(),
        "random": (random.getstate(), str(np.random.get_state())),  # noqa: NPY002 - the one that all share
        "decimal": decimal.DefaultContext.prec,
        "limits": (sys.getrecursionlimit(), sys.getswitchinterval(), gc.isenabled(), faulthandler.is_enabled()),
        "places": (tempfile.tempdir, socket.getdefaulttimeout(), multiprocessing.get_start_method(allow_none=True)),
        "matplotlib": {name: value for name, value in mpl.rcParams.items() if name != "backend"},
        "plotly": (plotly.io.templates.default, plotly.io.renderers.default),
        "vtk": (vtkLogger.GetCurrentVerbosityCutoff(), vtkTextRenderer.GetInstance().GetDefaultBackend()),
        "open3d": open3d.utility.get_verbosity_level(),
        "mujoco": mujoco.get_mju_user_warning(),
    }


def street() -> ls.Scene:
    scene = ls.Scene(class_names={1: "road", 2: "car 車"})
    scene.add(ls.Plane((0, 0, 1), -1.8), label=1)
    scene.add(ls.Box((4, 2, 1.5), center=(8, 0, -1)), label=2, name="taxi")
    return scene


VLP16 = ls.Lidar.preset("velodyne-vlp16")
LIDAR = ls.Lidar(ls.patterns.Spinning([-0.2, -0.1], columns=90))
SCAN = LIDAR.scan(street())
CLOUD = SCAN.point_cloud()
POSES = ls.Trajectory([0.0, 1.0, 2.0], np.stack([np.eye(4)] * 3))
CELLS = ls.PointCloud(xyz=np.random.default_rng(0).uniform(0, 5, (1000, 3))).raster("z", cell=0.5)
ASC = "ncols 6\nnrows 6\nxllcorner 0\nyllcorner 0\ncellsize 1\n" + ("1 " * 6 + "\n") * 6


def formats() -> dict[str, Callable[[Path], object]]:
    def of_points(suffix: str) -> Callable[[Path], object]:
        def save_and_load(folder: Path) -> None:
            CLOUD.save(folder / f"a{suffix}")
            ls.PointCloud.load(folder / f"a{suffix}")

        return save_and_load

    def of_poses(suffix: str) -> Callable[[Path], object]:
        return lambda folder: POSES.save(folder / f"a{suffix}")

    suffixes = {suffix for form in trajectories._FORMATS for suffix in form.suffixes}
    found = {f"points {suffix}": of_points(suffix) for suffix in FORMATS if suffix != ".label"}
    return found | {f"poses {suffix}": of_poses(suffix) for suffix in sorted(suffixes)}


def raster(folder: Path) -> None:
    (folder / "a.asc").write_text(ASC, encoding="ascii")
    ls.TriangleMesh.from_raster(folder / "a.asc")
    CELLS.save(folder / "a.tif")
    ls.TriangleMesh.from_raster(folder / "a.tif")


def bag(folder: Path) -> None:
    with rosbag.Writer(folder / "a.mcap") as writer:
        writer.write(SCAN)
    assert len(list(rosbag.read(folder / "a.mcap"))) == 1


def outputs() -> dict[str, Callable[[Path], object]]:
    def of(name: str) -> Callable[[Path], object]:
        return lambda folder: a_run().write(f"{folder}/a{name}")

    suffixes = {suffix for kind in OUTPUTS for suffix in kind.suffixes} | {"/"} - {".label"}
    return {f"run {suffix}": of(suffix) for suffix in sorted(suffixes)}


def captures() -> dict[str, Callable[[Path], object]]:
    """One capture of each format of packets, of a preset whose model has it."""
    presets = map(ls.Lidar.preset, ls.Lidar.presets())
    found = {packets.format_of(lidar).name: lidar for lidar in presets if has_packets(lidar)}

    def of(lidar: ls.Lidar) -> Callable[[Path], object]:
        def write(folder: Path) -> None:
            with packets.Writer(folder / "a.pcap", lidar) as writer:
                writer.write(lidar.scan(street()))

        return write

    return {f"capture of {name}": of(lidar) for name, lidar in found.items()}


def has_packets(lidar: ls.Lidar) -> bool:
    try:
        packets.format_of(lidar)
    except ls.errors.FileFormatError:
        return False
    return True


def data_sets() -> dict[str, Callable[[Path], object]]:
    def of(layout: str) -> Callable[[Path], object]:
        def make_and_read(folder: Path) -> None:
            make_set(layout)(f"{folder}/a")
            assert list(open_frames(folder / "a").read(0))

        return make_and_read

    return {f"data set {layout}": of(layout) for layout in LAYOUTS}


def convert(folder: Path) -> None:  # noqa: ARG001
    ls.PointCloud.from_open3d(CLOUD.to_open3d())
    ls.PointCloud.from_pyvista(CLOUD.to_pyvista())
    street().to_open3d()
    street().to_pyvista()


WORK: dict[str, Callable[[Path], object]] = {
    **formats(),
    **outputs(),
    **captures(),
    **data_sets(),
    "raster": raster,
    "bag": bag,
    "converted": convert,
    "map.png": lambda folder: CELLS.plot(folder / "a.png", title="車"),
    "map.svg": lambda folder: CELLS.plot(folder / "a.svg", title="車"),
    "pattern.svg": lambda folder: pattern.draw(LIDAR, folder / "a.svg"),
    "page": lambda folder: CLOUD.plot(save=folder / "a.html"),
    "picture": lambda folder: CLOUD.plot(save=folder / "a.png", size=(320, 240)),
    "comparison": lambda folder: ls.compare(CLOUD, CLOUD, sensor=LIDAR).save(folder / "a.html"),
    "rerun": lambda folder: ls.stream([SCAN], folder / "a.rrd"),
}


def test_all_kinds_take_part() -> None:
    assert len(FORMATS) > 8
    pictures = {"plot", "page", "summary"}
    conversions = {"pyvista", "from_pyvista", "open3d", "from_open3d"}
    files = {"from_raster", "geotiff", "to_npz", "from_npz"}
    assert {name for _, name in views._VIEWS} == pictures | conversions | files
    assert {f"capture of {form.name}" for form in _format._formats.values()} <= WORK.keys()


@pytest.fixture(scope="module")
def ready() -> None:
    """Import what may set up the process when it is imported."""
    tempfile.gettempdir()  # Python keeps it
    import_open3d()
    for package in HEAVY:
        importlib.import_module(package)


def changes_of(work: Callable[[int], object]) -> set[str]:
    """What six threads change of the process that do some work, each with its number."""
    before = state()
    together = Barrier(THREADS)

    def at_once(number: int) -> None:
        together.wait()
        work(number)

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(at_once, range(THREADS)))
    after = state()
    return {name for name in before if after[name] != before[name]}


@pytest.mark.slow("no call changes the state of its process while others run")
@pytest.mark.parametrize("kind", WORK)
@pytest.mark.usefixtures("ready")
def test_six_threads_leave_the_process_as_it_was(kind: str, tmp_path: Path) -> None:
    for number in range(THREADS):
        (tmp_path / str(number)).mkdir()
    assert changes_of(lambda number: WORK[kind](tmp_path / str(number))) == set()


@pytest.mark.slow("no call changes the state of its process while others run")
@pytest.mark.usefixtures("ready")
def test_six_threads_that_read_leave_the_process_as_it_was(tmp_path: Path) -> None:
    """Every sound file whose mutations are read, which include one at least of each kind that is registered."""
    found = [*mutations.samples(tmp_path), *mutations.texts(tmp_path)]
    heads = {path: path.read_bytes()[: 1 << 16].decode("utf-8", errors="replace") for _, path, _ in found}
    for name, (recognise, _) in lidar._readers.items():
        assert any(recognise(path, head) for path, head in heads.items()), name
    for name, (recognise_scene, _) in scenes._readers.items():
        assert any(recognise_scene(path, head.encode()) for path, head in heads.items()), name
    assert {path.suffix for path in heads} >= {*FORMATS, *SUFFIXES} - {".pcd.bin"}
    disturbed = {}
    for name, path, read in found:
        if name not in {"scene_file", "heightfield"}:  # which move the file
            what = changes_of(lambda _: read(path))  # noqa: B023
            if what:
                disturbed[name] = what
    assert disturbed == {}


class Frames:
    """Four scans; between them, the folder of the process is another one."""

    def __iter__(self) -> Iterator[ls.Scan]:
        home = Path.cwd()
        for k in range(4):
            os.chdir(home / "other")
            yield LIDAR.scan(street(), frame=k, time=0.1 * k)
        os.chdir(home)


def write_bag(path: str) -> None:
    with rosbag.Writer(path, max_duration=0.15 if path.endswith("/") else None) as writer:
        for scan in Frames():
            writer.write(scan)


def write_strip(path: str) -> None:
    with las.Writer(path) as writer:
        for scan in Frames():
            writer.write(scan.point_cloud())


def write_packets(path: str) -> None:
    with packets.Writer(path, VLP16) as writer:
        for k, _ in enumerate(Frames()):
            writer.write(VLP16.scan(street(), frame=k, time=0.1 * k))


def write_run(path: str) -> None:
    home = Path.cwd()
    written = a_run().write(path, each=lambda _: os.chdir(home / "other"))
    os.chdir(home)
    assert all(file.exists() and not file.is_absolute() for file in written)


def a_run() -> Run:
    return ls.config.load("demo", ["frames=3", "sensor.preset=velodyne-vlp16"])


WRITERS: dict[str, Callable[[str], object]] = {
    "drive/": write_bag,
    "drive.mcap": write_bag,
    "strip.laz": write_strip,
    "drive.pcap": write_packets,
    "run/": write_run,
    "run.mcap": write_run,
    "run.pcap": write_run,
    "run.ply": write_run,
    "film.gif": lambda path: ls.show(Frames(), save=path, size=(64, 48)),
    "page.html": lambda path: ls.show(Frames(), save=path),
    "live.rrd": lambda path: ls.stream(Frames(), path),
}


@pytest.mark.parametrize("path", WRITERS)
def test_a_change_of_folder_moves_no_output(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other").mkdir()
    WRITERS[path](path)
    assert list((tmp_path / "other").iterdir()) == []
    names = [file.name for file in tmp_path.iterdir()]
    assert any(name.startswith(path.partition(".")[0].rstrip("/")) for name in names)


def make_files(folder: str) -> None:
    Path(folder).mkdir()
    for k in range(4):
        CLOUD.save(f"{folder}/{k}.las")


def make_set(layout: str) -> Callable[[str], object]:
    def scenes(rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Lidar, None]:  # noqa: ARG001
        return street(), LIDAR, None

    return lambda folder: ls.generate(scenes, folder, frames=4, layout=layout, class_names={2: "car"}, pictures=0)


MADE: dict[str, Callable[[str], object]] = {"files": make_files, "bag": lambda _: write_bag("files/")} | {
    name: make_set(name) for name in LAYOUTS
}


def damage(folder: Path) -> None:
    for file in folder.rglob("*"):
        if file.is_file() and file.suffix not in {".json", ".yaml", ".txt", ".html"}:
            file.write_bytes(file.read_bytes()[: file.stat().st_size // 2] if file.suffix != ".bin" else b"abc")


READ: dict[str, tuple[str, Callable[[str], Iterator[object]]]] = {
    **{f"data set {name}": (name, lambda path: open_frames(Path(path)).read(0)) for name in MADE},
    "compared": ("files", lambda path: source("real", path).frames),
    "compared files": ("files", lambda path: source("real", [f"{path}/{k}.las" for k in range(4)]).frames),
    "bag": ("bag", rosbag.read),
    "strip": ("files", lambda path: las.read(f"{path}/0.las")),
}


@pytest.mark.parametrize("kind", READ)
def test_a_change_of_folder_reads_the_same_files(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other").mkdir()
    made, read = READ[kind]
    MADE[made]("files")
    count = len(list(read("files")))
    items = read("files")
    os.chdir("other")
    assert len(list(items)) == count >= 1
    os.chdir(tmp_path)
    items = read("files")
    damage(tmp_path / "files")
    os.chdir("other")
    with pytest.raises((ls.errors.LidarsimError, OSError), match=r"^files") as told:
        list(items)
    assert str(tmp_path) not in str(told.value)


@pytest.mark.parametrize("core", ["", '__version__ = "0.0.1"\n'])
def test_a_package_without_its_core_says_what_to_run(core: str, tmp_path: Path) -> None:
    shutil.copy(ls.__file__, tmp_path / "__init__.py")
    if core:
        (tmp_path / "_native.py").write_text(core, encoding="ascii")
    code = (
        "import importlib.util as u, sys; s = u.spec_from_file_location('lidarsim', sys.argv[1],"
        " submodule_search_locations=[sys.argv[2]]); m = u.module_from_spec(s); sys.modules['lidarsim'] = m;"
        " s.loader.exec_module(m)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "__init__.py"), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    last = run.stderr.splitlines()[-1]
    expected = f"{ls.__version__} in {tmp_path} has the compiled core of 0.0.1" if core else "has no compiled core"
    assert last.startswith(f"ImportError: lidarsim {expected}")
    assert "run `pip install --editable .` in the clone" in last
    assert "circular" not in run.stderr
