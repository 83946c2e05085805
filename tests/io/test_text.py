"""CSV and XYZ beside Open3D, NumPy and the csv module."""

import csv
from pathlib import Path

import numpy as np
import pytest

from lidarsim import io
from lidarsim.errors import FileFormatError
from lidarsim.scan.fields import CANONICAL
from lidarsim.scan.pointcloud import PointCloud
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
        ("//X Y Z Intensity\n\n1 2 3 4\n \n", {"xyz": [[1, 2, 3]], "intensity": [4]}),
        ('\ufeff"x"; "y"; "z"; "ring"\r\n1;2;3;4\r\n', {"xyz": [[1, 2, 3]], "ring": [4]}),
        ("x,y,z,gps time\n1e3,-2.5,nan,7\n", {"xyz": [[1000, -2.5, np.nan]], "gps_time": [7]}),
        ("x y z\n", {"xyz": np.empty((0, 3))}),
        ("# x y z ring\n", {"xyz": np.empty((0, 3)), "ring": []}),
        (
            "# of a scan\n# x y z ring\n# in m\n1 2 3 4\n// more\n5 6 7 8",
            {"xyz": [[1, 2, 3], [5, 6, 7]], "ring": [4, 8]},
        ),
        ("x\ty\tz\tgps time\n1\t2\t3\t\n", {"xyz": [[1, 2, 3]], "gps_time": [np.nan]}),
        ("x y z\tring\r\n1 2\t3 4\r\n", {"xyz": [[1, 2, 3]], "ring": [4]}),
        ("x,y,z\r1,2,3\r", {"xyz": [[1, 2, 3]]}),
        (
            ",x,y,z,intensity\n0,1,2,3,\n1,4,5,6,0.5,\n",
            {"xyz": [[1, 2, 3], [4, 5, 6]], "unnamed_1": [0, 1], "intensity": [np.nan, 0.5]},
        ),
        ("1,2,3,\n4,5,6,\n", {"xyz": [[1, 2, 3], [4, 5, 6]]}),
        ("x;y;z;\n1;2;3;\n", {"xyz": [[1, 2, 3]]}),
        ("x,y,z,\n1,2,3\n", {"xyz": [[1, 2, 3]]}),
        ("1,2,3,\n4,5,6,7\n", {"xyz": [[1, 2, 3], [4, 5, 6]], "intensity": [np.nan, 7]}),
        ("x,y,z,a,\n1,2,3,,\n", {"xyz": [[1, 2, 3]], "a": [np.nan]}),
        ("1 2 3 # a, b\n4 5 6\n", {"xyz": [[1, 2, 3], [4, 5, 6]]}),
        ("x,y,z\n1,2,3 # a\n4,5,6, // b\n", {"xyz": [[1, 2, 3], [4, 5, 6]]}),
        ('"1";" 2";"1.#QNAN"\n', {"xyz": [[1, 2, np.nan]]}),
        ("1 2 3 0.5\n", {"xyz": [[1, 2, 3]], "intensity": [0.5]}),
        ("1 2 3 255 16 77\n", {"xyz": [[1, 2, 3]], "red": [255], "green": [16], "blue": [77]}),
        (
            "1 2 3 0.577 0.577 0.577\n4 5 6 0 0 -1\n",
            {"xyz": [[1, 2, 3], [4, 5, 6]], "normal": np.float32([[0.577] * 3, [0, 0, -1]])},
        ),
        ("1,2,3,143,1,2\n", {"xyz": [[1, 2, 3]], "column_4": [143], "column_5": [1], "column_6": [2]}),
        ("1,2,3,0.5,0,300\n", {"xyz": [[1, 2, 3]], "column_4": [0.5], "column_5": [0], "column_6": [300]}),
        ("1 2 3 -4 255 16 77\n", {"xyz": [[1, 2, 3]], "intensity": [-4], "red": [255], "green": [16], "blue": [77]}),
        ("1 2 3 255 16 77 0.5\n", {"xyz": [[1, 2, 3]], "intensity": [0.5], "red": [255], "green": [16], "blue": [77]}),
        ("1 2 3 1 2 3 4\n", {"xyz": [[1, 2, 3]]} | {f"column_{i + 4}": [i + 1] for i in range(4)}),
        (
            "2\n1 2 3 4 255 16 77\n4 5 6 5 1 1 1\n",
            {"xyz": [[1, 2, 3], [4, 5, 6]], "intensity": [4, 5], "red": [255, 1], "green": [16, 1], "blue": [77, 1]},
        ),
        ("x y z n\n0 0 0 1\n0 0 0 1764115200123456789\n", {"xyz": [[0, 0, 0]] * 2, "n": [1, 1764115200123456789]}),
        ("x y z n\n0 0 0 18446744073709551615\n", {"xyz": [[0, 0, 0]], "n": [2**64 - 1]}),
        ("x y z label\n0 0 0 -1\n0 0 0 7\n", {"xyz": [[0, 0, 0]] * 2, "label": [0, 7], "label_raw": [-1, 7]}),
        (
            "x,y,z,a b,a-b,save,f.0,f.1,f\n1,2,3,4,5,6,7,8,9\n",
            {"xyz": [[1, 2, 3]], "a_b": [4], "a_b_2": [5], "save_": [6], "f_0": [7], "f_1": [8], "f": [9]},
        ),
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".xyz"])
def test_files_of_others(text: str, fields: dict[str, list[float]], suffix: str, tmp_path: Path) -> None:
    (tmp_path / f"a{suffix}").write_text(text, encoding="utf-8", newline="")
    loaded = PointCloud.load(tmp_path / f"a{suffix}")
    assert set(loaded.fields) == set(fields)
    if "n" in fields:
        assert loaded.n.tolist() == fields["n"]
    for name, values in fields.items():
        np.testing.assert_array_equal(getattr(loaded, name), values)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"1 2\n", "its first line has no column names, and there are 2 columns"),
        (b"", "it has no x among its fields"),
        (b"x y q\n1 2 3\n", "it has no z among its fields x, y, q"),
        (b"x y z x\n1 2 3 4\n", "it has two columns named 'x'"),
        (b"x y z\n1 2\n", "line 2: expected 3 numbers (x, y, z), got 2"),
        (b"x,y,z\n1,5,2,5,3,5\n", "line 2: expected 3 numbers (x, y, z), got 6"),
        (b"x y z\n1 2 3\n\n# a\n1 2\n", "line 5: expected 3 numbers (x, y, z), got 2"),
        (b"x y z\n1 2 three\n", "line 2, z: expected a number, got something else"),
        (b"x,y,z\n" + b"1,2,3\n" * COUNT + b"1,-,3\n", f"line {COUNT + 2}, y: expected a number, got something else"),
        (b"x;y;z\n1,5;2;3\n", "line 2, x: expected a number with a point, not a comma, got '1,5'"),
        (b"1,5;2,5;3,5\n", "line 1, column 1: expected a number with a point, not a comma, got '1,5'"),
        (b"1,5 2,5 3,5\n", "line 1, column 1: expected a number with a point, not a comma, got '1,5'"),
        (b"1,5\t2,5\t3,5\n", "line 1, column 1: expected a number with a point, not a comma, got '1,5'"),
        (b"x y z\n1 2 1_000\n", "line 2, z: expected a number, got something else"),
        (b"x y z\n1 2 \xff\n", "line 2, z: expected a number, got something else"),
        (b"x y z\n1 2 3\0\n", "line 2, z: expected a number, got something else"),
        (b"3\n1 2 3\n4 5 6\n", "its first line says 3 points, but there are 2"),
        (b"1\n1 2 3\n4 5 6\n", "its first line says 1 points, but there are 2"),
        (b"7\n", "its first line says 7 points, but there are 0"),
    ],
)
def test_bad_files(content: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(caught.value).startswith(f"{path}: not a readable .xyz point cloud: {reason}")


def test_a_misfit_after_the_first_block_keeps_the_whole_column(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rings = [70_000 if row == COUNT - 1 else 1 for row in range(COUNT)]
    path.write_text("\n".join(["x,y,z,ring", *(f"0,0,0,{ring}" for ring in rings)]))
    cloud = PointCloud.load(path)
    assert cloud.ring_raw.tolist() == rings
    assert cloud.ring.tolist() == [*rings[:-1], 0]
    assert (cloud.ring.dtype, cloud.ring_raw.dtype) == (np.uint16, np.int64)


def test_columns_by_name(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_text("9 1 2 3 7\n")
    cloud = PointCloud.load(path, columns=["_", "x", "y", "z", "label"])
    assert (cloud.xyz.tolist(), cloud.label.tolist(), cloud.fields) == ([[1, 2, 3]], [7], ("xyz", "label"))
    with pytest.raises(FileFormatError, match=r"line 1: expected 3 numbers \(x, y, z\), got 5"):
        PointCloud.load(path, columns=list("xyz"))
    path.write_text("x y z\n1 2 3\n")
    with pytest.raises(FileFormatError, match="columns: expected none, since a line names them: x, y, z"):
        PointCloud.load(path, columns=list("xyz"))
    for columns, error in (
        ("xyz", TypeError),
        ([1, 2, 3], TypeError),
        (["x", "y"], ValueError),
        (list("xyzx"), ValueError),
        ([*"xyz", ""], ValueError),
    ):
        with pytest.raises(error, match=r"^columns: expected"):
            PointCloud.load(path, columns=columns)
    cloud.save(tmp_path / "a.pcd")
    with pytest.raises(
        ValueError, match=r"^columns: expected none, since \.pcd files name their columns, got some for .*a\.pcd"
    ):
        PointCloud.load(tmp_path / "a.pcd", columns=list("xyz"))


@pytest.mark.parametrize("suffix", [".csv", ".xyz", ".txt"])
def test_integers_that_float64_rounds_are_kept(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    for value in (2**53 - 1, 2**53, 2**53 + 1, -(2**53) - 1, 2**53 + 3, 2**63 - 1):
        PointCloud(xyz=np.zeros((2, 3)), identity=np.array([value, 1])).save(path)
        assert PointCloud.load(path).identity.tolist() == [value, 1]
