"""KITTI's scans, as the scan class of semantic-kitti-api reads them: ``numpy.fromfile(…, float32).reshape(-1, 4)``."""

import warnings
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
    reason += "; are its columns others? PointCloud.load(…, columns=…) names them"
    assert str(caught.value) == f"{path}: not a readable .bin point cloud: {reason}"


NUMBERS = {
    "x": lambda rng, n: rng.uniform(0, 50, n),
    "y": lambda rng, n: rng.uniform(0, 50, n),
    "z": lambda rng, n: rng.uniform(0, 5, n),
    "intensity": lambda rng, n: rng.random(n),
    "ring": lambda rng, n: rng.integers(0, 64, n),
    "time": lambda rng, n: rng.random(n) / 10,
    "label": lambda rng, n: rng.integers(0, 20, n),
}
"""Columns in which nothing is out of its range whatever it is taken for."""


@pytest.mark.parametrize("columns", [3, 5, 6, 7])
@pytest.mark.parametrize(("suffix", "own"), [(".bin", 4), (".pcd.bin", 5)])
def test_another_number_of_columns_is_recognised_and_read_by_name(
    suffix: str, own: int, columns: int, tmp_path: Path
) -> None:
    path, rng = tmp_path / f"a{suffix}", np.random.default_rng(columns)
    names = list(NUMBERS)[:columns]
    points = np.stack([NUMBERS[name](rng, 840) for name in names], 1).astype(np.float32)
    points.tofile(path)
    if columns == own:
        assert PointCloud.load(path).ring.tolist() == points[:, 4].tolist()
    else:
        with pytest.raises(
            FileFormatError, match=rf"its numbers look like {columns} columns, expected {own}: .*columns="
        ):
            PointCloud.load(path)
    cloud = PointCloud.load(path, columns=names)
    assert set(cloud.fields) == {"xyz", *names[3:]}
    np.testing.assert_array_equal(cloud.xyz, points[:, :3])
    for name, column in zip(names[3:], points.T[3:], strict=True):
        np.testing.assert_array_equal(getattr(cloud, name), column)
    some = PointCloud.load(path, columns=[*names[:3], *"_" * (columns - 3)])
    assert (some.fields, len(some)) == (("xyz",), 840)
    with pytest.raises(ValueError, match=r"^columns: expected names, and '_' for each column to skip, got \['x', "):
        PointCloud.load(path, columns=[*names, ""])


@pytest.mark.parametrize("turns", range(1, 7))
def test_points_that_come_in_turns_are_not_taken_for_other_columns(turns: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(turns)
    xyz = np.tile(rng.normal(size=(turns, 3)), (900 // turns, 1))
    cloud = PointCloud(xyz=xyz, intensity=rng.random(len(xyz)), ring=np.arange(len(xyz)) % turns)
    for suffix in (".bin", ".pcd.bin"):
        cloud.save(tmp_path / f"a{suffix}")
        np.testing.assert_array_equal(PointCloud.load(tmp_path / f"a{suffix}").xyz, xyz.astype(np.float32))


@pytest.mark.parametrize(
    ("numbers", "reason"),
    [
        ([0, 0, 0, -0.5], "intensity: expected numbers from 0 to 65535, got intensity[0] = -0.5"),
        ([0, 0, 0, np.nan], "intensity: expected numbers from 0 to 65535, got intensity[0] = nan"),
        ([0, 1e-40, 0, 0], "y: expected 0, or 1.2e-38 to 1e+20 m, got y[0] = "),
        ([0, 0, -1e21, 0], "z: expected 0, or 1.2e-38 to 1e+20 m, got z[0] = "),
    ],
)
def test_numbers_that_are_of_other_columns(numbers: list[float], reason: str, tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    np.array(numbers, np.float32).tofile(path)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(caught.value).startswith(f"{path}: not a readable .bin point cloud: {reason}")
    assert str(caught.value).endswith("; are its columns others? PointCloud.load(…, columns=…) names them")
    cloud = PointCloud.load(path, columns=["x", "y", "z", "other"])
    with pytest.raises(FileFormatError) as caught:
        PointCloud(xyz=cloud.xyz, intensity=cloud.other).save(path)
    assert str(caught.value).startswith(reason.partition(",")[0])


@pytest.mark.parametrize("suffix", [".bin", ".pcd.bin"])
def test_coordinates_beyond_float32(suffix: str, tmp_path: Path) -> None:
    xyz = np.zeros((COUNT, 3))
    xyz[-1, 2] = -1e39
    with pytest.raises(
        FileFormatError, match=rf"^z: expected numbers that float32 can hold, got z\[{COUNT - 1}\] = -1e\+39"
    ):
        PointCloud(xyz=xyz).save(tmp_path / f"a{suffix}")
    assert not list(tmp_path.iterdir())
    xyz[-1, 2] = -np.inf
    PointCloud(xyz=xyz).save(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(PointCloud.load(tmp_path / f"a{suffix}").xyz, xyz)


@pytest.mark.parametrize("suffix", [".bin", ".pcd.bin"])
def test_coordinates_that_float32_moves(suffix: str, tmp_path: Path) -> None:
    cloud = PointCloud(xyz=np.array([[612345.3, 5264123.2, 400.1]]))
    with pytest.warns(UserWarning, match=r"^xyz: float32 moves points by up to 0.2 m; save the cloud in the sensor's"):
        cloud.save(tmp_path / f"a{suffix}")
    with warnings.catch_warnings(action="error"):
        PointCloud(xyz=cloud.xyz - cloud.xyz.round()).save(tmp_path / f"a{suffix}")


def test_what_is_brighter_than_the_greatest_remission_is_told(tmp_path: Path) -> None:
    cloud = PointCloud(xyz=np.zeros((3, 3)), intensity=[0.5, 49.99, np.inf])
    with pytest.warns(UserWarning, match="^intensity: KITTI's remission ends at 1; what is brighter is written as 1$"):
        cloud.save(tmp_path / "a.bin")
    assert np.fromfile(tmp_path / "a.bin", np.float32)[3::4].tolist() == [0.5, 1, 1]
    assert cloud.intensity[1] == np.float32(49.99)
