"""Open3D: conversion, its import on a server, and what the viewer is given."""

import inspect
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import lidarsim as ls
from lidarsim import io
from lidarsim.errors import LidarsimError, MissingExtraError
from lidarsim.scan.fields import CANONICAL, narrow
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.viewers import open3d as view
from lidarsim.viewers._colors import QUALITATIVE

assert io, "the formats register themselves on import"


def cloud_of_all(points: int) -> PointCloud:
    rng = np.random.default_rng(0)
    fields: dict[str, Any] = {
        name: rng.integers(0, 200, (points, *shape)).astype(dtype) for name, (shape, dtype) in CANONICAL.items()
    }
    for code in ("?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"):
        fields[f"extra_{np.dtype(code).name}"] = rng.integers(0, 2, points).astype(code)
    return PointCloud(fields, vector=rng.random((points, 2)), xyz=rng.normal(scale=1e6, size=(points, 3)))


def columns_of(cloud: PointCloud) -> dict[str, npt.NDArray[Any]]:
    """Return what the attributes of the converted cloud are to hold."""
    columns: dict[str, npt.NDArray[Any]] = {"positions": cloud.xyz, "normals": cloud.normal}
    for name in cloud.fields:
        array = getattr(cloud, name)
        if name == "vector":
            columns |= {f"vector.{i}": array[:, [i]] for i in range(array.shape[1])}
        elif array.ndim == 1:
            columns[name] = array[:, np.newaxis]
    return columns


@pytest.mark.parametrize("points", [0, 1, 100])
def test_every_field_is_an_attribute(points: int) -> None:
    cloud = cloud_of_all(points)
    converted, columns = cloud.to_open3d(), columns_of(cloud)
    assert set(columns) == {key for key, _ in converted.point.items()}
    assert len(columns) == len(cloud.fields) + 1
    for name, column in columns.items():
        got = converted.point[name].numpy()
        kept = name != "normals" and column.dtype.name in {"uint8", "uint16", "int32", "float32", "float64"}
        assert got.dtype.name in ({column.dtype.name} if kept else {"uint8", "int32", "float64"}), name
        np.testing.assert_array_equal(got, column)


@pytest.mark.parametrize("points", [0, 1, 100])
def test_every_field_comes_back(points: int) -> None:
    cloud = cloud_of_all(points)
    cloud.single = np.ones((points, 1))
    cloud.wide = np.random.default_rng(1).random((points, 11))  # wide.10 comes after wide.9
    back = PointCloud.from_open3d(cloud.to_open3d())
    assert back.fields == cloud.fields
    for name in cloud.fields:
        got, want = getattr(back, name), getattr(cloud, name)
        np.testing.assert_array_equal(got, want, strict=name in CANONICAL)
        assert (got.shape, got.dtype) == (want.shape, want.dtype if name in CANONICAL else narrow(name, want).dtype)


def test_clouds_of_open3d_are_taken_over() -> None:
    o3d = view.import_open3d()
    points = np.random.default_rng(2).normal(scale=1e6, size=(5, 3))
    legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    legacy.normals = o3d.utility.Vector3dVector(np.tile([0.0, 0.6, 0.8], (5, 1)))
    legacy.paint_uniform_color((1.0, 0.5, 0.0))
    cloud = PointCloud.from_open3d(legacy)
    assert cloud.fields == ("xyz", "normal", "colors")
    np.testing.assert_array_equal(cloud.xyz, points)
    np.testing.assert_array_equal(cloud.normal, np.tile(np.float32([0.0, 0.6, 0.8]), (5, 1)))
    assert cloud.colors.tolist() == [[1.0, 0.5, 0.0]] * 5
    tensor = o3d.t.geometry.PointCloud(o3d.core.Tensor(points.astype(np.float32)))
    tensor.point["ring"] = o3d.core.Tensor(np.arange(5)[:, np.newaxis])
    taken = PointCloud.from_open3d(tensor)
    np.testing.assert_array_equal(taken.xyz, points.astype(np.float32))
    assert (taken.xyz.dtype, taken.ring.dtype, taken.ring.tolist()) == (np.float64, np.uint16, [0, 1, 2, 3, 4])
    tensor.point.positions[0] = 0.0
    assert taken.xyz[0].any()  # a copy


