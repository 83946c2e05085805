"""CSV and XYZ beside Open3D, NumPy and the csv module."""

import csv
from pathlib import Path

import numpy as np
import pytest

from lidarsim import io
from lidarsim.errors import FileFormatError
from lidarsim.pointcloud import CANONICAL, PointCloud
from lidarsim.viewers.open3d import import_open3d

assert io, "the formats register themselves on import"

COUNT = 5000  # more than a block of lines


@pytest.fixture(scope="module")
def cloud() -> PointCloud:
    rng = np.random.default_rng(0)
    fields = {
        name: rng.integers(0, 200, (COUNT, *shape)).astype(dtype)
        if issubclass(dtype, np.integer)
        else rng.normal(scale=1e6, size=(COUNT, *shape)).astype(dtype)
        for name, (shape, dtype) in CANONICAL.items()
    }
    fields["label"][0], fields["object_id"][0], fields["ring"][0] = 2**32 - 1, -1, 65535
    fields["xyz"][1], fields["xyz"][2, 0], fields["intensity"][:2] = np.nan, 5e-324, (1e-45, np.inf)
    return PointCloud(fields, flow=rng.normal(size=(COUNT, 2)), on=rng.random(COUNT) < 0.5)


@pytest.mark.parametrize("suffix", [".csv", ".xyz"])
def test_every_bit_of_lidarsims_fields_comes_back(cloud: PointCloud, suffix: str, tmp_path: Path) -> None:
    cloud.save(tmp_path / f"a{suffix}")
    loaded = PointCloud.load(tmp_path / f"a{suffix}")
    assert loaded.fields == cloud.fields
    for name in CANONICAL:
        assert getattr(loaded, name).dtype == getattr(cloud, name).dtype
        np.testing.assert_array_equal(getattr(loaded, name), getattr(cloud, name))
    np.testing.assert_array_equal(loaded.flow, cloud.flow)
    assert loaded.on.dtype == np.float64
    np.testing.assert_array_equal(loaded.on, cloud.on)


def test_the_csv_module_reads_it(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "a.csv", fields=["time", "ring", "flow"])
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["x", "y", "z", "time", "ring", "flow.0", "flow.1"]
    assert [float(row["time"]) for row in rows] == cloud.time.tolist()
    assert [row["ring"] for row in rows] == [str(ring) for ring in cloud.ring]


def test_open3d_reads_xyz(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    PointCloud(xyz=points, ring=range(50)).save(tmp_path / "a.xyz")
    read = import_open3d().io.read_point_cloud(str(tmp_path / "a.xyz"))
    np.testing.assert_array_equal(np.asarray(read.points), points)


def test_numpy_reads_xyz(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "a.xyz", fields=["range"])
    assert (tmp_path / "a.xyz").read_text().startswith("# x y z range\n")
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "a.xyz"), np.column_stack((cloud.xyz, cloud.range)))


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("1 2 3\n4 5 6\n", {"xyz": [[1, 2, 3], [4, 5, 6]]}),
        ("1 2 3", {"xyz": [[1, 2, 3]]}),
        ("//X Y Z Intensity\n\n1 2 3 4\n \n", {"xyz": [[1, 2, 3]], "Intensity": [4]}),
        ('\ufeff"x"; "y"; "z"; "ring"\r\n1;2;3;4\r\n', {"xyz": [[1, 2, 3]], "ring": [4]}),
        ("x,y,z,gps time\n1e3,-2.5,nan,7\n", {"xyz": [[1000, -2.5, np.nan]], "gps_time": [7]}),
        ("x y z\n", {"xyz": np.empty((0, 3))}),
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".xyz"])
def test_files_of_others(text: str, fields: dict[str, list[float]], suffix: str, tmp_path: Path) -> None:
    (tmp_path / f"a{suffix}").write_text(text, encoding="utf-8", newline="")
    loaded = PointCloud.load(tmp_path / f"a{suffix}")
    assert set(loaded.fields) == set(fields)
    for name, values in fields.items():
        np.testing.assert_array_equal(getattr(loaded, name), values)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"1 2 3 4\n", "its first line has no column names, and there are 4 columns"),
        (b"", "it has no x among its fields"),
        (b"x y q\n1 2 3\n", "it has no z among its fields x, y, q"),
        (b"x y z x\n1 2 3 4\n", "it has two columns named 'x'"),
        (b"x y z\n1 2\n", "it has 3 column names, but 2 numbers per line"),
        (b"x y z\n1 2 3\n1 2\n", "the number of columns changed from 3 to 2 at row 2"),
        (b"x y z\n1 2 three\n", "could not convert string … to float64 at row 0, column 3"),
        (b"x y z ring\n1 2 3 70000\n", "ring: expected integers from 0 to 65535, got ring[0] = 70000.0"),
        (b"x y z\n1 2 \xff\n", "'utf-8' codec can't decode byte 0xff"),
        (b"x y z\n1 2 3\0\n", "could not convert string"),
    ],
)
def test_bad_files(content: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(caught.value).startswith(f"{path}: not a readable .xyz point cloud: {reason}")


def test_a_misfit_after_the_first_block_is_told_by_its_place(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = [f"0,0,0,{70_000 if row == COUNT - 1 else 1}" for row in range(COUNT)]
    path.write_text("\n".join(["x,y,z,ring", *lines]))
    with pytest.raises(FileFormatError, match=rf"got ring\[{COUNT - 1}\] = 70000"):
        PointCloud.load(path)
