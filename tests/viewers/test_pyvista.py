"""PyVista: conversion, and pictures that show what they should."""

import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import pyvista
from PIL import Image
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.errors import FileFormatError, LidarsimError, MissingExtraError
from lidarsim.scan.fields import CANONICAL
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.viewers import show
from lidarsim.viewers._colors import BACKGROUND, MISSING, QUALITATIVE, SEQUENTIAL, coloring
from lidarsim.viewers.pyvista import _check_opengl, check_screenshot

SIZE = (320, 200)


def channels(color: str) -> list[int]:
    return list(bytes.fromhex(color[1:]))


def picture(path: Path, cloud: Any, **options: Any) -> np.ndarray:
    show(cloud, save=path, size=SIZE, **options)
    image = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert image.shape == (SIZE[1], SIZE[0], 3)
    return image


def near(image: np.ndarray, color: str, tolerance: int = 12) -> np.ndarray:
    return (np.abs(image - channels(color)) <= tolerance).all(axis=-1)


@pytest.fixture
def wall() -> PointCloud:
    """Two patches across the sensor's x axis: label 7 to the left, label 9 to the right."""
    y, z = np.meshgrid(np.linspace(-4, 4, 60), np.linspace(-2, 2, 40))
    return PointCloud(
        xyz=np.stack([np.full(y.size, 10.0), y.ravel(), z.ravel()], 1), label=np.where(y > 0, 7, 9).ravel()
    )


def cloud_of_all(points: int) -> PointCloud:
    rng = np.random.default_rng(0)
    fields: dict[str, Any] = {
        name: rng.integers(0, 200, (points, *shape)).astype(dtype) for name, (shape, dtype) in CANONICAL.items()
    }
    for code in ("?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"):
        fields[f"extra_{np.dtype(code).name}"] = rng.integers(0, 2, points).astype(code)
    return PointCloud(fields, vector=rng.random((points, 2)))


@pytest.mark.parametrize("points", [0, 1, 100])
def test_every_field_is_point_data_of_its_dtype(points: int) -> None:
    cloud = cloud_of_all(points)
    converted = cloud.to_pyvista()
    assert isinstance(converted, pyvista.PolyData)
    assert converted.points.dtype == np.float64
    assert converted.n_cells == points
    np.testing.assert_array_equal(converted.points, cloud.xyz)
    assert set(converted.point_data) == set(cloud.fields) - {"xyz"}
    for name in converted.point_data:
        assert converted.point_data[name].dtype == getattr(cloud, name).dtype
        np.testing.assert_array_equal(converted.point_data[name], getattr(cloud, name))


def test_conversion_shares_its_arrays() -> None:
    cloud = PointCloud(xyz=np.zeros((3, 3)), range=np.zeros(3))
    converted = cloud.to_pyvista()
    assert np.shares_memory(converted.points, cloud.xyz)
    assert np.shares_memory(converted.point_data["range"], cloud.range)


@pytest.mark.parametrize("points", [0, 1, 100])
def test_every_field_comes_back(points: int) -> None:
    cloud = cloud_of_all(points)
    cloud.class_names = {0: "road", 7: "Fußgänger", 2**32 - 1: ""}
    cloud.flags = np.arange(3 * points).reshape(-1, 3) % 2 == 0
    back = PointCloud.from_pyvista(cloud.to_pyvista())
    assert (back.fields, back.class_names) == (cloud.fields, cloud.class_names)
    for name in cloud.fields:
        np.testing.assert_array_equal(getattr(back, name), getattr(cloud, name), strict=True)
    assert np.shares_memory(back.xyz, cloud.xyz) == (points > 0)


def test_a_single_component_comes_back_as_a_scalar() -> None:
    cloud = PointCloud(xyz=np.zeros((2, 3)), height=[[1.0], [2.0]])
    assert PointCloud.from_pyvista(cloud.to_pyvista()).height.tolist() == [1.0, 2.0]