def test_what_is_no_cloud_of_open3d() -> None:
    o3d = view.import_open3d()
    with pytest.raises(TypeError, match="points: expected an Open3D point cloud, got ndarray"):
        PointCloud.from_open3d(np.zeros((3, 3)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="points: expected a point cloud with positions, got an empty one"):
        PointCloud.from_open3d(o3d.t.geometry.PointCloud())


def test_attributes_that_are_no_fields_as_they_are_lose_nothing() -> None:
    o3d = view.import_open3d()
    odd = o3d.t.geometry.PointCloud(o3d.core.Tensor(np.zeros((2, 3))))
    values = {"ring": [0.5, 1.0], "xyz": [2, 3], "a b": [4, 5], "a-b": [6, 7], "f": [8, 9], "f.0": [10, 11]}
    for name, numbers in values.items():
        odd.point[name] = o3d.core.Tensor(np.array(numbers)[:, np.newaxis])
    cloud = PointCloud.from_open3d(odd)
    assert {name: getattr(cloud, name).tolist() for name in cloud.fields} == {
        "xyz": [[0, 0, 0]] * 2, "ring": [0, 1], "ring_raw": [0.5, 1.0], "xyz_2": [2, 3],
        "a_b": [4, 5], "a_b_2": [6, 7], "f": [8, 9], "f_0": [10, 11],
    }  # fmt: skip


@pytest.mark.parametrize("suffix", ["pcd", "ply"])
@pytest.mark.parametrize("ascii_", [False, True])
def test_open3d_writes_and_reads_every_field(suffix: str, ascii_: bool, tmp_path: Path) -> None:
    o3d = view.import_open3d()
    cloud = cloud_of_all(100)
    path, columns = tmp_path / f"cloud.{suffix}", columns_of(cloud)
    assert o3d.t.io.write_point_cloud(str(path), cloud.to_open3d(), write_ascii=ascii_)
    read = o3d.t.io.read_point_cloud(str(path))
    assert set(columns) == {key for key, _ in read.point.items()}
    ours = PointCloud.load(path)
    assert set(ours.fields) == set(cloud.fields)
    # Its text has six significant digits in PLY, and at least as many in PCD: off by half a unit of the last.
    tolerance = 5e-6 if ascii_ else 0.0
    for name, column in columns.items():
        np.testing.assert_allclose(read.point[name].numpy(), column, rtol=tolerance, atol=0)
    for name in cloud.fields:
        np.testing.assert_allclose(getattr(ours, name), getattr(cloud, name), rtol=tolerance, atol=0)
        if name in CANONICAL:
            assert getattr(ours, name).dtype == getattr(cloud, name).dtype


@pytest.mark.parametrize("suffix", ["pcd", "ply"])
def test_labels_beyond_int32_stay_what_they_are(suffix: str, tmp_path: Path) -> None:
    o3d = view.import_open3d()
    cloud = PointCloud(xyz=np.zeros((3, 3)), label=[0, 2**31, 2**32 - 1], column=[1, 2**31 - 1, 3])
    converted = cloud.to_open3d()
    assert (converted.point.label.dtype, converted.point.column.dtype) == (o3d.core.float64, o3d.core.int32)
    path = str(tmp_path / f"cloud.{suffix}")
    assert o3d.t.io.write_point_cloud(path, converted)
    for read in (o3d.t.io.read_point_cloud(path).point.label.numpy()[:, 0], PointCloud.load(path).label):
        np.testing.assert_array_equal(read, cloud.label)


@pytest.mark.parametrize("value", [2**53 + 1, -(2**53) - 1])
def test_integers_that_no_type_of_open3d_holds_are_refused(value: int) -> None:
    cloud = PointCloud(xyz=np.zeros((2, 3)), serial=np.array([0, value]))
    expected = "serial: expected integers from -2**53 to 2**53, the most that Open3D's types hold"
    with pytest.raises(ValueError, match=f"^{re.escape(expected)}, got {value}$"):
        cloud.to_open3d()


def test_open3d_works_on_it() -> None:
    cloud = cloud_of_all(100)
    converted = cloud.to_open3d()
    assert len(converted.voxel_down_sample(1.0).point.positions) == 100
    moved = converted.clone().translate([1.0, 0, 0])
    np.testing.assert_allclose(moved.point.positions.numpy(), cloud.xyz + np.array([1, 0, 0]))
    assert len(converted.to_legacy().normals) == 100


@pytest.mark.skipif(sys.platform != "linux", reason="only Open3D's Linux wheel links to libusb")
def test_libusb_comes_from_its_package() -> None:
    import libusb_package

    view.import_open3d()
    assert str(libusb_package.get_library_path()) in Path("/proc/self/maps").read_text()


def test_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError) as caught:
        PointCloud(xyz=[[1, 2, 3]]).to_open3d()
    assert str(caught.value) == 'this view needs open3d: pip install "lidarsim[open3d]"'


