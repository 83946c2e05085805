"""PTS and PTX beside files written by hand, as their formats describe them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.scan.pointcloud import PointCloud

# Two columns of three rows; the matrix turns by 90° to the left, as rows of its transpose, and moves by (10, 20, 30).
HEAD = "2\n3\n10 20 30\n0 1 0\n-1 0 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 20 30 1\n"
GRID = "1 2 3 0.25\n0 0 0 0.5\n4 5 6 0.75\n0 0 0 0.5\n7 8 9 1\n-1 -2 -3 0\n"


def cloud_with_colours(n: int = 40) -> PointCloud:
    rng = np.random.default_rng(1)
    colours = {name: rng.integers(0, 256, n).astype(np.uint8) for name in ("red", "green", "blue")}
    return PointCloud(xyz=rng.normal(scale=1e3, size=(n, 3)), intensity=rng.random(n), label=np.ones(n), **colours)


def same(a: PointCloud, b: PointCloud, *names: str) -> None:
    assert set(a.fields) == set(names)
    for name in names:
        got, want = getattr(a, name), getattr(b, name)
        assert got.dtype == want.dtype
        np.testing.assert_array_equal(got, want, err_msg=name)


@pytest.mark.parametrize("suffix", [".pts", ".ptx"])
def test_every_bit_of_what_is_kept_comes_back(suffix: str, tmp_path: Path) -> None:
    cloud, path = cloud_with_colours(), tmp_path / f"a{suffix}"
    cloud.save(path)
    same(PointCloud.load(path), cloud, "xyz", "intensity", "red", "green", "blue")
    cloud.save(path, fields=["intensity"])
    same(PointCloud.load(path), cloud, "xyz", "intensity")
    cloud[:0].save(path)
    assert len(PointCloud.load(path)) == 0


def test_a_pts_file_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "a.pts"
    path.write_text("2\r\n1 2 3 -2048 255 0 7\r\n4.5 5 6 2047 0 0 0\r\n1\n7 8 9 12 1 2 3\n\n0\n")
    cloud = PointCloud.load(path)
    assert cloud.xyz.tolist() == [[1, 2, 3], [4.5, 5, 6], [7, 8, 9]]
    assert cloud.intensity.tolist() == [-2048, 2047, 12]
    assert cloud.red.tolist() == [255, 0, 1]
    PointCloud(xyz=[[1, 2, 3], [0.1, 5, 1e-9]], intensity=[0.1, 0.7]).save(path)
    assert path.read_text() == "2\n1.0 2.0 3.0 0.1\n0.1 5.0 1e-09 0.7\n"  # the fewest digits for each float32, too


def test_a_ptx_file_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "a.ptx"
    path.write_text(HEAD + GRID)
    cloud = PointCloud.load(path)
    # (x, y, z) becomes (10 - y, 20 + x, 30 + z).
    assert cloud.xyz.tolist() == [[8, 21, 33], [5, 24, 36], [2, 27, 39], [12, 19, 27]]
    assert cloud.intensity.tolist() == [0.25, 0.75, 1, 0]
    assert cloud.column.tolist() == [0, 0, 1, 1]
    assert cloud.ring.tolist() == [0, 2, 1, 2]
    assert "scan" not in cloud.fields
    path.write_text(HEAD + GRID + HEAD.replace("2\n3", "1\n1", 1) + "1 1 1 0.5\n")
    assert PointCloud.load(path).scan.tolist() == [0, 0, 0, 0, 1]


def test_pose_and_grid_of_a_scan(tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.8))
    pose = RigidTransform.from_components([10, 20, 30], Rotation.from_euler("z", np.pi / 2)).as_matrix()
    scan = ls.Lidar(ls.patterns.Spinning(np.radians([-20.0, -10, 5]), columns=12)).scan(scene)
    cloud, path = scan.point_cloud(), tmp_path / "a.ptx"
    cloud.save(path, pose=pose)
    lines = path.read_text().splitlines()
    assert lines[:2] == ["12", "2"]
    assert [[float(word) for word in line.split()] for line in lines[2:6]] == [
        pose[:3, 3].tolist(),
        *pose[:3, :3].T.tolist(),
    ]
    np.testing.assert_array_equal(np.loadtxt(lines[6:10]), pose.T)
    assert len(lines) == 10 + 24
    read = PointCloud.load(path)
    order = np.lexsort((cloud.ring, cloud.column))
    np.testing.assert_allclose(read.xyz, cloud.transformed(pose).xyz[order], rtol=0, atol=8 * 2.0**-53 * 32)
    np.testing.assert_array_equal(read.column, cloud.column[order])
    np.testing.assert_array_equal(read.ring, cloud.ring[order])
    twice = PointCloud.concatenate([cloud, cloud])  # each place twice: a single row
    twice.save(path)
    assert path.read_text().splitlines()[:2] == ["48", "1"]
    same(PointCloud.load(path), twice, "xyz", "intensity")


def test_ptx_leaves_places_without_a_point_out(tmp_path: Path) -> None:
    cloud, path = PointCloud(xyz=[[1, 2, 3], [4, 5, 6]], column=[0, 1], ring=[1, 0]), tmp_path / "a.ptx"
    cloud.save(path)
    assert path.read_text().splitlines()[10:] == [
        "0.0 0.0 0.0 0.5",
        "1.0 2.0 3.0 0.5",
        "4.0 5.0 6.0 0.5",
        "0.0 0.0 0.0 0.5",
    ]
    read = PointCloud.load(path)
    assert read.xyz.tolist() == cloud.xyz.tolist()
    assert (read.column.tolist(), read.ring.tolist()) == ([0, 1], [1, 0])
    cloud.column = [0, 2**32 - 1]  # a grid of 2**33 places would not be written
    cloud.save(path)
    assert path.read_text().splitlines()[:2] == ["2", "1"]


def test_intensity_beyond_1(tmp_path: Path) -> None:
    cloud = PointCloud(xyz=[[1, 2, 3]], intensity=[1.5])
    with pytest.warns(UserWarning, match="the intensity of PTX ends at 1"):
        cloud.save(tmp_path / "a.ptx")
    assert PointCloud.load(tmp_path / "a.ptx").intensity.tolist() == [1.0]


@pytest.mark.parametrize(
    ("suffix", "fields", "problem"),
    [
        (".pts", {"xyz": [[1.0, np.nan, 2]]}, "xyz: expected finite coordinates, got xyz[0] = [1.0, nan, 2.0]"),
        (".ptx", {"xyz": [[1.0, np.inf, 2]]}, "xyz: expected finite coordinates, got xyz[0] = [1.0, inf, 2.0]"),
        (".ptx", {"xyz": [[1.0, 1, 2]], "intensity": [np.nan]}, "intensity: expected numbers from 0 to inf, got inten"),
        (".ptx", {"xyz": [[1.0, 1, 2]], "intensity": [-1]}, "intensity: expected numbers from 0 to inf, got inten"),
        (".ptx", {"xyz": [[1.0, 1, 2], [0, 0, 0]]}, "xyz: expected no point at the origin, where PTX has none"),
        (
            ".pts",
            {"xyz": [[1.0, 1, 2]], "red": [256], "green": [0], "blue": [0]},
            "red: expected 0 to 255 for a colour",
        ),
    ],
)
def test_clouds_that_cannot_be_written(
    suffix: str, fields: dict[str, list[float]], problem: str, tmp_path: Path
) -> None:
    with pytest.raises(FileFormatError) as caught:
        PointCloud(fields).save(tmp_path / f"a{suffix}")
    assert str(caught.value).startswith(problem)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("a.pts", "x\n", "number of points: expected a whole number, got something else"),
        ("a.pts", "-1\n", "number of points: expected a whole number, got something else"),
        ("a.pts", "3\n1 2 3\n", "it is truncated: 1 of 3 points"),
        ("a.pts", "3\n", "it is truncated: no points"),
        ("a.pts", f"{10**17}\n1 2 3\n", "it is truncated: 1 of 100000000000000000 points"),
        ("a.pts", f"{10**30}\n1 2 3\n", "number of points: expected a whole number, got"),
        ("a.pts", "1\n1 2 3 4 5\n", "point 0: expected 3 or 4 or 6 or 7 columns, got 5"),
        ("a.pts", "2\n1 2 3\n1 2 3 4 5\n", "point 1: expected 3 or 4 or 6 or 7 columns, got 5"),
        ("a.pts", "1\n1 2 x\n", "z[0]: expected a number, got something else"),
        ("a.pts", "", "expected the number of points, got nothing"),
        ("a.ptx", "\n\n", "expected the number of columns, got nothing"),
        ("a.ptx", "2\n", "number of rows: expected a whole number, got something else"),
        ("a.ptx", "2\n3\n0 0\n", "position: expected 3 finite numbers, got 2"),
        ("a.ptx", HEAD.replace("10 20 30 1", "10 20 30"), "row 4 of the matrix: expected 4 finite numbers, got 3"),
        ("a.ptx", HEAD.replace("0 0 1 0", "0 0 1 2") + GRID, "its matrix has the last column [0.0, 0.0, 2.0, 1.0]"),
        ("a.ptx", HEAD + GRID[:-11], "it is truncated: 5 of 6 points"),
        ("a.ptx", HEAD.replace("2\n3", f"{10**17}\n{10**17}", 1) + GRID, f"it is truncated: 6 of {10**34} points"),
    ],
)
def test_damaged_files(name: str, text: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(path) in str(caught.value)
    assert problem in str(caught.value)


def test_lists_and_lines_of_other_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.pts"
    path.write_text("3\n1 0 0 0.5 1 2 3\n2 0 0\n3 0 0 0.25\n2\n4 0 0 7 8 9\n5 0 0 0.75\n")
    cloud = PointCloud.load(path)
    assert cloud.xyz[:, 0].tolist() == [1, 2, 3, 4, 5]
    np.testing.assert_array_equal(cloud.intensity, np.array([0.5, np.nan, 0.25, np.nan, 0.75], np.float32))
    assert np.column_stack([cloud.red, cloud.green, cloud.blue]).tolist() == [
        [1, 2, 3],
        [0] * 3,
        [0] * 3,
        [7, 8, 9],
        [0] * 3,
    ]
    assert cloud.red.dtype == np.uint8


def test_scans_of_ptx_of_other_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.ptx"
    coloured_grid = "1 2 3 0.25 1 2 3\n" + "0 0 0 0.5\n" * 2 + "4 5 6 0.75 4 5 6\n" * 3
    path.write_text(HEAD + GRID + HEAD + coloured_grid)
    cloud = PointCloud.load(path)
    assert cloud.scan.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert cloud.red.tolist() == [0, 0, 0, 0, 1, 4, 4, 4]
    assert cloud.intensity[4:].tolist() == [0.25, 0.75, 0.75, 0.75]
