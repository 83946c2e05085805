"""Boxes in pictures, pages and windows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.scan.boxes import Boxes
from lidarsim.viewers import html
from lidarsim.viewers._boxes import LINES, lines, transform_boxes
from lidarsim.viewers._colors import legible, luminance
from lidarsim.viewers._picture import Picture

SIZE = (480, 300)


def boxes(*centers: tuple[float, float, float], yaw: float = 0.0, label: int = 1) -> Boxes:
    count = len(centers)
    return Boxes(
        center=np.reshape(centers, (-1, 3)).astype(float),
        size=np.tile([4.0, 2.0, 1.5], (count, 1)),
        rotation=np.tile(Rotation.from_euler("z", yaw).as_matrix(), (count, 1, 1)),
        velocity=np.zeros((count, 3)),
        label=np.full(count, label, np.uint32),
        instance=np.arange(1, count + 1, dtype=np.uint32),
        points=np.full(count, 5),
        visibility=np.ones(count),
        truncation=np.zeros(count),
        time=np.zeros(count),
        class_names={1: "car", 2: "person"},
    )


def floor() -> ls.PointCloud:
    x, y = np.meshgrid(np.linspace(2, 20, 30), np.linspace(-8, 8, 30))
    return ls.PointCloud(xyz=np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1))


def test_lines_are_the_edges_of_the_box_and_an_arrow_ahead() -> None:
    some = boxes((5, 1, 0.75), (9, -3, 0.75), yaw=0.5)
    ends = lines(some)
    near = 8 * 16 * 2.0**-53  # a matrix, its product and a sum of less than 16 m
    assert ends.shape == (2, LINES, 2, 3)
    edges, arrows = ends[:, :12], ends[:, 12:]
    length = np.linalg.norm(edges[:, :, 0] - edges[:, :, 1], axis=-1)
    for row in length:
        np.testing.assert_allclose(np.sort(row), [1.5] * 4 + [2.0] * 4 + [4.0] * 4, rtol=0, atol=near)
    for center, arrow in zip(some.center, arrows, strict=True):
        ahead = np.array([np.cos(0.5), np.sin(0.5), 0.0])
        np.testing.assert_allclose(
            arrow[:, 1], np.tile(center + (2.0 + 1.0) * ahead + [0, 0, 0.75], (2, 1)), rtol=0, atol=near
        )
        side = (arrow[:, 0] - center) @ [-np.sin(0.5), np.cos(0.5), 0.0]
        np.testing.assert_allclose(np.sort(side), [-1.0, 1.0], rtol=0, atol=near)


def test_boxes_move_with_the_points_of_the_sensor_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    from lidarsim.viewers import pyvista

    pictures: list[Picture] = []
    monkeypatch.setattr(pyvista, "draw", lambda picture, *_, **__: pictures.append(picture))
    scene = ls.Scene(class_names={1: "car"})
    scene.add(ls.Box((4, 2, 1.5), (12, 3, 0.75)), label=1)
    pose = RigidTransform.from_components([3.0, 1.0, 2.0], Rotation.from_euler("z", 0.3))
    scan = ls.Lidar.preset("velodyne-vlp16").scan(scene, pose)
    ls.show(scan, boxes=scan.boxes(frame="world"), save="a.png")
    ls.show(scan.point_cloud(), boxes=scan.boxes(), pose=pose, save="a.png")
    for picture in pictures:
        (frame,) = picture.frames
        assert frame.boxes is not None
        np.testing.assert_allclose(
            frame.boxes.center, [[12, 3, 0.75]], rtol=0, atol=4 * 8 * 12 * 2.0**-53
        )  # four turns
        assert frame.boxes.contain(frame.cloud.xyz).all()
        assert len(frame.cloud) > 100
    ls.show(scan.point_cloud(), boxes=scan.boxes()[:0], pose=pose, save="a.png")
    none = pictures[-1].frames[0].boxes
    assert none is not None
    assert not none.in_sensor_frame
    back = transform_boxes(transform_boxes(scan.boxes(), pose.as_matrix()), pose.inv().as_matrix())
    np.testing.assert_allclose(back.rotation, scan.boxes().rotation, rtol=0, atol=2 * 8 * 2.0**-53)


def test_a_picture_has_boxes_where_they_are_with_their_names(tmp_path: Path) -> None:
    camera = [(-6, 0, 8), (10, 0, 0), (0, 0, 1)]
    looks: dict[str, Any] = {"size": SIZE, "camera": camera, "color_by": "height", "title": "t"}
    ls.show(floor(), save=tmp_path / "a.png", **looks)
    ls.show(floor(), boxes=boxes((10, 4, 0.75)), save=tmp_path / "b.png", **looks)
    ls.show(floor(), boxes=boxes((10, -4, 0.75)), save=tmp_path / "c.png", **looks)
    none, left, right = (np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB")).astype(int) for name in "abc")
    color = list(bytes.fromhex(legible("#1f9dff")[1:]))  # of a car
    stage = slice(0, 3 * SIZE[0] // 4)
    # Thin lines blend with the background: blue they are, which no height is.
    columns = [np.nonzero(image[:, stage, 2] - image[:, stage, 0] > 45)[1] for image in (none, left, right)]
    assert len(columns[0]) == 0
    assert min(len(columns[1]), len(columns[2])) > 60
    assert np.median(columns[1]) + 40 < np.median(columns[2])
    in_legend = (np.abs(left[:, stage.stop :] - color) < 9).all(axis=-1).sum()
    assert in_legend > 60  # the swatch of the class
    assert (np.abs(none[:, stage.stop :] - color) < 9).all(axis=-1).sum() == 0


def test_a_page_has_the_boxes_of_each_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []
    draw = html._figure
    monkeypatch.setattr(html, "_figure", lambda *given: made.append(draw(*given)) or made[-1])
    each = [boxes((10, 4, 0.75), (5, 0, 0)), None, boxes((10, -4, 0.75), label=2)]
    ls.show([floor()] * 3, boxes=each, save=tmp_path / "a.html")
    (page,) = made
    counts = []
    for frame in page.frames:
        wires = [trace for trace in frame.data if trace.name in {"car", "person"}]
        assert [trace.name for trace in wires] == ["car", "person"]  # the same traces in all frames
        counts.append([int(np.isfinite(trace.x).sum()) // (2 * LINES) for trace in wires])
    assert counts == [[2, 0], [0, 0], [0, 1]]
    assert "car 1, 4.00 × 2.00 × 1.50 m, 5 points" in page.frames[0].data[-2].text
    assert [step.label for step in page.layout.sliders[0].steps] == [f"frame {i} of 3" for i in (1, 2, 3)]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([boxes((1, 2, 3))] * 2, "boxes: expected one for each of the 1 frames, got 2"),
        ([np.zeros((3, 7))], "boxes[0]: expected Boxes or None, got ndarray"),
    ],
)
def test_bad_boxes(given: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError)) as caught:
        ls.show(floor(), boxes=given, save="a.png")
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"background": "pink"}, "background: expected 'dark' or 'white', got 'pink'"),
        ({"color_map": "jet"}, "color_map: expected 'magma', 'viridis', 'cividis' or 'grey', got 'jet'"),
        ({"limits": (3, 1)}, "limits: expected two numbers, the second greater, got 3 and 1"),
        ({"title": ["a", "b"]}, "title: expected one for each of the 1 frames, got 2"),
        ({"title": [3]}, "title: expected text, got int"),
    ],
)
def test_bad_looks(options: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError)) as caught:
        ls.show(floor(), save="a.png", **options)
    assert str(caught.value) == message


def test_limits_and_colour_maps_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    from lidarsim.viewers import pyvista

    pictures: list[Picture] = []
    monkeypatch.setattr(pyvista, "draw", lambda picture, *_, **__: pictures.append(picture))
    ls.show(floor(), color_by="height", limits=(-1, 3), color_map="grey", save="a.png")
    colors = pictures[0].colors
    assert (colors.limits, colors.table[0], colors.table[-1]) == ((-1.0, 3.0), "#404040", "#ffffff")


@pytest.mark.parametrize("background", ["dark", "white"])
def test_backgrounds_and_jpg(background: Any, tmp_path: Path) -> None:
    ls.show(floor(), save=tmp_path / "a.jpg", size=SIZE, background=background, camera="top", color_by="height")
    with Image.open(tmp_path / "a.jpg") as image:
        assert (image.format, image.size) == ("JPEG", SIZE)
        corner = image.convert("RGB").getpixel((2, SIZE[1] - 2))
    assert luminance("#" + bytes(corner).hex()) == pytest.approx(float(background == "white"), abs=0.02)


def test_a_plan_has_no_perspective(monkeypatch: pytest.MonkeyPatch) -> None:
    from lidarsim.viewers import pyvista

    pictures: list[Picture] = []
    monkeypatch.setattr(pyvista, "draw", lambda picture, *_, **__: pictures.append(picture))
    ls.show(floor(), camera="top", save="a.png")
    (picture,) = pictures
    view = picture.view(0, picture.points_to_show(), 1.5)
    low, high = (view.places(np.array([[10.0, y, z] for y in (-3, 3)]), 1.5) for z in (0.0, 5.0))
    np.testing.assert_allclose(low, high, rtol=0, atol=16 * 2.0**-53)
    assert low[0, 0] > 0 > low[1, 0]  # y grows to the left
    assert np.abs(view.places(picture.points_to_show(), 1.5)).max() <= 1.0


def test_boxes_and_points_are_in_the_same_coordinates(tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Box((1, 4, 3), center=(15, 2, 0)), label=1)
    pose = np.eye(4)
    pose[:3, 3] = (10, 0, 0)
    scan = ls.Lidar.preset("velodyne-vlp16").scan(scene, pose)
    inside, outside = scan.boxes(), scan.boxes(frame="world")
    assert (inside.in_sensor_frame, outside.in_sensor_frame, inside[:1].in_sensor_frame) == (True, False, True)
    for what in (scan, scan.point_cloud("world")):
        with pytest.raises(
            ValueError, match=r"^boxes: expected boxes in world coordinates, got boxes in the sensor fr"
        ):
            ls.show(what, boxes=inside, save=tmp_path / "a.html")
    with pytest.raises(ValueError, match=r"^boxes: expected boxes in the sensor frame, as the points, got boxes in wo"):
        ls.show(scan.point_cloud(), boxes=outside, save=tmp_path / "a.html")
    assert not list(tmp_path.iterdir())
    ls.show(scan.point_cloud(), boxes=inside, pose=pose, save=tmp_path / "a.html")
    at_rest = ls.Lidar.preset("velodyne-vlp16").scan(scene)
    ls.show(at_rest, boxes=at_rest.boxes(), save=tmp_path / "b.html")