def test_show_gives_the_viewer_coloured_points(monkeypatch: pytest.MonkeyPatch) -> None:
    draw = view.import_open3d().visualization.draw
    shown: list[Any] = []

    def record(*args: Any, **options: Any) -> None:
        inspect.signature(draw).bind(*args, **options)
        shown.extend(args)

    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    monkeypatch.setattr("open3d.visualization.draw", record)
    scene = ls.Scene()
    scene.add(ls.Sphere((1, 0, 0), 1.0), name="ball", label=9)
    far = np.eye(4)
    far[:3, 3] = 5e6
    ls.show(PointCloud(xyz=np.eye(3) + 5e6, label=[5, 5, 9]), scene=scene, color_by="label", viewer="open3d", pose=far)
    parts = {part["name"]: part for part in shown[0]}
    assert list(parts) == ["frame 0", "0 ball", "sensor"]
    assert np.abs(parts["frame 0"]["geometry"].point.positions.numpy()).max() < 2  # relative to their middle
    colors = parts["frame 0"]["geometry"].point.colors.numpy()
    for color, label in zip(colors, (5, 5, 9), strict=True):  # in linear light
        assert color.dtype == np.float32
        encoded = np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1 / 2.4) - 0.055)
        assert bytes(np.round(255 * encoded).astype(np.uint8)).hex() == QUALITATIVE[label][1:]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_show_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(LidarsimError) as caught:
        ls.show(PointCloud(xyz=[[1, 2, 3]]), viewer="open3d")
    assert (
        str(caught.value)
        == "no display to open a window on (DISPLAY is not set): write a file instead (save=, --screenshot)"
    )


def test_a_window_that_open3d_cannot_open_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    view.import_open3d()

    def refuse(*_args: Any, **_options: Any) -> None:
        raise RuntimeError("Failed to load vulkan library!")

    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    monkeypatch.setattr("open3d.visualization.draw", refuse)
    with pytest.raises(LidarsimError, match=r"cannot open a window here \(Failed to load vulkan library!\): try"):
        ls.show(PointCloud(xyz=[[1, 2, 3]]), viewer="open3d")


@pytest.mark.skipif(sys.platform != "linux", reason="only there is DISPLAY looked at")
@pytest.mark.parametrize("display", [":7391", "localhost:391.0", "nonsense"])
def test_a_display_where_nothing_answers(display: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", display)
    for viewer in ("pyvista", "open3d"):
        with pytest.raises(LidarsimError, match=f"DISPLAY is {display}, where nothing answers"):
            ls.show(PointCloud(xyz=[[1, 2, 3]]), viewer=viewer)  # type: ignore[arg-type]


def test_show_by_a_field_that_is_not_there() -> None:
    with pytest.raises(ValueError, match="color_by: expected one of height, got 'ring'"):
        ls.show(PointCloud(xyz=[[1, 2, 3]]), color_by="ring", viewer="open3d")


def parts_of(monkeypatch: pytest.MonkeyPatch, what: Any, **looks: Any) -> dict[str, Any]:
    """Return by name what the viewer is given."""
    view.import_open3d()
    shown: list[Any] = []
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    monkeypatch.setattr("open3d.visualization.draw", lambda parts, **_: shown.extend(parts))
    ls.show(what, viewer="open3d", **looks)
    assert len({part["name"] for part in shown}) == len(shown)
    return {part["name"]: part for part in shown}


def test_faces_have_the_colours_of_their_labels(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ls.Scene()
    vertices = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    scene.add(ls.TriangleMesh(vertices, [(0, 1, 2), (0, 2, 3)]), name="two\n\ud800", label=[3, 8])
    parts = parts_of(monkeypatch, scene, color_by="label")
    sides = [part for name, part in parts.items() if name.startswith(r"0 two\n\ud800")]
    assert [bytes(round(255 * c) for c in part["material"].base_color[:3]).hex() for part in sides] == [
        QUALITATIVE[label][1:] for label in (3, 8)
    ]
    assert [len(part["geometry"].triangle.indices) for part in sides] == [1, 1]


def test_surfaces_are_coloured_by_height(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ls.Scene()
    scene.add(ls.Box((4, 4, 8), (0, 0, 4)), name="x" * 10_000)
    parts = parts_of(monkeypatch, scene, color_by="height")
    (box,) = (part["geometry"] for name, part in parts.items() if name.startswith("0 xxx"))
    z, colors = box.vertex.positions.numpy()[:, 2], box.vertex.colors.numpy()
    assert np.ptp(z) == pytest.approx(8)
    assert len(np.unique(colors, axis=0)) >= 16
    assert (np.diff(colors[np.argsort(z)].sum(axis=1)) >= 0).all()  # the higher the lighter