def test_data_sets_of_pyvista_are_taken_over(tmp_path: Path) -> None:
    sphere = pyvista.Sphere()
    sphere.cell_data["area"] = np.ones(sphere.n_cells)
    sphere.point_data["name"] = ["p"] * sphere.n_points
    sphere.save(tmp_path / "sphere.vtp")
    for mesh in (sphere, pyvista.read(tmp_path / "sphere.vtp")):
        cloud = PointCloud.from_pyvista(mesh)
        assert cloud.fields == ("xyz", "normal")
        np.testing.assert_array_equal(cloud.xyz, sphere.points)
        np.testing.assert_array_equal(cloud.normal, sphere.point_data["Normals"])
        assert (cloud.xyz.dtype, cloud.normal.dtype) == (np.float64, np.float32)
    grid = pyvista.ImageData(dimensions=(2, 2, 2))
    assert len(PointCloud.from_pyvista(grid)) == 8
    with pytest.raises(TypeError, match="mesh: expected a PyVista data set, got ndarray"):
        PointCloud.from_pyvista(np.zeros((3, 3)))  # type: ignore[arg-type]
    sphere.point_data["ring"] = np.full(sphere.n_points, -1)
    sphere.point_data["xyz"] = sphere.point_data["a b"] = np.arange(sphere.n_points)
    cloud = PointCloud.from_pyvista(sphere)
    assert cloud.fields == ("xyz", "ring", "normal", "a_b", "ring_raw", "xyz_2")
    np.testing.assert_array_equal(cloud.xyz, sphere.points)
    assert (set(cloud.ring), set(cloud.ring_raw)) == ({0}, {-1})
    assert cloud.xyz_2.tolist() == cloud.a_b.tolist() == list(range(sphere.n_points))


def test_points_are_drawn_in_their_colours_where_they_are(wall: PointCloud, tmp_path: Path) -> None:
    image = picture(tmp_path / "a.png", wall, color_by="label")
    assert near(image, BACKGROUND).mean() > 0.2
    left, right = near(image, QUALITATIVE[7]), near(image, QUALITATIVE[9])
    assert left.sum() > 200
    assert right.sum() > 200
    middle = SIZE[0] * 0.75  # right of it stands the legend
    assert np.median(np.nonzero(left)[1]) < np.median(np.nonzero(right)[1]) < middle


def test_camera_and_pose_move_with_the_cloud(wall: PointCloud, tmp_path: Path) -> None:
    pose = RigidTransform.from_components([5e6, 4e5, 300.0], Rotation.from_euler("z", 1.0))
    moved = PointCloud(xyz=pose.apply(wall.xyz), label=wall.label)
    near_origin = picture(tmp_path / "a.png", wall, color_by="label")
    far_off = picture(tmp_path / "b.png", moved, color_by="label", pose=pose)
    # Coordinates of 5e6 m are rounded to 1e-9 m, so only pixels on an edge can differ, and the grid.
    for label in (7, 9):
        assert (near(near_origin, QUALITATIVE[label]) != near(far_off, QUALITATIVE[label])).mean() < 0.01
    assert near(near_origin, QUALITATIVE[7]).sum() > 200


