"""One function that shows everything: what it takes, where it looks from, and the films and pages that it writes."""

from __future__ import annotations

import copy
import inspect
import pickle
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import lidarsim as ls
from lidarsim._base.shown import plain
from lidarsim._base.views import Looks
from lidarsim.errors import ArgumentError
from lidarsim.viewers import _display, html
from lidarsim.viewers._classes import class_color
from lidarsim.viewers._colors import MISSING, QUALITATIVE, coloring
from lidarsim.viewers._picture import Frame, Picture, View

SIZE = (320, 200)
COLORS = [
    list(bytes.fromhex(color[1:])) for color in (class_color("road"), QUALITATIVE[7], class_color("house")) if color
]
"""Colours of the labels in `street`: by the meaning of the objects' names, and by number."""


def street() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), 0.0), name="road", label=40)
    scene.add(ls.Sphere((8, 2, 1), 1.0), name="ball", label=7)
    scene.add(ls.Box((2, 6, 3), (12, 0, 1.5)), name="house", label=50)
    return scene


def mast(x: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, 0, 1.7
    return pose


@pytest.fixture(scope="module")
def scans() -> list[ls.Scan]:
    pattern = ls.patterns.Grid(np.linspace(-1.2, 1.2, 60), np.linspace(-0.5, 0.2, 40), rate=10)
    lidar = ls.Lidar(pattern)
    return [lidar.scan(street(), mast(0.5 * k), frame=k) for k in range(3)]


def project(view: View, points: np.ndarray, aspect: float) -> np.ndarray:
    """Where points are in a picture: from -1 to 1 across and up; nan behind the eye."""
    back = view.eye - view.target
    back = back / np.linalg.norm(back)
    right = np.cross(view.up, back)
    right /= np.linalg.norm(right)
    x, y, z = ((points - view.eye) @ axis for axis in (right, np.cross(back, right), back))
    depth = np.where(z < 0, -z, np.nan) * np.tan(view.angle / 2)
    return np.stack([x / depth / aspect, y / depth], axis=-1)


@pytest.mark.parametrize("camera", ["behind", "birds-eye", "orbit"])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.5])
def test_nothing_is_cropped_and_nothing_is_far_away(camera: Any, aspect: float, scans: list[ls.Scan]) -> None:
    cloud = scans[0].point_cloud("world")
    cloud.xyz = cloud.xyz[:, [1, 0, 2]] * [3, 1, 1] + [1e6, 2e6, 0]
    pose = mast()
    pose[:3, 3] += [1e6, 2e6, 0]
    picture = Picture([Frame(cloud, pose)], [], np.empty((0, 3)), coloring([cloud], "range"), camera, 10.0)
    seen = picture.points_to_show()
    for turn in (0.0, 1.0) if camera == "orbit" else (0.0,):
        places = project(picture.view(0, seen, aspect, turn=turn), seen, aspect)
        assert np.abs(places).max() <= 1.0
        assert np.abs(places).max() > 0.9
        ends = np.stack([places.min(axis=0), places.max(axis=0)])
        assert np.abs(ends.sum(axis=0)).min() < 0.15  # in the middle, one way or the other


@pytest.mark.parametrize("camera", ["behind", "birds-eye", "orbit"])
def test_the_axes_of_a_sensor_apart_from_its_points_are_not_cropped(camera: Any) -> None:
    cloud = ls.PointCloud(xyz=np.random.default_rng(5).uniform([4, -8, -2], [20, 8, 0], (500, 3)))
    pose = mast() * [[-1], [-1], [1], [1]]  # turned away from the points
    picture = Picture([Frame(cloud, pose)], [], np.empty((0, 3)), coloring([cloud], None), camera, 10.0)
    seen = picture.points_to_show()
    length = 0.06 * np.linalg.norm(seen - seen.mean(axis=0), axis=1).max()
    places = project(picture.view(0, seen, 1.6), pose[:3, 3] + length * pose[:3, :3].T, 1.6)
    assert np.abs(places).max() <= 1.0


