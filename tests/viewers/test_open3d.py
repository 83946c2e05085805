"""Open3D: conversion, its import on a server, and what the viewer is given."""

import inspect
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidarsim import io
from lidarsim.errors import LidarsimError, MissingExtraError
from lidarsim.pointcloud import CANONICAL, PointCloud
from lidarsim.viewers import open3d as view

assert io, "the formats register themselves on import"


def cloud_of_all(points: int) -> PointCloud:
    rng = np.random.default_rng(0)
    fields: dict[str, Any] = {
        name: rng.integers(0, 200, (points, *shape)).astype(dtype) for name, (shape, dtype) in CANONICAL.items()
    }
    for code in ("?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"):
        fields[f"extra_{np.dtype(code).name}"] = rng.integers(0, 2, points).astype(code)
    return PointCloud(fields, vector=rng.random((points, 2)), xyz=rng.normal(scale=1e6, size=(points, 3)))


@pytest.mark.parametrize("points", [0, 1, 100])
def test_every_field_is_an_attribute_of_its_dtype(points: int) -> None:
    cloud = cloud_of_all(points)
    converted = cloud.to_open3d()
    names = {name: {"xyz": "positions", "normal": "normals"}.get(name, name) for name in cloud.fields}
    assert set(names.values()) == {key for key, _ in converted.point.items()}
    for name, attribute in names.items():
        array, got = getattr(cloud, name), converted.point[attribute].numpy()
        assert got.dtype == (np.float64 if name == "normal" else array.dtype)
        assert got.shape == (array.shape if array.ndim == 2 else (points, 1))
        np.testing.assert_array_equal(got.reshape(array.shape), array)


def test_open3d_works_on_it(tmp_path: Path) -> None:
    o3d = view.import_open3d()
    cloud = cloud_of_all(100)
    del cloud.extra_bool  # which Open3D cannot write
    converted = cloud.to_open3d()
    assert len(converted.voxel_down_sample(1.0).point.positions) == 100
    moved = converted.clone().translate([1.0, 0, 0])
    np.testing.assert_allclose(moved.point.positions.numpy(), cloud.xyz + np.array([1, 0, 0]))
    assert len(converted.to_legacy().normals) == 100
    assert o3d.t.io.write_point_cloud(str(tmp_path / "cloud.pcd"), converted)
    read = PointCloud.load(tmp_path / "cloud.pcd")
    np.testing.assert_array_equal(read.xyz, cloud.xyz)
    np.testing.assert_array_equal(read.normal, cloud.normal)
    np.testing.assert_array_equal(read.label, cloud.label)


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

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("open3d.visualization.draw", record)
    view.show(PointCloud(xyz=np.eye(3), label=[5, 5, 9]), color_by="label")
    colors = shown[0].point.colors.numpy()
    assert colors.dtype == np.uint8
    assert colors[0].tolist() == colors[1].tolist() != colors[2].tolist()


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_show_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(LidarsimError) as caught:
        view.show(PointCloud(xyz=[[1, 2, 3]]))
    assert str(caught.value) == "no display to show a window on (DISPLAY is not set): write a screenshot instead"


def test_show_by_a_field_that_is_not_there() -> None:
    with pytest.raises(ValueError, match="color_by: expected one of height, got 'ring'"):
        view.show(PointCloud(xyz=[[1, 2, 3]]), color_by="ring")