def test_a_given_camera_is_used(wall: PointCloud, tmp_path: Path) -> None:
    away = picture(tmp_path / "a.png", wall, color_by="label", camera=[(0, 0, 0), (-1, 0, 0), (0, 0, 1)])
    assert near(away[:, : SIZE[0] * 3 // 4], QUALITATIVE[7]).sum() == 0


def test_far_outliers_do_not_shrink_the_picture(wall: PointCloud, tmp_path: Path) -> None:
    with_outliers = PointCloud(
        xyz=np.concatenate([wall.xyz, [[1e5, 0, 0], [np.nan, 0, 0], [0, np.inf, 0]]]),
        label=np.concatenate([wall.label, [7, 7, 7]]),
    )
    counts = [
        near(picture(tmp_path / "a.png", cloud, color_by="label"), QUALITATIVE[9]).sum()
        for cloud in (wall, with_outliers)
    ]
    assert counts[1] == pytest.approx(counts[0], rel=0.2)


def test_surfaces_are_shown_where_they_are(wall: PointCloud, tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Box((2, 9, 5), (10, 0, 0)))
    plain = picture(tmp_path / "a.png", wall)
    boxed = picture(tmp_path / "b.png", wall, scene=scene)
    assert (plain != boxed).any(axis=-1).mean() > 0.1
    shift = np.array([5e6, 4e5, 0.0])
    there = ls.Scene()
    there.add(ls.Box((2, 9, 5), shift + np.array([10, 0, 0])))
    moved = PointCloud(xyz=wall.xyz + shift, label=wall.label)
    again = picture(tmp_path / "c.png", moved, scene=there, pose=RigidTransform.from_translation(shift))
    assert (boxed != again).any(axis=-1).mean() < 0.01


def test_instances_of_a_mesh_stand_where_each_is(tmp_path: Path) -> None:
    ball = surfaces_of_a_ball(1500)
    images = []
    for whole in (True, False):  # as one mesh with two instances, and as two meshes
        scene = ls.Scene()
        for y in (-3, 3):
            mesh = ball if whole else ls.TriangleMesh(ball.vertices, ball.faces)
            scene.add(
                mesh, transform=[[1, 0, 0, 10], [0, 1, 0, y], [0, 0, -1, 0], [0, 0, 0, 1]], label=40 if y < 0 else 70
            )
        images.append(picture(tmp_path / "a.png", scene))
    assert (images[0] != images[1]).any(axis=-1).mean() < 0.01
    assert (~near(images[0], BACKGROUND)).mean() > 0.05
    left, right = (half[~near(half, BACKGROUND)].mean(axis=0) for half in np.array_split(images[0], 2, axis=1))
    assert np.abs(left - right).max() > 20  # each in its colour


def surfaces_of_a_ball(least: int) -> ls.TriangleMesh:
    vertices, faces = ls.Sphere((1, 2, 3), 1.0)._tessellate(None, np.zeros((8, 3)))
    assert len(faces) > least
    return ls.TriangleMesh(vertices - [1, 2, 3], faces)


@pytest.mark.parametrize("field", ["intensity", "height", "on", "constant", "empty"])
def test_odd_fields_draw(field: str, wall: PointCloud, tmp_path: Path) -> None:
    wall.intensity = np.linspace(0, 1, len(wall))
    wall.on = wall.label == 7
    wall.constant = np.full(len(wall), 3)
    wall.empty = np.full(len(wall), np.nan)
    image = picture(tmp_path / "a.png", wall, color_by=field)
    assert (~near(image, BACKGROUND)).mean() > 0.05


def test_empty_cloud_shows_the_sensor(tmp_path: Path) -> None:
    image = picture(
        tmp_path / "a.png", PointCloud(xyz=np.empty((0, 3)), label=np.empty(0, np.uint32)), color_by="label"
    )
    assert 0 < (~near(image, BACKGROUND)).mean() < 0.05


def test_a_new_picture_replaces_the_old_whole(wall: PointCloud, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("old")
    picture(tmp_path / "a.png", wall)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_bad_paths(wall: PointCloud, tmp_path: Path) -> None:
    for path, error, message in (
        (tmp_path / "a.bmp", FileFormatError, "unknown extension '.bmp', expected "),
        (tmp_path / "none" / "a.png", FileNotFoundError, f"the folder {tmp_path / 'none'} does not exist"),
    ):
        for use in (check_screenshot, lambda path: show(wall, save=path)):
            with pytest.raises(error) as caught:
                use(path)
            assert str(caught.value).startswith(f"{path}: {message}")


def test_bad_arguments(wall: PointCloud, tmp_path: Path) -> None:
    for options, message in (
        ({"color_by": "ring"}, "color_by: expected one of height, label, got 'ring'"),
        ({"camera": [1, 2, 3]}, "camera: expected shape (3, 3), got (3,)"),
        ({"pose": np.eye(3)}, "pose: expected shape (4, 4), got (3, 3); a rotation is pose[:3, :3]"),
    ):
        with pytest.raises(ValueError) as caught:  # noqa: PT011
            show(wall, save=tmp_path / "a.png", **options)
        assert str(caught.value) == message
    assert not list(tmp_path.iterdir())


def test_missing_package(wall: PointCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    for use in (wall.to_pyvista, lambda: show(wall, save=tmp_path / "a.png")):
        with pytest.raises(MissingExtraError) as caught:
            use()
        assert str(caught.value) == 'this view needs pyvista: pip install "lidarsim[pyvista]"'


def test_no_opengl_is_an_error_instead_of_a_crash(tmp_path: Path) -> None:
    plotter = MagicMock()  # where VTK finds no OpenGL, it gives a window that does not initialise
    plotter.render_window.GetInitialized.return_value = False
    with pytest.raises(LidarsimError) as caught:
        _check_opengl(plotter, tmp_path / "a.png")
    assert str(caught.value) == "no OpenGL to draw with: install libEGL (Debian, Ubuntu: apt install libegl1)"


@pytest.mark.skipif(sys.platform != "linux", reason="other systems draw without X11")
def test_no_x11_is_an_error_instead_of_a_crash(
    wall: PointCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(name: str) -> None:
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr("ctypes.CDLL", refuse)
    with pytest.raises(LidarsimError, match="no OpenGL to draw with: install libEGL"):
        show(wall, save=tmp_path / "a.png")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_window_without_a_display(wall: PointCloud, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(LidarsimError) as caught:
        show(wall)
    assert (
        str(caught.value)
        == "no display to open a window on (DISPLAY is not set): write a file instead (save=, --screenshot)"
    )


@pytest.mark.slow("drawing loses no name and prints nothing")
def test_rendering_says_nothing(tmp_path: Path) -> None:
    code = (
        "from lidarsim.scan.pointcloud import PointCloud; from lidarsim import show;"
        "show(PointCloud(xyz=[[1, 2, 3]]), save='a.png')"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
    assert (tmp_path / "a.png").exists()


def cube_with_a_label_a_side() -> ls.Scene:
    """A cube from 8 to 12 m ahead whose sides have the labels 0 to 5."""
    vertices, faces = ls.Box((4, 4, 4), (10, 0, 0))._tessellate(None, np.zeros((8, 3)))
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    _, side = np.unique(np.round(normals, 9), axis=0, return_inverse=True)
    scene = ls.Scene()
    scene.add(ls.TriangleMesh(vertices, faces), label=side.ravel())
    return scene


STAGE = SIZE[0] * 3 // 4
"""Width of a picture without its legend."""


def hue(color: np.ndarray) -> np.ndarray:
    """Return a colour whatever its lightness, which shading changes."""
    return color / np.maximum(color.max(axis=-1, keepdims=True), 1)


@pytest.mark.parametrize("color_by", ["label", None])
def test_faces_have_the_colours_of_their_labels(color_by: str | None, tmp_path: Path) -> None:
    scene = cube_with_a_label_a_side()
    image = picture(tmp_path / "a.png", scene, color_by=color_by, camera=[(0, -10, 8), (10, 0, 0), (0, 0, 1)])
    stage = image[:, :STAGE]
    seen = [
        (np.abs(hue(stage) - hue(np.array(channels(QUALITATIVE[label])))).max(axis=-1) < 0.04)[stage.sum(axis=-1) > 150]
        for label in range(6)
    ]
    shown = [label for label in range(6) if seen[label].sum() > 300]
    normals = (
        scene[0].shape.cast(np.tile([[0.0, -10, 8]], (3, 1)), [[8, 10, -8], [10, 8, -8], [10, 10, -6]]).primitive_id
    )
    assert shown == sorted(set(scene[0].label[normals].tolist()))
    assert len(shown) == 3


@pytest.mark.parametrize("with_points", [False, True])
def test_heights_of_surfaces_have_the_colours_of_the_legend(with_points: bool, tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Polygon([(10, -4, 0), (10, 4, 0), (10, 4, 8), (10, -4, 8)]))  # two triangles, each of all heights
    z = np.linspace(0, 8, 50)
    points = PointCloud(xyz=np.stack([np.full(50, 10.0), np.full(50, 6.0), z], axis=1))
    what, looks = (points, {"scene": scene}) if with_points else (scene, {})
    camera = [(-10, 0, 4), (10, 0, 4), (0, 0, 1)]
    image = picture(tmp_path / "a.png", what, color_by="height", camera=camera, point_size=2, **looks)
    column = image[:, STAGE // 2].astype(float)  # through the middle of the wall, from its top to its foot
    wall = np.flatnonzero(np.abs(column - channels(BACKGROUND)).max(axis=-1) > 12)
    assert len(wall) > 100
    colors = column[wall] - with_points * 0.85 * np.array(channels(BACKGROUND))
    places = np.linspace(1, 0, len(wall))
    table = coloring([points], "height").rgb_of(8 * places).astype(float)
    inner = (places > 0.05) & (places < 0.95)
    # Of a translucent wall 15 % are left, at most 38 of 255: a rounding of each of three parts is 0.08.
    assert np.abs(hue(colors) - hue(table))[inner].max() < (0.2 if with_points else 0.06)
    assert len(np.unique(table[inner], axis=0)) > 80


def ground_and_wall() -> tuple[ls.Scene, PointCloud]:
    """A wide ground, and points in front of the whole picture, so that no corner is free for a legend."""
    scene = ls.Scene(class_names={4: WIDE, 9: "other"})
    scene.add(ls.Polygon([(-500, -500, -3), (500, -500, -3), (500, 500, -3), (-500, 500, -3)]), label=9)
    y, z = np.meshgrid(np.linspace(-8, 8, 200), np.linspace(-2.5, 7.5, 140))
    wall = PointCloud(xyz=np.stack([np.full(y.size, 10.0), y.ravel(), z.ravel()], 1), label=np.full(y.size, 4))
    return scene, wall


@pytest.mark.parametrize("camera", ["behind", "birds-eye"])
def test_a_legend_hides_no_points_and_leaves_no_empty_column(camera: str, tmp_path: Path) -> None:
    scene, wall = ground_and_wall()
    image = picture(tmp_path / "a.png", wall, scene=scene, color_by="label", camera=camera)
    points = near(image, QUALITATIVE[4])
    rows, columns = np.nonzero(points)
    legend = near(image[:, STAGE:], BACKGROUND, 2)  # the ground is everywhere else
    right = np.nonzero(legend)[1].min() + STAGE
    assert (columns >= right).sum() < 150  # of the swatch
    assert len(rows) > 3000
    below = image[150:, STAGE:]
    assert (~near(below, BACKGROUND, 2)).mean() > 0.95  # the picture goes on below the legend


def test_a_legend_keeps_off_the_surfaces_on_an_orbit(tmp_path: Path) -> None:
    scene = ls.Scene(class_names={4: WIDE})
    scene.add(ls.Box((200, 200, 1)), label=4)
    image = picture(tmp_path / "a.png", scene, camera="orbit")
    seen = np.abs(hue(image) - hue(np.array(channels(QUALITATIVE[4])))).max(axis=-1) < 0.04
    seen &= image.max(axis=-1) > 60
    across = np.flatnonzero(seen[60:].any(axis=0))  # below the swatch
    assert across.max() < STAGE
    assert np.ptp(across) > 150


@pytest.mark.parametrize(("label", "alike"), [(0, False), (3, True)])
def test_objects_without_labels_are_told_apart(label: int, alike: bool, tmp_path: Path) -> None:
    """As the bodies and the floor of a MuJoCo model, whose geoms have no labels."""
    scene = ls.Scene()
    for name, x in (("floor", -6.0), ("robot/0", 0.0), ("robot/1", 3.0), ("arm/0", 8.0)):
        instance = {"robot/0": 7, "robot/1": 7}.get(name)
        scene.add(ls.Box((2, 4, 1), center=(x, 0, 0)), name=name, label=label, instance=instance)
    image = picture(tmp_path / "a.png", scene, camera=[(0, 0, 60), (0, 0, 0), (0, 1, 0)]).astype(float)
    scale = SIZE[1] / 2 / 60 / np.tan(np.radians(15))  # pixels per m, seen from 60 m with an angle of 30°
    colors = [image[SIZE[1] // 2, round(SIZE[0] / 2 + x * scale)] for x in (-6, 0, 3, 8)]
    hues = [color / np.linalg.norm(color) for color in colors]
    assert min(map(np.linalg.norm, colors)) > 60  # they are seen
    apart = [np.abs(hues[i] - hues[j]).max() > 0.1 for i, j in ((0, 1), (1, 3), (0, 3))]
    assert apart == [not alike] * 3
    assert np.abs(hues[1] - hues[2]).max() < 0.05  # one instance


def test_relief_is_seen_from_above(tmp_path: Path) -> None:
    """Ground that falls to the north-west faces the light, and ground that falls to the south-east is darker."""
    scene = ls.Scene()
    for x, slope in ((-10, 0.5), (0, 0.0), (10, -0.5)):
        high = [(x - 4, -4, 8 * slope), (x + 4, -4, 16 * slope), (x + 4, 4, 8 * slope), (x - 4, 4, 0)]
        scene.add(ls.Polygon(high), label=3)
    image = picture(tmp_path / "a.png", scene, camera=[(0, 0, 60), (0, 0, 0), (0, 1, 0)])
    ten = 10 * SIZE[1] / 2 / 60 / np.tan(np.radians(15))  # pixels of 10 m, seen from 60 m with an angle of 30°
    level, towards, away = (image[SIZE[1] // 2, round(SIZE[0] / 2 + side * ten)].max() for side in (0, -1, 1))
    assert away < 0.9 * level < 0.95 * towards
    assert min(towards, level, away) > 60


def test_heights_of_points_show_relief_by_their_normals(tmp_path: Path) -> None:
    y, z = np.meshgrid(np.linspace(-4, 4, 60), np.linspace(-2, 2, 40))
    xyz = np.stack([np.full(y.size, 10.0), y.ravel(), z.ravel()], 1)
    normal = np.where((y.ravel() > 0)[:, None], (0, 0, 1), (0.8, -0.6, 0))
    plain, shaded = (
        picture(tmp_path / "a.png", PointCloud(xyz=xyz, **more), color_by="height").max(axis=-1)
        for more in ({}, {"normal": normal.astype(np.float32)})
    )
    points = np.nonzero(plain[:170, :STAGE] > 60)  # above the caption
    darker = (shaded < 0.7 * plain)[points]
    assert 0.3 < darker.mean() < 0.6
    right = points[1] > np.median(points[1]) + 5
    assert darker[right].mean() > 0.9
    assert darker[points[1] < np.median(points[1]) - 25].mean() < 0.02  # level points keep their colours


def test_a_png_is_of_one_frame(wall: PointCloud, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^save: expected one frame for a PNG, got 2; GIF, MP4 and HTML \(.*\) show"):
        show([wall, wall], save=tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
    assert (picture(tmp_path / "a.png", [wall]) == picture(tmp_path / "b.png", wall)).all()


NAMES = [
    "one\ntwo",
    "",
    " ",
    "x" * 10_000,
    "\ud800",
    "\x1b[31m",
    "a\0b",
    "$\\frac{",
    "$x^2$",
    "a|b",
    "道路",
    "🚗",
    "машина",
]


WIDE = "x" * 22
"""A name that makes a legend as wide as it can be."""


def beside(image: np.ndarray, color: str) -> tuple[slice, slice]:
    """Return the part of a legend to the right of a colour."""
    rows, columns = np.nonzero(near(image[:, STAGE : STAGE + 24], color))
    return slice(rows.min(), rows.max() + 1), slice(STAGE + columns.max() + 2, None)


@pytest.mark.slow("drawing loses no name and prints nothing")
@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_no_name_is_lost_or_spoils_a_legend(name: str, wall: PointCloud, tmp_path: Path) -> None:
    wall.class_names = {7: name, 9: WIDE}
    scene = ls.Scene()
    scene.add(ls.Box((1, 1, 1), (12, 0, 0)), name=name, label=7)
    image = picture(tmp_path / "a.png", wall, color_by="label", scene=scene)
    wall.class_names = {9: WIDE}
    scene.update(0, name="")
    without = picture(tmp_path / "b.png", wall, color_by="label", scene=scene)
    assert (image[:, :STAGE] == without[:, :STAGE]).all()
    text = beside(image, QUALITATIVE[7])
    assert (image[text].max(axis=-1) > 60).sum() > 3  # something is written beside the colour
    legible = name.strip() and name not in {"道路", "🚗"}
    assert (image[text] == without[text]).all() == (not legible)
    assert len(scene.to_pyvista()) == len(scene.to_open3d()) == 1
    wall.class_names = {7: name}
    assert PointCloud.from_pyvista(wall.to_pyvista()).class_names[7].replace("\\ud800", "\ud800") == name


def test_formulas_are_text_and_vtk_stays_as_it_was(wall: PointCloud, tmp_path: Path) -> None:
    from vtkmodules.vtkRenderingCore import vtkTextRenderer

    pyvista.Plotter(off_screen=True).close()
    before = vtkTextRenderer.GetInstance().GetDefaultBackend()
    widths = []
    for name in ("xx", "$xx$"):
        wall.class_names = {7: name, 9: WIDE}
        image = picture(tmp_path / "a.png", wall, color_by="label")
        columns = np.flatnonzero((image[beside(image, QUALITATIVE[7])].max(axis=-1) > 60).any(axis=0))
        widths.append(np.ptp(columns))
    assert widths[1] > 1.5 * widths[0]  # both dollar signs are there
    assert vtkTextRenderer.GetInstance().GetDefaultBackend() == before


def test_no_points_are_no_objects(tmp_path: Path) -> None:
    empty = PointCloud(xyz=np.empty((0, 3)), range=np.empty(0))
    image = picture(tmp_path / "a.png", empty, color_by="range")
    panel = image[:, STAGE:]
    for color in SEQUENTIAL:  # no scale of numbers that there are not
        assert not near(panel, color, 4).any()


def test_values_that_are_not_finite_are_grey(wall: PointCloud, tmp_path: Path) -> None:
    wall.gain = np.where(wall.label == 7, np.inf, np.linspace(0, 1, len(wall)))
    wall.none = np.full(len(wall), np.nan)
    image = picture(tmp_path / "a.png", wall, color_by="gain")
    grey = near(image[:, :STAGE], MISSING)
    assert grey.sum() > 200
    assert np.nonzero(grey)[1].max() < 0.55 * STAGE  # to the left
    image = picture(tmp_path / "a.png", wall, color_by="none")
    assert near(image[:, :STAGE], MISSING).sum() > 400
    for color in SEQUENTIAL:
        assert not near(image, color, 4).any()
