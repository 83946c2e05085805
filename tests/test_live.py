"""What live viewers are given, and when; what is wrong with arguments."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim import live
from lidarsim.cli import main
from lidarsim.errors import ArgumentError, LidarsimError, MissingExtraError
from lidarsim.viewers._classes import class_color
from lidarsim.viewers._colors import SEQUENTIAL
from lidarsim.viewers._moment import Moment, Painter, World

FAR = (432_120.0, 5_412_490.0, 0.0)
"""A place in map coordinates; the nearest whole kilometres are 432 000 and 5 412 000."""


def street(at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ls.Scene:
    x, y, z = at
    scene = ls.Scene(class_names={10: "car", 40: "road"})
    start = np.eye(4)
    start[:3, 3] = x + 6.0, y, z
    scene.add(ls.Box((4, 2, 1.5)), label=10, name="taxi", motion=ls.Trajectory.from_twist(start, (5, 0, 0)))
    scene.add(ls.Plane.from_point((x, y, z - 1.0), (0, 0, 1)), label=40)
    scene.add(ls.Sphere((x, y + 5.0, z), 1.0), label=10, name="parked")
    return scene


def drive(at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ls.Trajectory:
    start = np.eye(4)
    start[:3, 3] = at
    return ls.Trajectory.from_twist(start, (2, 0, 0))


def rig() -> ls.Rig:
    left = np.eye(4)
    left[1, 3] = 0.5
    lidar = ls.Lidar(ls.patterns.Spinning([-0.3, -0.1, 0.0], columns=90, rate=10.0))
    return ls.Rig({"top": (lidar, None), "left": (lidar, left)})


class Recorder:
    """A viewer that keeps what it is given, with a clock that waiting moves."""

    def __init__(self, *, paced: bool = True) -> None:
        self.paced = paced
        self.world: World | None = None
        self.moments: list[Moment] = []
        self.shown_at: list[float] = []
        self.now, self.events = 50.0, ["made"]

    def __enter__(self) -> Recorder:
        self.events.append("open")
        return self

    def __exit__(self, *_: object) -> None:
        self.events.append("closed")

    def begin(self, world: World) -> None:
        self.world = world

    def wait(self, seconds: float) -> None:
        assert seconds >= 0.0
        self.now += seconds

    def show(self, moment: Moment) -> None:
        self.moments.append(moment)
        self.shown_at.append(self.now)


def watch(monkeypatch: pytest.MonkeyPatch, what: Any, recorder: Recorder | None = None, **options: Any) -> Recorder:
    made = recorder or Recorder()
    monkeypatch.setattr(live, "Rerun", lambda _, **__: made)
    monkeypatch.setattr(live, "time", SimpleNamespace(monotonic=lambda: made.now, sleep=made.wait))
    assert live.stream(what, "rerun", **options) == len(made.moments)
    return made


def test_points_are_where_they_are_in_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, body = street(), drive()
    scans = list(rig().frames(scene, body, 3))
    seen = watch(monkeypatch, iter(scans), scene=scene).moments
    assert [list(moment.sensors) for moment in seen] == [["top", "left"]] * 3
    for moment, given in zip(seen, scans, strict=True):
        for name, scan in given.items():
            expected = scan.point_cloud("world").xyz
            assert len(expected) > 50
            # Two rigid transforms of coordinates below 2^5 m: some ten roundings of 2^-53 each.
            np.testing.assert_allclose(moment.sensors[name].in_world(), expected, rtol=0, atol=2**5 * 20 * 2**-53)


def test_colours_are_those_of_the_classes(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = street()
    recorder = watch(monkeypatch, rig().frames(scene, drive(), 2), scene=scene)
    assert recorder.world is not None
    colors = {label: color for label, (_, color) in recorder.world.classes.items()}
    assert {label: name for label, (name, _) in recorder.world.classes.items()} == {10: "car", 40: "road"}
    assert colors == {10: class_color("car", 10), 40: class_color("road", 40)}
    for moment in recorder.moments:
        view = moment.sensors["top"]
        assert {*view.cloud.label.tolist()} == {10, 40}
        for label, color in colors.items():
            assert {bytes(rgb).hex() for rgb in view.rgb[view.cloud.label == label]} == {color[1:]}


def test_colours_of_numbers_keep_their_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    lidar = ls.Lidar(ls.patterns.Spinning([0.0], columns=50, rate=10.0))

    def scans() -> Iterator[ls.Scan]:
        for k, offset in enumerate((0.0, 3.0)):
            scene = ls.Scene()
            scene.add(ls.Sphere((offset, 0, 0), 5.0))
            yield lidar.scan(scene, time=k / 10, frame=k)

    _, second = watch(monkeypatch, scans(), color_by="range").moments
    view = second.sensors["lidar"]
    assert (view.cloud.range.min(), view.cloud.range.max()) == pytest.approx((2.0, 8.0), abs=0.1)
    # All ranges of the first frame are 5 m, so its limits are 4.5 m and 5.5 m; what is beyond has the last colours.
    for beyond, color in ((view.cloud.range < 4.5, SEQUENTIAL[0]), (view.cloud.range > 5.5, SEQUENTIAL[-1])):
        assert beyond.sum() > 5
        assert {bytes(rgb).hex() for rgb in view.rgb[beyond]} == {color[1:]}


def test_boxes_are_of_each_thing_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = street()
    scans = list(rig().frames(scene, drive(), 2))
    assert all(len(scan.boxes(min_points=1)) == 2 for given in scans for scan in given.values())
    for moment in watch(monkeypatch, scans, scene=scene).moments:
        assert moment.boxes is not None
        assert moment.boxes.instance.tolist() == [1, 3]
        assert moment.box_names == ["car", "car"]
        # The car's centre at the start of the frame, after some rigid transforms of coordinates below 2^3 m.
        np.testing.assert_allclose(moment.boxes.center[0], (6 + 5 * moment.time, 0, 0), rtol=0, atol=2**3 * 20 * 2**-53)
    without = watch(monkeypatch, scans, scene=scene, boxes=False)
    assert [moment.boxes for moment in without.moments] == [None, None]


def test_surfaces_move_and_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = street()
    recorder = watch(monkeypatch, rig().frames(scene, drive(), 2), scene=scene)
    assert recorder.world is not None
    assert sorted(part.name for part in recorder.world.static) == ["car", "road"]
    places = [moment.movers[0].surface.points().mean(axis=0) for moment in recorder.moments]
    np.testing.assert_array_equal(places[1] - places[0], (0.5, 0, 0))
    bare = watch(monkeypatch, rig().frames(scene, drive(), 2), scene=scene, surfaces=False)
    assert bare.world is not None
    assert (bare.world.static, bare.moments[1].movers) == ([], [])
    assert bare.world.classes  # the names of classes remain


def test_far_coordinates_have_an_origin_near_them(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = street(FAR)
    recorder = watch(monkeypatch, rig().frames(scene, drive(FAR), 1), scene=scene)
    assert recorder.world is not None
    assert recorder.world.origin.tolist() == [432_000.0, 5_412_000.0, 0.0]


def test_frames_wait_for_their_time(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = street()
    recorder = watch(monkeypatch, rig().frames(scene, drive(), 4, first=7), scene=scene)
    # Sums of numbers near 50: each is rounded by at most half an ulp, three times.
    np.testing.assert_allclose(np.diff(recorder.shown_at), 0.1, rtol=0, atol=3 * math.ulp(50.0))
    at_once = watch(monkeypatch, rig().frames(scene, drive(), 4), Recorder(paced=False), scene=scene)
    assert at_once.shown_at == [50.0] * 4


def test_each_is_called_after_each_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[int] = []
    recorder = watch(monkeypatch, rig().frames(street(), drive(), 2), each=told.append)
    assert told == [1, 2]
    assert recorder.events == ["made", "open", "closed"]


def test_a_run_has_its_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    run = ls.config.load(Path(__file__).parents[1] / "configs" / "junction.yaml", ["frames=1"])
    recorder = watch(monkeypatch, run)
    assert recorder.world is not None
    assert recorder.world.static
    assert recorder.moments[0].movers


def nothing() -> Iterator[ls.Scan]:
    yield from ()


@pytest.mark.parametrize(
    ("what", "to", "error", "message"),
    [
        (nothing, "x.rrd", ValueError, "what: expected at least one frame with a scan, got none"),
        (lambda: [{}], "x.rrd", ValueError, "what: expected at least one frame with a scan, got none"),
        (lambda: 3, "x.rrd", TypeError, "what: expected a run, or an iterable of scans, got int"),
        (dict, "x.rrd", TypeError, "what: expected a run, or an iterable of scans, got dict"),
        (lambda: [3], "x.rrd", TypeError, "what: expected a run, or an iterable of scans, got one of int"),
        (nothing, "rviz", ValueError, "to: expected rerun, a .rrd file or rerun+http"),
        (nothing, 3, TypeError, "to: expected rerun or a path, got int"),
        (nothing, "no/such/x.rrd", FileNotFoundError, "no/such/x.rrd: the folder no/such does not exist"),
    ],
)
def test_bad_arguments(
    what: Any, to: Any, error: type[Exception], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error) as caught:
        ls.stream(what(), to)
    assert str(caught.value).startswith(message)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scene": 3}, "scene: expected a Scene, got 3"),
        ({"each": 3}, "each: expected a function of the number of frames, got 3"),
        ({"class_names": 3}, "class_names: expected a mapping from labels to their names, got 3"),
        ({"boxes": 3}, "boxes: expected True or False, got 3"),
        ({"surfaces": None}, "surfaces: expected True or False, got None"),
    ],
)
def test_options_are_checked_before_a_viewer_opens(options: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=f"^{message}$"):
        ls.stream(rig().frames(street(), None, 1), tmp_path / "x.rrd", **options)
    assert list(tmp_path.iterdir()) == []


def test_a_field_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="color_by: expected one of height, "):
        ls.stream(rig().frames(street(), None, 1), tmp_path / "x.rrd", color_by="colour")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError) as caught:
        ls.stream(nothing(), tmp_path / "x.rrd")
    assert str(caught.value) == 'Rerun needs rerun: pip install "lidarsim[live]"'


def test_a_window_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(LidarsimError, match=r"no display to open a window on \(DISPLAY is not set\)"):
        ls.stream(nothing(), "rerun")


CONFIG = """\
frames: 2
sensor: {pattern: {type: spinning, elevations_deg: [0], columns: 25}}
scene: [{shape: sphere, center_m: [0, 0.5, 0], radius_m: 4}]
"""


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.yaml").write_text(CONFIG, encoding="utf-8")
    return Path("run.yaml")


def test_the_command_line_writes_a_file(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["view", str(config), "--rrd", "drive.rrd"])
    assert left.value.code == 0
    assert Path("drive.rrd").read_bytes()[:4] == b"RRF2"
    out = capsys.readouterr().out
    assert out.startswith("2 frames in ")
    assert out.endswith(" s: drive.rrd\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run.yaml", "--live", "--with", "pyvista"], "--live: expected no option of pictures, got --with"),
        (["run.yaml", "--live", "--html", "a.html"], "--live: expected no option of pictures, got --html"),
        (["run.yaml", "--rrd", "a.rrd", "--gif", "a.gif"], "--rrd: expected no option of pictures, got --gif"),
        (["run.yaml", "--rrd", "a.png"], "a.png: unknown extension '.png', expected .rrd"),
        (["run.yaml", "--rrd", "a.rrd", "--with", "open3d"], "--rrd: expected no option of pictures, got --with"),
        (["run.yaml", "--expose"], "--expose: expected only with --live"),
        (["a.pcd", "--live"], "--live: expected a configuration or recipe, got a.pcd"),
        (["a.pcd", "--rrd", "a.rrd"], "--rrd: expected a configuration or recipe, got a.pcd"),
    ],
)
def test_mistakes_get_one_line(
    config: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert config.exists()
    with pytest.raises(SystemExit) as left:
        main(["view", *arguments])
    assert left.value.code == 2
    assert capsys.readouterr().err == f"lidarsim: {message}\n"


def test_without_labels_the_intensity_colours() -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 5.0))
    painter = Painter(scene)
    scan = ls.Lidar(ls.patterns.Spinning([0.0], columns=4)).scan(scene)
    assert painter._coloring([scan.point_cloud()]).field == "intensity"
    assert Painter(street())._color_by == "label"
