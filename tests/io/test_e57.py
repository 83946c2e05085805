"""E57 files beside pye57's own reader and writer."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pye57
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from lidarsim.errors import FileFormatError, MissingExtraError
from lidarsim.scan.pointcloud import PointCloud

POSE = RigidTransform.from_components([1e5, 2e5, 3], Rotation.from_euler("xyz", [0.1, -0.2, 2.0])).as_matrix()


@pytest.fixture
def cloud() -> PointCloud:
    rng, n = np.random.default_rng(0), 1000
    return PointCloud(
        xyz=rng.normal(scale=1e5, size=(n, 3)),
        intensity=rng.random(n),
        time=rng.random(n),
        ring=rng.integers(0, 64, n),
        column=rng.integers(0, 2**32, n),
        return_number=rng.integers(1, 3, n),
        return_count=np.full(n, 2),
        label=np.ones(n),
        **{name: rng.integers(0, 256, n).astype(np.uint8) for name in ("red", "green", "blue")},
    )


def test_every_bit_of_what_is_kept_comes_back(cloud: PointCloud, tmp_path: Path) -> None:
    path = tmp_path / "a.e57"
    cloud.save(path)
    read = PointCloud.load(path)
    assert set(read.fields) == set(cloud.fields) - {"label"}
    for name in read.fields:
        assert getattr(read, name).dtype == getattr(cloud, name).dtype, name
        np.testing.assert_array_equal(getattr(read, name), getattr(cloud, name), err_msg=name)
    cloud[:0].save(path)
    assert len(PointCloud.load(path)) == 0


def test_pye57_reads_what_is_written(cloud: PointCloud, tmp_path: Path) -> None:
    path = tmp_path / "a.e57"
    cloud.column %= 2**16  # pye57 reads no more than that
    cloud.save(path, pose=POSE)
    with pye57.E57(str(path)) as file:
        assert file.scan_count == 1
        header, raw = file.get_header(0), file.read_scan_raw(0, ignore_unsupported_fields=True)
        np.testing.assert_array_equal(header.translation, POSE[:3, 3])
        np.testing.assert_allclose(header.rotation_matrix, POSE[:3, :3], rtol=0, atol=8 * 2.0**-53)  # by a quaternion
        placed = file.read_scan(0, intensity=True, colors=True, row_column=True)
    for column, axis in zip(cloud.xyz.T, "XYZ", strict=True):
        np.testing.assert_array_equal(raw[f"cartesian{axis}"], column)
    np.testing.assert_array_equal(raw["intensity"], cloud.intensity)
    np.testing.assert_array_equal(raw["colorGreen"], cloud.green)
    np.testing.assert_array_equal(placed["rowIndex"], cloud.ring)
    world, read = cloud.transformed(POSE).xyz, PointCloud.load(path).xyz
    theirs = np.stack([placed[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
    # Rounding of sums of four terms up to 1e6, of a quaternion that is off by a few ulps.
    np.testing.assert_allclose(read, world, rtol=0, atol=16 * 2.0**-53 * 1e6)
    np.testing.assert_allclose(theirs, world, rtol=0, atol=16 * 2.0**-53 * 1e6)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_name_that_is_not_unicode(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "a\udcff.e57")
    np.testing.assert_array_equal(PointCloud.load(tmp_path / "a\udcff.e57").xyz, cloud.xyz)


def test_scans_of_others_become_one_cloud_in_the_world(tmp_path: Path) -> None:
    path, rng = tmp_path / "a.e57", np.random.default_rng(1)
    points = rng.normal(size=(2, 50, 3))
    quaternion = Rotation.from_matrix(POSE[:3, :3]).as_quat(scalar_first=True)
    invalid = np.arange(50) % 5 == 0
    with pye57.E57(str(path), "w") as file:
        for k, xyz in enumerate(points):
            data = {f"cartesian{axis}": column for axis, column in zip("XYZ", xyz.T, strict=True)}
            data["cartesianInvalidState"] = (invalid * 2).astype(np.int8)
            rotation, translation = (quaternion, POSE[:3, 3]) if k else (np.array([1.0, 0, 0, 0]), np.zeros(3))
            file.write_scan_raw(data, rotation=rotation, translation=translation)
    cloud = PointCloud.load(path)
    assert cloud.scan.tolist() == [0] * 40 + [1] * 40
    # pye57 writes coordinates as float32.
    np.testing.assert_array_equal(cloud.xyz[:40], points[0][~invalid].astype(np.float32))
    there = points[1][~invalid].astype(np.float32) @ POSE[:3, :3].T + POSE[:3, 3]
    np.testing.assert_allclose(cloud.xyz[40:], there, rtol=0, atol=16 * 2.0**-53 * 1e6)


def test_content_tells_the_format(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "a.e57")
    (tmp_path / "a.e57").rename(tmp_path / "a.dat")
    assert len(PointCloud.load(tmp_path / "a.dat")) == len(cloud)


def test_points_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="xyz: expected finite coordinates"):
        PointCloud(xyz=[[1.0, np.nan, 2]]).save(tmp_path / "a.e57")
    assert not list(tmp_path.iterdir())


def test_a_truncated_file(cloud: PointCloud, tmp_path: Path) -> None:
    path = tmp_path / "a.e57"
    cloud.save(path)
    whole = path.read_bytes()
    for size in (8, 48, 1024, len(whole) // 2, len(whole) - 1024, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(FileFormatError, match=r"not a readable \.e57 point cloud") as caught:
            PointCloud.load(path)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)


def test_without_pye57(cloud: PointCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(MissingExtraError, match=r"E57 files needs pye57"):
        cloud.save(tmp_path / "a.e57")


INTENSITY = {"intensity": np.array([0.5])}
COLOURS = {f"color{name}": np.array([7], np.uint8) for name in ("Red", "Green", "Blue")}
GRID = {"rowIndex": np.array([1]), "columnIndex": np.array([2])}


@pytest.mark.parametrize("turned", [False, True])
def test_scans_of_other_columns(turned: bool, tmp_path: Path) -> None:
    path = tmp_path / "scans.e57"
    scans = [INTENSITY, COLOURS, GRID]
    written = pye57.E57(str(path), mode="w")
    for i, more in enumerate(scans[::-1] if turned else scans):
        place = {f"cartesian{axis}": np.array([float(i)]) for axis in "XYZ"}
        written.write_scan_raw(place | more, rotation=np.array([1.0, 0, 0, 0]), translation=np.array([0.0, 0, 5]))
    written.close()
    read = PointCloud.load(path)
    assert read.xyz.tolist() == [[0, 0, 5], [1, 1, 6], [2, 2, 7]]
    assert read.scan.tolist() == [0, 1, 2]
    order = slice(None, None, -1 if turned else 1)
    np.testing.assert_array_equal(read.intensity[order], np.array([0.5, np.nan, np.nan], np.float32))
    assert (read.red.dtype, read.red[order].tolist()) == (np.uint8, [0, 7, 0])
    assert (read.ring[order].tolist(), read.column[order].tolist()) == ([0, 0, 1], [0, 0, 2])
    assert not [name for name in read.fields if name.endswith("_raw")]
