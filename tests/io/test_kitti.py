"""KITTI's scans, as the scan class of semantic-kitti-api reads them: ``numpy.fromfile(…, float32).reshape(-1, 4)``."""

from pathlib import Path

import numpy as np
import pytest

from lidarsim import io
from lidarsim.errors import FileFormatError
from lidarsim.pointcloud import PointCloud

assert io, "the formats register themselves on import"

COUNT = 40_000  # more than a block


def test_layout(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cloud = PointCloud(xyz=rng.normal(scale=30, size=(COUNT, 3)), intensity=rng.random(COUNT), ring=np.ones(COUNT))
    cloud.save(tmp_path / "000000.bin")
    points = np.fromfile(tmp_path / "000000.bin", np.float32).reshape(-1, 4)
    np.testing.assert_array_equal(points[:, :3], cloud.xyz.astype(np.float32))
    np.testing.assert_array_equal(points[:, 3], cloud.intensity)
    loaded = PointCloud.load(tmp_path / "000000.bin")
    assert loaded.fields == ("xyz", "intensity")
    np.testing.assert_array_equal(loaded.xyz, points[:, :3])
    np.testing.assert_array_equal(loaded.intensity, points[:, 3])


def test_without_intensity_and_without_points(tmp_path: Path) -> None:
    PointCloud(xyz=[[1, 2, 3]]).save(tmp_path / "a.bin")
    assert np.fromfile(tmp_path / "a.bin", np.float32).tolist() == [1, 2, 3, 0]
    PointCloud(xyz=np.empty((0, 3))).save(tmp_path / "a.bin")
    assert (tmp_path / "a.bin").read_bytes() == b""
    assert PointCloud.load(tmp_path / "a.bin").intensity.tolist() == []


def test_a_part_of_a_point(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(20))
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    reason = "its 20 bytes are not a multiple of 16, those of a point (x, y, z, intensity)"
    assert str(caught.value) == f"{path}: not a readable .bin point cloud: {reason}"
