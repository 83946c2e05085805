"""Scans of nuScenes, as nuscenes-devkit reads them: ``numpy.fromfile(…, float32).reshape(-1, 5)``."""

from pathlib import Path

import numpy as np
import pytest

from lidarsim import io
from lidarsim.errors import FileFormatError
from lidarsim.scan.pointcloud import PointCloud

assert io, "the formats register themselves on import"

COUNT = 40_000  # more than a block


def test_layout(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cloud = PointCloud(
        xyz=rng.normal(scale=30, size=(COUNT, 3)), intensity=rng.random(COUNT) * 2.55, ring=rng.integers(0, 32, COUNT)
    )
    cloud.save(tmp_path / "a.pcd.bin")
    points = np.fromfile(tmp_path / "a.pcd.bin", np.float32).reshape(-1, 5)
    np.testing.assert_array_equal(points[:, :3], cloud.xyz.astype(np.float32))
    np.testing.assert_array_equal(points[:, 3], np.rint(cloud.intensity * np.float32(100)))
    np.testing.assert_array_equal(points[:, 4], cloud.ring)
    loaded = PointCloud.load(tmp_path / "a.pcd.bin")
    assert loaded.fields == ("xyz", "intensity", "ring")
    np.testing.assert_array_equal(loaded.intensity, points[:, 3])
    np.testing.assert_array_equal(loaded.ring, cloud.ring)


def test_missing_fields_are_zero(tmp_path: Path) -> None:
    PointCloud(xyz=[[1, 2, 3]]).save(tmp_path / "a.pcd.bin")
    assert np.fromfile(tmp_path / "a.pcd.bin", np.float32).tolist() == [1, 2, 3, 0, 0]


def test_a_part_of_a_point(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd.bin"
    path.write_bytes(bytes(16))
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    reason = "its 16 bytes are not a multiple of 20, those of a point (x, y, z, intensity, ring)"
    reason += "; are its columns others? PointCloud.load(…, columns=…) names them"
    assert str(caught.value) == f"{path}: not a readable .pcd.bin point cloud: {reason}"


def test_a_ring_that_is_none(tmp_path: Path) -> None:
    np.array([0, 0, 0, 0, 2.5], np.float32).tofile(tmp_path / "a.pcd.bin")
    with pytest.raises(FileFormatError, match=r"ring: expected integers from 0 to 65535, got ring\[0\] = 2.5"):
        PointCloud.load(tmp_path / "a.pcd.bin")


def test_what_is_brighter_than_the_byte_is_told(tmp_path: Path) -> None:
    cloud = PointCloud(xyz=np.zeros((2, 3)), intensity=[2.55, 2.6])
    with pytest.warns(
        UserWarning, match=r"^intensity: nuScenes' byte ends at 2\.55; what is brighter is written as 2\.55"
    ):
        cloud.save(tmp_path / "a.pcd.bin")
    assert np.fromfile(tmp_path / "a.pcd.bin", np.float32)[3::5].tolist() == [255, 255]


def test_an_intensity_beyond_the_byte(tmp_path: Path) -> None:
    np.array([0, 0, 0, 256, 2], np.float32).tofile(tmp_path / "a.pcd.bin")
    with pytest.raises(FileFormatError, match=r"intensity: expected numbers from 0 to 255, got intensity\[0\] = 256"):
        PointCloud.load(tmp_path / "a.pcd.bin")


@pytest.mark.parametrize("wrong", [-0.1, np.nan])
def test_an_intensity_that_the_byte_cannot_hold_is_refused(wrong: float, tmp_path: Path) -> None:
    with pytest.raises(
        FileFormatError, match=rf"^intensity: expected numbers from 0 to inf, got intensity\[1\] = {wrong}"
    ):
        PointCloud(xyz=np.zeros((2, 3)), intensity=[0, wrong]).save(tmp_path / "a.pcd.bin")
    assert not list(tmp_path.iterdir())
