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
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim._base import views
from lidarsim.io import packets, rosbag
from lidarsim.motion import trajectory
from lidarsim.scan import pointcloud
from lidarsim.viewers import pattern
from lidarsim.viewers.open3d import import_open3d
from lidarsim.world import scene as scenes

THREADS, TURNS = 6, 2
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
    "rosbags.rosbag2",
    "vtkmodules.vtkRenderingFreeType",
)
"""Packages whose import may set up the process: they are imported before the first look."""


def state() -> dict[str, Any]:
    """What threads share, as far as Python and the packages in use tell."""
    import matplotlib as mpl
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
        return lambda folder: (CLOUD.save(folder / f"a{suffix}"), ls.PointCloud.load(folder / f"a{suffix}"))

    def of_poses(suffix: str) -> Callable[[Path], object]:
        return lambda folder: POSES.save(folder / f"a{suffix}")

    suffixes = {suffix for form in trajectory._FORMATS for suffix in form.suffixes}
    found = {f"points {suffix}": of_points(suffix) for suffix in pointcloud._FORMATS if suffix != ".label"}
    return found | {f"poses {suffix}": of_poses(suffix) for suffix in suffixes}


def raster(folder: Path) -> None:
    (folder / "a.asc").write_text(ASC, encoding="ascii")
    ls.TriangleMesh.from_raster(folder / "a.asc")
    CELLS.save(folder / "a.tif")
    ls.TriangleMesh.from_raster(folder / "a.tif")


def bag(folder: Path) -> None:
    with rosbag.Writer(folder / "a.mcap") as writer:
        writer.write(SCAN)
    assert len(list(rosbag.read(folder / "a.mcap"))) == 1


def capture(folder: Path) -> None:
    with packets.Writer(folder / "a.pcap", VLP16) as writer:
        writer.write(VLP16.scan(street()))


def converted(folder: Path) -> None:  # noqa: ARG001
    ls.PointCloud.from_open3d(CLOUD.to_open3d())
    ls.PointCloud.from_pyvista(CLOUD.to_pyvista())
    street().to_open3d()
    street().to_pyvista()


def model(folder: Path) -> None:
    (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="ascii")
    ls.Scene.from_file(folder / "a.obj")
    (folder / "a.xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", encoding="ascii")
    ls.Scene.from_file(folder / "a.xml")
    ls.Scene.from_file(Path(ls.__file__).parent / "starter" / "scenes" / "car.glb")


WORK: dict[str, Callable[[Path], object]] = {
    **formats(),
    "raster": raster,
    "bag": bag,
    "capture": capture,
    "converted": converted,
    "model": model,
    "map.png": lambda folder: CELLS.plot(folder / "a.png", title="車"),
    "map.svg": lambda folder: CELLS.plot(folder / "a.svg", title="車"),
    "pattern.svg": lambda folder: pattern.draw(LIDAR, folder / "a.svg"),
    "page": lambda folder: CLOUD.plot(save=folder / "a.html"),
    "picture": lambda folder: CLOUD.plot(save=folder / "a.png", size=(320, 240)),
    "comparison": lambda folder: ls.compare(CLOUD, CLOUD, sensor=LIDAR).save(folder / "a.html"),
    "rerun": lambda folder: ls.stream([SCAN], folder / "a.rrd"),
}


def test_all_kinds_take_part() -> None:
    assert len(pointcloud._FORMATS) > 8
    pictures = {"plot", "page", "summary"}
    conversions = {"pyvista", "from_pyvista", "open3d", "from_open3d"}
    files = {"from_raster", "geotiff", "to_npz", "from_npz"}
    assert {name for _, name in views._VIEWS} == pictures | conversions | files
    assert len(scenes._readers) == 4


@pytest.mark.parametrize("kind", WORK)
def test_six_threads_leave_the_process_as_it_was(kind: str, tmp_path: Path) -> None:
    tempfile.gettempdir()  # Python keeps it
    import_open3d()
    for package in HEAVY:
        importlib.import_module(package)
    for number in range(THREADS):
        (tmp_path / str(number)).mkdir()
    before = state()
    together = Barrier(THREADS)

    def work(number: int) -> None:
        for _ in range(TURNS):
            together.wait()
            WORK[kind](tmp_path / str(number))

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(work, range(THREADS)))
    after = state()
    assert {name for name in before if after[name] != before[name]} == set()


def test_a_bag_is_read_on_after_a_change_of_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with rosbag.Writer("drive/", max_duration=0.15) as writer:
        for k in range(4):
            writer.write(LIDAR.scan(street(), frame=k, time=0.1 * k))
    messages = rosbag.read("drive")
    (tmp_path / "other").mkdir()
    os.chdir("other")
    first = next(messages)
    os.chdir(tmp_path)
    assert len([first, *messages]) == 4


def test_a_package_without_its_core_says_what_to_run(tmp_path: Path) -> None:
    shutil.copy(ls.__file__, tmp_path / "__init__.py")
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
    assert last.startswith("ImportError: lidarsim has no compiled core")
    assert "run `pip install --editable .` in the clone" in last
    assert "circular" not in run.stderr