def test_first_person_looks_ahead_from_the_sensor(scans: list[ls.Scan]) -> None:
    cloud = scans[1].point_cloud("world")
    picture = Picture([Frame(cloud, mast(3))], [], np.empty((0, 3)), coloring([cloud], "range"), "first-person", 10.0)
    view = picture.view(0, picture.points_to_show(), 1.6)
    assert view.eye == pytest.approx([3, 0, 1.7])
    assert project(view, np.array([[9.0, 0, 1.7]]), 1.6) == pytest.approx(np.zeros((1, 2)), abs=16 * 2.0**-53)
    assert project(view, np.array([[9.0, 5.9, 1.7]]), 1.6)[0, 0] == pytest.approx(-0.98, abs=0.01)  # left is left


def test_plot_is_show(scans: list[ls.Scan], tmp_path: Path) -> None:
    looks: dict[str, Any] = {"scene": street(), "color_by": "label", "size": SIZE}
    ls.show(scans[0], save=tmp_path / "a.png", **looks)
    scans[0].plot(save=tmp_path / "b.png", **looks)
    scans[0].point_cloud("world").plot(save=tmp_path / "c.png", pose=mast(), **looks)
    ls.show({"top": scans[0]}, save=tmp_path / "d.png", **looks)
    first, *others = ((tmp_path / f"{name}.png").read_bytes() for name in "abcd")
    assert len(first) > 3000
    assert others == [first] * 3
    street().plot(save=tmp_path / "e.png", size=SIZE)
    image = np.asarray(Image.open(tmp_path / "e.png").convert("RGB")).astype(int)
    for color in COLORS:  # the legend has the classes of the surfaces
        assert (np.abs(image[:, 240:] - color) < 9).all(axis=-1).sum() > 20


def test_legends_have_the_names_of_clouds_scenes_and_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    from lidarsim.viewers import pyvista

    legends: list[dict[int, str]] = []
    monkeypatch.setattr(pyvista, "draw", lambda picture, *_, **__: legends.append(picture.colors.names))
    scene = ls.Scene(class_names={40: "road", 8: "tree"})
    scene.add(ls.Plane((0, 0, 1), 0.0), label=40)
    scan = ls.Lidar(ls.patterns.Grid([0.0], [-0.5, -0.4], rate=10)).scan(scene, mast())
    bin_ = ls.PointCloud(xyz=np.ones((2, 3)), label=[5, 6], class_names={5: "bin"})
    for what, options in (
        (scan, {}),
        ({"top": scan, "left": scan}, {}),
        (scan.point_cloud("world"), {}),
        ([scan.point_cloud("world"), bin_], {}),
        (bin_, {"scene": scene}),
        (bin_, {"scene": scene, "class_names": {6: "can"}}),
    ):
        ls.show(what, color_by="label", save="a.png", **options)  # type: ignore[arg-type]
    road = {40: "road"}
    assert legends == [road] * 3 + [{5: "bin", 6: "6"} | road] * 2 + [{5: "5", 6: "can", 40: "40"}]


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_films_play_all_frames(suffix: str, scans: list[ls.Scan], tmp_path: Path) -> None:
    path = tmp_path / f"film.{suffix}"
    ls.show(scans, scene=street(), color_by="label", save=path, size=SIZE)
    if suffix == "gif":
        images = []
        with Image.open(path) as film:
            assert (film.n_frames, film.size, film.info["duration"]) == (3, SIZE, 100)
            for number in range(3):
                film.seek(number)
                images.append(np.asarray(film.convert("RGB")).astype(int))
        assert np.abs(images[0] - images[1]).mean() > 0.1
        for color in COLORS:  # no class loses its colour to the palette
            assert np.abs(images[0][:, 240:] - color).max(axis=-1).min() <= 8
    else:
        import imageio_ffmpeg

        frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
        assert (frames, seconds) == (3, pytest.approx(0.3, abs=0.01))
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def crossing() -> ls.Scene:
    """A house, and a ball that rolls past it to the left, 4 m/s."""
    scene = ls.Scene()
    scene.add(ls.Box((2, 6, 3), (12, 0, 1.5)), label=50)
    ends = np.array([np.eye(4), np.eye(4)])
    ends[:, 1, 3] = -4, 4
    scene.add(ls.Sphere((8, 0, 1), 1.0), label=7, motion=ls.Trajectory([0, 2], ends))
    return scene


def test_what_moves_is_where_each_frame_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    from lidarsim.viewers import pyvista

    pictures: list[Picture] = []
    monkeypatch.setattr(pyvista, "draw", lambda picture, *_, **__: pictures.append(picture))
    scene = crossing()
    grid = ls.Lidar(ls.patterns.Grid([0.0, 0.1], [0.0, -0.1], rate=2))
    scans = list(grid.frames(scene, mast(), count=3))
    clouds = [scan.point_cloud("world") for scan in scans]
    for what, time in ((scans, None), (clouds, [0.0, 0.5, 1.0]), (clouds, 1.5), (clouds[0], None), (clouds, None)):
        ls.show(what, scene=scene, time=time, save="a.png")
    ls.show(scene, time=9.0, save="a.png")  # past the end of its motion
    found = [
        [[float(mover.points()[:, 1].mean()) for mover in frame.movers] for frame in picture.frames]
        for picture in pictures
    ]
    # Vertices about a centre within 4 m, each rounded by 2⁻⁵¹.
    expected = [[[-4], [-2], [0]]] * 2 + [[[2]] * 3, [[-4]], [[]] * 3, [[4]]]
    for got, want in zip(found, expected, strict=True):
        np.testing.assert_allclose(got, want, rtol=0, atol=4 * 2.0**-51)
    assert {tuple(surface.object_id for surface in picture.surfaces) for picture in pictures} == {(0,)}
    for time, message in (
        ([0.0], "time: expected one for each of the 3 frames, got 1"),
        (np.nan, "time: expected a finite number, got nan"),
        ([0, np.inf, 1], r"time\[1\]: expected a finite number, got inf"),
    ):
        with pytest.raises(ValueError, match=message):
            ls.show(clouds, time=time, save="a.png")


def test_films_and_pages_move_what_moves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    y, z = np.meshgrid(np.linspace(-5, 5, 40), np.linspace(0, 3, 9))
    wall = ls.PointCloud(xyz=np.stack([np.full(y.size, 13.0), y.ravel(), z.ravel()], 1), label=np.full(y.size, 50))
    looks: dict[str, Any] = {"scene": crossing(), "time": [0.6, 1.4], "color_by": "label", "size": SIZE}
    ls.show([wall, wall], save=tmp_path / "a.gif", camera=[(0, 0, 1), (1, 0, 1), (0, 0, 1)], **looks)
    with Image.open(tmp_path / "a.gif") as film:
        images = []
        for number in range(2):
            film.seek(number)
            images.append(np.asarray(film.convert("RGB")).astype(int)[:, :240])
    changed = np.abs(images[0] - images[1]).max(axis=-1) > 8
    assert changed[:, :100].sum() > 50  # to the left it came,
    assert changed[:, 140:].sum() > 50  # and from the right it went
    assert changed[:, 110:130].sum() == 0
    figures: list[Any] = []
    draw = html._figure
    monkeypatch.setattr(html, "_figure", lambda *given: figures.append(draw(*given)) or figures[-1])
    ls.show([wall, wall], save=tmp_path / "a.html", **looks)
    (page,) = figures
    # float32 has numbers below 4 to 2⁻²³.
    balls = [[trace for trace in frame.data if trace.type == "mesh3d"] for frame in page.frames]
    assert [[float(np.mean(trace.y)) for trace in frame] for frame in balls] == [
        pytest.approx([y], abs=2.0**-21) for y in (-1.6, 1.6)
    ]
    assert [trace.type for trace in page.data].count("mesh3d") == 2  # the ball of the first frame, and the house


def test_a_window_chooses_its_frame_by_a_slider(scans: list[ls.Scan], monkeypatch: pytest.MonkeyPatch) -> None:
    import pyvista

    sliders: list[Any] = []
    visible: list[set[str]] = []

    def look(plotter: Any, **_options: Any) -> None:
        (((choose, ends), options),) = sliders
        assert (ends, options["value"]) == ((1, 3), 1)
        for value in (1, 2.7, 1.2):
            choose(value)
            actors = plotter.renderers[0].actors.items()
            visible.append({name for name, actor in actors if actor.GetVisibility()})

    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    monkeypatch.setattr(pyvista, "OFF_SCREEN", True)
    holder = getattr(pyvista.Plotter(off_screen=True), "widgets", None)
    kind = pyvista.Plotter if holder is None else type(holder)
    add = kind.add_slider_widget

    def record(holder: Any, *given: Any, **options: Any) -> Any:
        sliders.append((given, options))
        return add(holder, *given, **options)  # which fails here if it only warns of what it is given

    monkeypatch.setattr(kind, "add_slider_widget", record)
    monkeypatch.setattr(pyvista.Plotter, "show", look)
    ls.show(scans, size=SIZE)
    first, last, again = visible
    assert first == again
    assert len(first) == len(last)
    assert len(first - last) == 4  # a cloud and three axes


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"camera": "above"},
            "camera: expected behind, birds-eye, first-person, orbit, top or three points, got 'above'",
        ),
        ({"viewer": "paraview"}, "viewer: expected 'pyvista' or 'open3d', got 'paraview'"),
        ({"size": (0, 100)}, "size[0]: expected an integer from 16 to 16384, got 0"),
        ({"pose": [np.eye(4)] * 2}, "pose: expected one for each of the 3 frames, got 2"),
        ({"color_by": "smell"}, "color_by: expected one of height, range, "),
        ({"save": "a.bmp"}, "a.bmp: unknown extension '.bmp', expected .gif, .html, .jpg, .mp4 or .png"),
        ({"save": 3}, "save: expected a path, got 3"),
        ({"scene": 3}, "scene: expected a Scene, got 3"),
        ({"size": 5}, "size: expected a sequence of pixels, got 5"),
        ({"size": (100,)}, "size: expected a width and a height, got 1 number"),
        ({"size": (100, 100, 100)}, "size: expected a width and a height, got 3 numbers"),
        ({"pose": 3}, "pose: expected a sequence of poses, got 3"),
        ({"pose": [np.eye(4), np.eye(3), np.eye(4)]}, "pose[1]: expected shape (4, 4), got (3, 3)"),
        ({"boxes": 3}, "boxes: expected a sequence of Boxes, got 3"),
        ({"title": 3}, "title: expected a sequence of texts, got 3"),
        ({"time": [[0], [0, 1], 2]}, "time[0]: expected a finite number, got [0]"),
        ({"background": ["dark"]}, "background: expected 'dark' or 'white', got ['dark']"),
        ({"color_map": ["magma"]}, "color_map: expected 'magma', 'viridis', 'cividis' or 'grey', got ['magma']"),
        ({"viewer": ["pyvista"]}, "viewer: expected 'pyvista' or 'open3d', got ['pyvista']"),
        ({"point_size": -1}, "point_size: expected a finite number > 0, got -1.0"),
        ({"point_size": "x"}, "point_size: expected a finite number > 0, got 'x'"),
        ({"class_names": 3}, "class_names: expected a mapping from labels to their names, got 3"),
        ({"class_names": {"1": "car"}}, "class_names, its keys: expected an integer from 0 to 4294967295, got '1'"),
        ({"accumulate": 2}, "accumulate: expected True or False, got 2"),
        (
            {"camera": np.zeros((3, 3))},
            "camera: expected a target apart from the position and an up vector across the view, got others",
        ),
        (
            {"camera": [[0, 0, 9], [0, 0, 0], [0, 0, 1]]},
            "camera: expected a target apart from the position and an up vector across the view, got others",
        ),
    ],
)
@pytest.mark.parametrize("suffix", ["png", "html"])
def test_bad_arguments(
    options: Any, message: str, suffix: str, scans: list[ls.Scan], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever draws the picture."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ArgumentError, ls.errors.FileFormatError)) as caught:
        ls.show([scan.point_cloud() for scan in scans], **{"save": f"a.{suffix}", **options})
    assert str(caught.value).startswith(message)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("what", [3, None])
def test_what_cannot_be_shown(what: Any) -> None:
    with pytest.raises(ArgumentError, match=f"^what: expected point clouds, scans or a scene, got {what}$"):
        ls.show(what, save="a.png")


def test_looks_are_checked_beside_a_scene_as_well(tmp_path: Path) -> None:
    for options in ({"point_size": 0}, {"accumulate": None}, {"class_names": [1]}, {"camera": np.ones((3, 3))}):
        with pytest.raises(ArgumentError, match=f"^{next(iter(options))}: expected "):
            street().plot(save=tmp_path / "a.png", **options)


def test_the_keywords_of_plot_are_those_of_show() -> None:
    parameters = [p for p in inspect.signature(ls.show).parameters.values() if p.kind is p.KEYWORD_ONLY]
    looks = {name: kind.__forward_arg__ for name, kind in Looks.__annotations__.items()}
    below = {"Scene": "Plotted", "Boxes": "Boxed"}  # as rooms below those of scenes and boxes call them
    shown = {p.name: re.sub(r"\b(Scene|Boxes)\b", lambda found: below[found[0]], p.annotation) for p in parameters}
    assert looks == shown


def test_points_in_the_sensor_frame_are_not_shown_in_the_world(
    scans: list[ls.Scan], monkeypatch: pytest.MonkeyPatch
) -> None:
    from lidarsim.viewers import pyvista

    pictures: list[Picture] = []
    monkeypatch.setattr(pyvista, "draw", lambda picture, *_, **__: pictures.append(picture))
    cloud, world = scans[1].point_cloud(), scans[1].point_cloud("world")
    kept = [cloud, cloud[::2], cloud.copy(), copy.copy(cloud), pickle.loads(pickle.dumps(cloud)),  # noqa: S301
            ls.PointCloud.concatenate([cloud, cloud])]  # fmt: skip
    for points in kept:
        with pytest.raises(ValueError, match=r"^what: expected points in world coordinates beside the scene, got"):
            points.plot(scene=street(), save="a.png")
    with pytest.raises(ValueError, match=r"^what\[1\]: expected points in world coordinates beside the scans, got"):
        ls.show([scans[0], cloud], save="a.gif")
    assert not pictures
    for points, looks in (
        (cloud, {"scene": street(), "pose": mast(0.5)}),
        (cloud.transformed(mast(0.5)), {"scene": street()}),
        (world, {"scene": street()}),
        (world, {"scene": street(), "pose": mast(0.5)}),
        (cloud, {}),
    ):
        points.plot(save="a.png", **looks)
    *placed, alone = (picture.frames[0].cloud.xyz for picture in pictures)
    for xyz in placed:  # three products and sums of numbers below 32, rounded
        np.testing.assert_allclose(xyz, world.xyz, rtol=0, atol=8 * 2.0**-48)
    np.testing.assert_array_equal(alone, cloud.xyz)
    at_home = ls.Lidar(ls.patterns.Grid([0.0], [-0.5], rate=10)).scan(street())
    at_home.point_cloud().plot(scene=street(), save="a.png")  # in the world as well


def pictures_of(monkeypatch: pytest.MonkeyPatch) -> list[Picture]:
    """Return a list to which each picture is added that would be drawn."""
    from lidarsim.viewers import pyvista

    pictures: list[Picture] = []
    monkeypatch.setattr(pyvista, "draw", lambda picture, *_, **__: pictures.append(picture))
    return pictures


def test_frames_accumulate_in_the_world(scans: list[ls.Scan], monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = pictures_of(monkeypatch)
    clouds = [scan.point_cloud("world") for scan in scans]
    boxes = [scan.boxes(frame="world") for scan in scans]
    ls.show(scans, scene=crossing(), boxes=boxes, color_by="range", accumulate=True,
            time=[0.0, 0.1, 0.2], save="a.png")  # fmt: skip
    ls.show([scan.point_cloud() for scan in scans], pose=[scan.pose for scan in scans], accumulate=True, save="a.png")
    ls.show(clouds[0], accumulate=True, title="one", save="a.png")
    together, placed, single = (picture.frames[0] for picture in pictures)
    assert [len(picture.frames) for picture in pictures] == [1, 1, 1]
    everything = np.concatenate([cloud.xyz for cloud in clouds])
    np.testing.assert_array_equal(together.cloud.xyz, everything)
    # Three products and sums of numbers below 32, rounded.
    np.testing.assert_allclose(placed.cloud.xyz, everything, rtol=0, atol=8 * 2.0**-48)
    np.testing.assert_array_equal(single.cloud.xyz, clouds[0].xyz)
    assert (together.title, placed.title, single.title) == ("3 frames, 0.00 to 0.20 s", "3 frames", "one")
    assert together.boxes is boxes[-1]
    np.testing.assert_array_equal(together.pose, scans[-1].pose)
    (mover,) = together.movers
    near = len(mover.points()) * 8 * 2.0**-53  # of the sum of numbers below 8
    assert mover.points()[:, 1].mean() == pytest.approx(-4 + 4 * 0.2, rel=0, abs=near)
    np.testing.assert_array_equal(pictures[0].path, [[0, 0, 1.7], [0.5, 0, 1.7], [1, 0, 1.7]])
    with pytest.raises(ValueError, match=r"^what\[0\]: expected points in world coordinates beside the other frames"):
        ls.show([scan.point_cloud() for scan in scans[1:]], accumulate=True, save="a.png")


def test_frames_say_which_they_are(scans: list[ls.Scan], monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = pictures_of(monkeypatch)
    clouds = [scan.point_cloud("world") for scan in scans[1:]]
    later = [replace(scan, time=time) for scan, time in zip(scans[1:], (1.7e9, 1.7e9 + 0.2), strict=True)]
    for what in (later, [{"top": scan} for scan in later], clouds, scans[0]):
        ls.show(what, save="a.gif")
    numbered = ["frame 1 (1 of 2), 0.00 s", "frame 2 (2 of 2), 0.20 s"]  # from the first on
    titles = [[frame.title for frame in picture.frames] for picture in pictures]
    assert titles == [numbered, numbered, ["frame 1 of 2", "frame 2 of 2"], [""]]


@pytest.mark.parametrize("suffix", ["png", "html"])
def test_a_scan_without_points_says_so(suffix: str, scans: list[ls.Scan], tmp_path: Path) -> None:
    nothing = scans[0].point_cloud("world")[:0]
    written: dict[str, bytes] = {}
    for name, what, looks in (
        ("empty", nothing, {"scene": street()}),
        ("scene", street(), {}),
        ("points", scans[0], {"scene": street()}),
    ):
        ls.show(what, save=tmp_path / f"{name}.{suffix}", size=SIZE, **looks)
        written[name] = (tmp_path / f"{name}.{suffix}").read_bytes()
    if suffix == "html":
        assert {name: b'"text":"no points"' in page for name, page in written.items()} == {
            "empty": True,
            "scene": False,
            "points": False,
        }
        return
    empty, scene = (np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB")).astype(int) for name in
                    ("empty", "scene"))  # fmt: skip
    differs = (np.abs(empty - scene).max(axis=-1) > 30)[80:120, 80:240]
    assert differs.sum() > 50  # the words, and the axes of the sensor


@pytest.mark.parametrize("aspect", [0.7, 1.6])
def test_a_scene_is_framed_by_what_stands_on_the_ground(aspect: float, monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = pictures_of(monkeypatch)
    scene = street()
    scene.add(ls.Box((600, 8, 0.1)), name="long road", label=40)
    for camera in ("behind", "top", "orbit"):
        ls.show(scene, camera=camera, save="a.png")  # type: ignore[arg-type]
    for picture in pictures[:2]:
        assert np.ptp(picture.points_to_show(), axis=0).max() < 10
    orbit = pictures[2]
    corners = np.concatenate([surface.points() for surface in orbit.surfaces])
    assert np.ptp(corners, axis=0).max() >= 600
    for turn in np.linspace(0, 2 * np.pi, 12):  # never crops
        assert np.abs(orbit.view(0, orbit.points_to_show(), aspect, turn=turn).places(corners, aspect)).max() <= 1.0
    flat = ls.Scene()
    flat.add(ls.Box((600, 8, 0.1)))
    ls.show(flat, save="a.png")
    assert np.ptp(pictures[-1].points_to_show(), axis=0).max() == 600  # what else is there?


def test_nothing_to_show() -> None:
    with pytest.raises(ValueError, match="what: expected at least one frame, got none"):
        ls.show([], save="a.png")
    with pytest.raises(TypeError, match="what: expected point clouds, scans or a scene, got int"):
        ls.show([3], save="a.png")  # type: ignore[list-item]


# pages


def test_a_page_needs_nothing_else_and_is_the_same_each_time(scans: list[ls.Scan], tmp_path: Path) -> None:
    for name in "ab":
        scans[0].plot(scene=street(), color_by="label", save=tmp_path / f"{name}.html")
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert (tmp_path / "b.html").read_text(encoding="utf-8") == text
    assert '<script src="' not in text
    assert "<title>lidarsim</title>" in text


def test_map_coordinates_keep_their_digits(scans: list[ls.Scan]) -> None:
    cloud = scans[0].point_cloud("world")
    cloud.xyz = cloud.xyz + np.array([5e6, 4e5, 0])
    picture = Picture([Frame(cloud, mast())], [], np.empty((0, 3)), coloring([cloud], "range"), "behind", 10.0)
    drawn = html._figure(picture, 1.6, None).data[0]
    shown = np.stack([drawn.x, drawn.y, drawn.z], axis=-1)
    difference = cloud.xyz - shown
    shift = np.round(difference[0] / 1000) * 1000
    # float32 numbers below 2.6e6: the sensor is at the origin, the points are 5e6 m away.
    assert np.abs(difference - shift).max() <= 0.25
    assert shown.dtype == np.float32


def test_in_a_notebook_the_page_is_what_a_cell_displays(
    scans: list[ls.Scan], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lidarsim.viewers import _show

    assert not _display.in_notebook()
    monkeypatch.setattr(_show, "in_notebook", lambda: True)
    page = scans[0].plot(color_by="label")
    scans[0].plot(color_by="label", save=tmp_path / "a.html")
    assert page is not None
    assert page.text == (tmp_path / "a.html").read_text(encoding="utf-8")
    shown = page._repr_html_()
    assert shown.startswith('<iframe srcdoc="&lt;')
    assert shown.count('"') == 4  # all quotes of the page are escaped


def figure(monkeypatch: pytest.MonkeyPatch, path: Path, what: Any, **looks: Any) -> Any:
    """Return what a page draws, and write the page."""
    made: list[Any] = []
    draw = html._figure
    monkeypatch.setattr(html, "_figure", lambda *given: made.append(draw(*given)) or made[-1])
    ls.show(what, save=path, **looks)
    monkeypatch.setattr(html, "_figure", draw)
    return made[0]


def test_a_page_has_the_colours_of_faces_and_of_categories_without_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = ls.Scene(class_names={3: "three"})
    vertices = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    scene.add(ls.TriangleMesh(vertices, [(0, 1, 2), (0, 2, 3)]), label=[3, 8])
    data = figure(monkeypatch, tmp_path / "a.html", scene).data
    meshes = [trace for trace in data if trace.type == "mesh3d"]
    assert [(trace.color, len(trace.i), trace.opacity) for trace in meshes] == [
        (QUALITATIVE[3], 1, 1.0),
        (QUALITATIVE[8], 1, 1.0),
    ]
    legend = [trace for trace in data if trace.type == "scatter3d" and trace.showlegend]
    assert [(trace.name, trace.marker.color) for trace in legend] == [("three", QUALITATIVE[3]), ("8", QUALITATIVE[8])]
    assert all(len(trace.x) for trace in legend)  # Plotly leaves a trace without points out of its legend


def test_a_page_has_surfaces_by_height(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ls.Scene()
    scene.add(ls.Box((1, 1, 8), (0, 0, 4 + 1e6)))
    data = figure(monkeypatch, tmp_path / "a.html", scene, color_by="height").data
    (mesh,) = (trace for trace in data if trace.type == "mesh3d")
    assert sorted(set(mesh.intensity)) == [0.0, 1.0]
    assert (mesh.cmin, mesh.cmax) == (0.0, 1.0)
    marker = data[0].marker
    assert (marker.cmin, marker.cmax, marker.showscale) == (0.0, 1.0, True)
    assert mesh.colorscale == marker.colorscale
    assert list(marker.colorbar.ticktext)[::4] == ["1,000,000", "1,000,008"]
    assert list(marker.colorbar.tickvals)[::4] == [0.0, 1.0]


def test_a_page_keeps_all_points_within_its_axes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cloud = ls.PointCloud(xyz=np.random.default_rng(3).uniform(-5, 5, (50, 3)))
    page = figure(monkeypatch, tmp_path / "a.html", cloud)
    for name in "xyz":
        low, high = page.layout.scene[f"{name}axis"].range
        assert low < page.data[0][name].min()  # Plotly hides what float32 rounds beyond
        assert page.data[0][name].max() < high


def test_a_page_shows_values_that_are_not_finite_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cloud = ls.PointCloud(xyz=np.arange(12.0).reshape(4, 3), gain=[1e9, np.nan, 1e9 + 0.1, np.inf], none=[np.nan] * 4)
    data = figure(monkeypatch, tmp_path / "a.html", cloud, color_by="gain").data
    assert data[0].marker.color.tolist() == [0.0, 1.0]
    assert (data[1].name, data[1].marker.color, data[1].showlegend) == ("not finite", MISSING, True)
    assert data[1].x.tolist() == [3.0, 9.0]
    data = figure(monkeypatch, tmp_path / "b.html", cloud, color_by="none").data
    assert data[0].marker.showscale is False
    assert len(data[1].x) == 4


def test_no_name_is_markup_of_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["</script><b>", "<b>it</b>", "&lt;", "\"'", "a\n\ud800", "x" * 10_000, "%{x}"]
    scene = ls.Scene(class_names=dict(enumerate(names)))
    for i, name in enumerate(names):
        scene.add(ls.Sphere((5, 3 * i, 0), 1.0), label=i, name=name)
    for field in ("label", "object_id"):
        path = tmp_path / f"{field}.html"
        page = figure(monkeypatch, path, scene, color_by=field)
        shown = [trace.name for trace in page.data if trace.type == "scatter3d" and trace.showlegend]
        assert not any("&quot;" in name for name in shown)  # an entity that Plotly does not know
        # As Plotly reads them, whose texts are a kind of HTML.
        assert [unescape(name) for name in shown] == [plain(name, most=24) for name in names]
        assert not any("<" in name for name in shown)
        text = path.read_text(encoding="utf-8")
        empty = figure(monkeypatch, tmp_path / "empty.html", ls.Scene(), color_by=field)
        assert empty
        assert text.count("</script>") == (tmp_path / "empty.html").read_text(encoding="utf-8").count("</script>")


@pytest.mark.skipif(not shutil.which("chromium"), reason="no Chromium to open the page with")
def test_a_browser_shows_and_turns_the_page(scans: list[ls.Scan], tmp_path: Path) -> None:
    playwright = pytest.importorskip("playwright.sync_api")
    page = tmp_path / "a.html"
    ls.show(scans[:2], scene=street(), color_by="label", save=page)
    software = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    errors: list[str] = []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=software)
        tab = browser.new_page(viewport={"width": 640, "height": 420})
        tab.set_default_timeout(120_000)
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
        tab.goto(page.as_uri())
        tab.wait_for_selector("#lidarsim canvas")

        def screenshot() -> np.ndarray:
            tab.wait_for_timeout(1500)
            tab.screenshot(path=tmp_path / "seen.png")
            return np.asarray(Image.open(tmp_path / "seen.png").convert("RGB")).astype(int)

        before = screenshot()
        tab.mouse.move(250, 220)
        tab.mouse.down()
        tab.mouse.move(330, 240, steps=4)
        tab.mouse.up()
        after = screenshot()
        browser.close()
    assert errors == []
    for color in COLORS:
        assert (np.abs(before - color) < 9).all(axis=-1).sum() > 30, color
    assert (np.abs(before - after).max(axis=-1) > 30).mean() > 0.02  # it turned


def test_a_page_needs_plotly_alone(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['pyvista'] = sys.modules['open3d'] = None; import lidarsim as ls;"
        "ls.PointCloud(xyz=[[1, 2, 3]]).plot(save='a.html')"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=tmp_path, check=True)
    assert (tmp_path / "a.html").stat().st_size > 1e6
