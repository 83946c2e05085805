"""PCD beside Open3D and pypcd4, and files as the Point Cloud Library writes them."""

import shutil
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pypcd4
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim import io
from lidarsim.errors import FileFormatError, MissingExtraError
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.viewers.open3d import import_open3d

assert io, "the formats register themselves on import"

COUNT = 500


@pytest.fixture
def cloud() -> PointCloud:
    rng = np.random.default_rng(0)
    return PointCloud(
        xyz=rng.normal(scale=1e6, size=(COUNT, 3)),
        intensity=rng.random(COUNT),
        time=rng.random(COUNT),
        ring=rng.integers(0, 65536, COUNT),
        return_count=rng.integers(0, 256, COUNT),
        object_id=rng.integers(-(2**31), 2**31, COUNT),
        label=rng.integers(0, 2**32, COUNT),
        normal=rng.normal(size=(COUNT, 3)),
        flow=rng.normal(size=(COUNT, 2)),
    )


def test_header(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    PointCloud(xyz=np.zeros((2, 3)), ring=[1, 2], normal=np.zeros((2, 3))).save(path)
    assert path.read_bytes()[: -2 * (12 + 2 + 12)].decode().splitlines() == [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS x y z ring normal_x normal_y normal_z",
        "SIZE 4 4 4 2 4 4 4",
        "TYPE F F F U F F F",
        "COUNT 1 1 1 1 1 1 1",
        "WIDTH 2",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        "POINTS 2",
        "DATA binary",
    ]


@pytest.mark.parametrize(("coordinate", "size"), [(2047.9, 4), (4096.0, 4), (4096.2, 8), (5e5 + 0.5, 4), (1e300, 8)])
def test_float32_if_it_keeps_a_tenth_of_a_millimetre(coordinate: float, size: int, tmp_path: Path) -> None:
    """Up to 2048 m, float32 rounds by at most 2**-14 m; 4096.2 m by 2.0e-4 m; 500,000.5 m is a float32."""
    path = tmp_path / "cloud.pcd"
    cloud = PointCloud(xyz=[[coordinate, -1, np.nan], [0.1, 0.2, -coordinate]])
    with pytest.warns(UserWarning, match="written as float64") if size == 8 else nullcontext():
        cloud.save(path)
    assert f"SIZE {size} {size} {size}\n".encode() in path.read_bytes()
    np.testing.assert_allclose(PointCloud.load(path).xyz, cloud.xyz, rtol=0, atol=2**-14 if size == 4 else 0)
    cloud.save(path, float32=False)
    np.testing.assert_array_equal(PointCloud.load(path).xyz, cloud.xyz)


@pytest.mark.skipif(shutil.which("pcl_voxel_grid") is None, reason="Debian's pcl-tools are not installed")
def test_the_tools_of_the_point_cloud_library_read_a_scan(tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.8))
    cloud = ls.Lidar.preset("velodyne-vlp16").scan(scene).point_cloud()
    cloud.save(tmp_path / "scan.pcd")
    command = ["pcl_voxel_grid", "scan.pcd", "thin.pcd", "-leaf", "0.5,0.5,0.5"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    thin = PointCloud.load(tmp_path / "thin.pcd")
    # The centroids of cells of half a metre; PCL counts cells from the origin in float32.
    occupied = len(np.unique(np.floor(cloud.xyz.astype(np.float32) / np.float32(0.5)), axis=0))
    assert len(thin) == occupied > 1000


def test_the_viewpoint_is_the_pose(tmp_path: Path) -> None:
    path, rotation = tmp_path / "cloud.pcd", Rotation.from_euler("zyx", [2.5, 0.2, -0.1])
    pose = RigidTransform.from_components([4.5e5, -2.25, 0.1], rotation)
    cloud = PointCloud(xyz=np.ones((2, 3)))
    for given in (pose, pose.as_matrix()):
        cloud.save(path, pose=given)
        x, y, z, qw, qx, qy, qz = pypcd4.PointCloud.from_path(path).metadata.viewpoint
        assert [x, y, z] == [4.5e5, -2.25, 0.1]
        # Between the quaternion, its matrix and back are a few roundings of numbers below 1.
        assert np.abs(np.subtract([qx, qy, qz, qw], rotation.as_quat(canonical=True))).max() <= 8 * 2.0**-53
        assert PointCloud.load(path).xyz.tolist() == [[1, 1, 1]] * 2  # unapplied
    for suffix in ("ply", "npz"):
        cloud.save(tmp_path / f"cloud.{suffix}", pose=pose)
        assert PointCloud.load(tmp_path / f"cloud.{suffix}").fields == ("xyz",)
    with pytest.raises(ValueError, match=r"^pose: expected a rigid transform"):
        cloud.save(path, pose=np.diag([1, 1, 2, 1]))


def test_pypcd4_reads_every_field(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "cloud.pcd", float32=False)
    data = pypcd4.PointCloud.from_path(tmp_path / "cloud.pcd").pc_data
    columns = dict(zip("xyz", cloud.xyz.T, strict=True))
    columns |= {f"normal_{axis}": column for axis, column in zip("xyz", cloud.normal.T.astype(np.float64), strict=True)}
    columns |= {f"flow.{i}": column for i, column in enumerate(cloud.flow.T)}
    columns |= {name: getattr(cloud, name) for name in cloud.fields if getattr(cloud, name).ndim == 1}
    assert set(data.dtype.names) == set(columns)
    for name, column in columns.items():
        assert data[name].dtype == column.dtype
        np.testing.assert_array_equal(data[name], column)


@pytest.mark.parametrize("float32", [False, True])
def test_open3d_reads_the_same_points(float32: bool, cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "cloud.pcd", float32=float32)
    read = import_open3d().t.io.read_point_cloud(str(tmp_path / "cloud.pcd"))
    xyz = cloud.xyz.astype(np.float32 if float32 else np.float64)
    assert read.point.positions.numpy().dtype == xyz.dtype
    np.testing.assert_array_equal(read.point.positions.numpy(), xyz)
    np.testing.assert_array_equal(read.point.normals.numpy(), cloud.normal)
    for name in ("intensity", "time", "ring", "return_count", "object_id", "label"):
        got = read.point[name].numpy()[:, 0]
        assert got.dtype == getattr(cloud, name).dtype
        np.testing.assert_array_equal(got, getattr(cloud, name))


@pytest.mark.parametrize("options", [{}, {"write_ascii": True}, {"compressed": True}], ids=str)
def test_we_read_what_open3d_writes(options: dict[str, bool], tmp_path: Path) -> None:
    o3d = import_open3d()
    xyz = np.random.default_rng(0).normal(size=(COUNT, 3)).astype(np.float32)
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(xyz))
    cloud.point.intensity = o3d.core.Tensor(np.arange(COUNT, dtype=np.float32)[:, None])
    cloud.point.colors = o3d.core.Tensor(np.full((COUNT, 3), 255, np.uint8))
    path = tmp_path / "cloud.pcd"
    assert o3d.t.io.write_point_cloud(str(path), cloud, **options)
    read = PointCloud.load(path)
    np.testing.assert_array_equal(read.xyz, xyz)
    assert read.intensity.tolist() == list(range(COUNT))
    assert set(read.fields) == {"xyz", "intensity", "rgb"}


@pytest.mark.parametrize("encoding", list(pypcd4.Encoding)[:3])
def test_we_read_what_pypcd4_writes(encoding: pypcd4.Encoding, tmp_path: Path) -> None:
    points = np.arange(50, dtype=np.float32).reshape(10, 5)
    pypcd4.PointCloud.from_xyzir_points(points).save(tmp_path / "cloud.pcd", encoding)
    read = PointCloud.load(tmp_path / "cloud.pcd")
    assert read.fields == ("xyz", "intensity", "ring")
    np.testing.assert_array_equal(read.xyz, points[:, :3])
    np.testing.assert_array_equal(read.ring, points[:, 4])


def header(fields: str, size: str, kind: str, count: str | None, *, width: int, data: str, height: int = 1) -> str:
    counts = f"COUNT {count}\n" if count else ""
    return (
        f"# .PCD v.7\n\nVERSION .7\nFIELDS {fields}\nSIZE {size}\nTYPE {kind}\n{counts}WIDTH {width}\nHEIGHT {height}\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {width * height}\nDATA {data}\n"
    )


def test_padding_and_counts_as_pcl_writes_them(tmp_path: Path) -> None:
    dtype = np.dtype(
        [("x", "f4"), ("y", "f4"), ("z", "f4"), ("pad", "u1", 4), ("h", "f4", 3), ("rgb", "f4"), ("p2", "u1", 8)]
    )
    records = np.zeros(2, dtype)
    records["x"], records["h"], records["pad"] = [1, 2], [[1, 2, 3], [4, 5, 6]], 9
    path = tmp_path / "cloud.pcd"
    text = header("x y z _ h rgb _", "4 4 4 1 4 4 1", "F F F U F F U", "1 1 1 4 3 1 8", width=2, data="binary")
    path.write_bytes(text.encode() + records.tobytes())
    read = PointCloud.load(path)
    assert read.fields == ("xyz", "h", "rgb")
    assert read.xyz.tolist() == [[1, 0, 0], [2, 0, 0]]
    assert read.h.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_compressed_counts(tmp_path: Path) -> None:
    import lzf

    xyz, h = np.ones((3, 20), np.float32), np.tile(np.arange(3, dtype=np.float32), 20)
    data = xyz.tobytes() + h.tobytes()
    block = lzf.compress(data)
    sizes = np.array([len(block), len(data)], "<u4").tobytes()
    path = tmp_path / "cloud.pcd"
    text = header("x y z h", "4 4 4 4", "F F F F", "1 1 1 3", width=20, data="binary_compressed").encode()
    path.write_bytes(text + sizes + block)
    assert PointCloud.load(path).h.tolist() == [[0, 1, 2]] * 20
    for damaged, reason in (
        (sizes + block[:-1], "it is truncated inside its compressed data"),
        (sizes[:5], "it is truncated inside its compressed data"),
        (sizes + b"\xff" * len(block), "error in compressed data"),
        (np.array([len(block), 4], "<u4").tobytes() + block, "its compressed data holds 4 bytes, expected 480"),
    ):
        path.write_bytes(text + damaged)
        with pytest.raises(FileFormatError) as caught:
            PointCloud.load(path)
        assert str(caught.value) == f"{path}: not a readable .pcd point cloud: {reason}"


def test_a_bomb(tmp_path: Path) -> None:
    import lzf

    path = tmp_path / "cloud.pcd"
    points = 8_000_000
    block = lzf.compress(bytes(points * 12))
    text = header("x y z", "4 4 4", "F F F", "1 1 1", width=points, data="binary_compressed").encode()
    path.write_bytes(text + np.array([100, points * 12], "<u4").tobytes() + block[:100])
    with pytest.raises(FileFormatError, match="its 100 bytes claim to hold 96,000,000, more than 100 times as many"):
        PointCloud.load(path)
    assert len(block) * 100 > points * 12, "what LZF can do is allowed"


def test_old_organised_ascii_without_count(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_text(
        header("x y z", "4 4 4", "F F F", None, width=2, data="ascii", height=2)
        + "1 2 3 \nnan nan nan\n\n4  5\t6\n7 8 9\n"
    )
    np.testing.assert_array_equal(PointCloud.load(path).xyz, [[1, 2, 3], [np.nan] * 3, [4, 5, 6], [7, 8, 9]])


def test_one_ascii_point(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_text(header("x y z i", "8 8 8 1", "F F F U", "1 1 1 1", width=1, data="ascii") + "1 2 3 255\n")
    cloud = PointCloud.load(path)
    assert cloud.xyz.tolist() == [[1, 2, 3]]
    assert cloud.i.tolist() == [255]


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_no_points(data: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_text(header("x y z ring", "4 4 4 2", "F F F U", "1 1 1 1", width=0, data=data))
    assert PointCloud.load(path).ring.tolist() == []


def test_names_that_are_no_identifiers(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    text = header("x y z gps-time 2nd v.5", "4 4 4 8 4 4", "F F F F F F", "1 1 1 1 1 1", width=1, data="ascii")
    path.write_text(text + "0 0 0 7 8 9\n")
    cloud = PointCloud.load(path)
    assert cloud.fields == ("xyz", "_2nd", "gps_time", "v_5")
    assert cloud.gps_time.tolist() == [7]
    assert cloud.v_5.tolist() == [9]


def read_by_open3d(path: Path, *names: str) -> dict[str, list[float]]:
    points = import_open3d().t.io.read_point_cloud(str(path)).point
    return {name: points[name].numpy().ravel().tolist() for name in names}


OLD = "# .PCD v.7\nVERSION .7\nFIELDS x y z ring\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 1\n"
TWO = f"{OLD}WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n1 2 3 4\n4 5 6 5\n"


@pytest.mark.parametrize(
    "text",
    [
        TWO.replace("FIELDS", "COLUMNS"),
        TWO.replace("HEIGHT 1\n", ""),
        TWO.replace("WIDTH 2\n", "").replace("HEIGHT 1\n", ""),
        TWO.replace("POINTS 2\n", ""),
        TWO.replace("VERSION .7\n", "").replace("COUNT 1 1 1 1\n", "").replace("VIEWPOINT 0 0 0 1 0 0 0\n", ""),
        TWO.replace("WIDTH 2\nHEIGHT 1", "WIDTH 1\nHEIGHT 2"),
        TWO.replace("# .PCD v.7\n", "# Größe\n\n \n"),
        TWO.replace("DATA ascii", "DATA ASCII"),
        TWO.replace("\n", "\r\n"),
        TWO.replace(" 4\n", "\t4.0 \n").replace(" 5\n", "  5e0"),
        TWO.replace("x y z", "X Y Z").replace("ring", "Ring"),
    ],
)
def test_headers_of_other_versions(text: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_text(text, encoding="utf-8", newline="")
    cloud = PointCloud.load(path)
    assert (cloud.fields, cloud.ring.dtype) == (("xyz", "ring"), np.uint16)
    assert cloud.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert cloud.ring.tolist() == [4, 5]


def test_the_oldest_header(tmp_path: Path) -> None:
    """As ROS wrote it before there were types."""
    path = tmp_path / "cloud.pcd"
    path.write_text("COLUMNS x y z i sid\nPOINTS 2\nDATA ascii\n1 2 3 4 5\n6 7 8 9 0.5\n")
    cloud = PointCloud.load(path)
    assert (cloud.fields, cloud.sid.dtype, cloud.sid.tolist()) == (("xyz", "i", "sid"), np.float32, [5, 0.5])


def test_numbers_of_a_text_that_its_type_cannot_hold(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    fields = header("x y z ring k n", "4 4 4 1 2 8", "F F F U I U", None, width=3, data="ascii")
    path.write_text(f"{fields}1 2 3 5.0 -7 18446744073709551615\n1 2 3 nan 0.5 5.0\n1 2 -1.#IND 300 4 6\n")
    cloud = PointCloud.load(path)
    assert cloud.ring.tolist() == [5, 0, 0]
    assert (cloud.k.tolist(), cloud.k.dtype) == ([-7, 0, 4], np.int16)
    np.testing.assert_array_equal(cloud.ring_raw, [5, np.nan, 300])
    assert cloud.k_raw.tolist() == [-7, 0.5, 4]
    assert (cloud.n.tolist(), cloud.n.dtype) == ([2**64 - 1, 5, 6], np.uint64)
    assert np.isnan(cloud.xyz[2, 2])
    assert set(cloud.fields) == {"xyz", "ring", "ring_raw", "k", "k_raw", "n"}
    path.write_text(TWO.replace(" 5\n", " nan\n").replace(" 4\n", " 5.0\n"))
    assert PointCloud.load(path).ring.tolist() == [5, 0] == read_by_open3d(path, "ring")["ring"]


@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_values_that_a_field_of_lidarsim_cannot_have(data: str, tmp_path: Path) -> None:
    dtype = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("label", "i4"), ("ring", "f4"), ("intensity", "f4", 2)])
    records = np.array([(1, 2, 3, -1, np.nan, [4, 5]), (6, 7, 8, 40, 12, [9, 10])], dtype)
    path = tmp_path / "cloud.pcd"
    text = header("x y z label ring intensity", "4 4 4 4 4 4", "F F F I F F", "1 1 1 1 1 2", width=2, data=data)
    rows = b"1 2 3 -1 nan 4 5\n6 7 8 40 12 9 10\n"
    path.write_bytes(text.encode() + (records.tobytes() if data == "binary" else rows))
    cloud = PointCloud.load(path)
    assert (cloud.label.tolist(), cloud.label_raw.tolist(), cloud.label_raw.dtype) == ([0, 40], [-1, 40], np.int32)
    np.testing.assert_array_equal(cloud.ring_raw, np.float32([np.nan, 12]))
    assert cloud.ring.tolist() == [0, 12]
    assert cloud.intensity_raw.tolist() == [[4, 5], [9, 10]]
    assert not hasattr(cloud, "intensity")
    cloud.save(path)
    again = PointCloud.load(path)
    assert again.fields == cloud.fields
    for name in cloud.fields:
        np.testing.assert_array_equal(getattr(again, name), getattr(cloud, name))


def test_times_in_nanoseconds_keep_their_digits(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    text = header("x y z time", "4 4 4 8", "F F F U", None, width=1, data="binary")
    path.write_bytes(text.encode() + np.float32([1, 2, 3]).tobytes() + np.uint64([1764115200123456789]).tobytes())
    cloud = PointCloud.load(path)
    assert (cloud.time_raw.tolist(), cloud.time.tolist()) == ([1764115200123456789], [1764115200123456789.0])


GOOD = header("x y z", "4 4 4", "F F F", "1 1 1", width=2, data="binary")
ASCII = GOOD.replace("binary", "ascii")


def many(text: str, points: int) -> str:
    return text.replace("WIDTH 2", f"WIDTH {points}").replace("POINTS 2", f"POINTS {points}")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("PCD\nformat ascii 1.0\n", "expected the header of a PCD file, got something else"),
        ("", "expected the header of a PCD file, got something else"),
        ("FIELDS x y z\n", "expected the header of a PCD file, got something else"),
        ("DATA ascii\n", "its header has no FIELDS"),
        (GOOD.replace("SIZE 4 4 4", "SIZE 4 4"), "its header has 3 FIELDS, but 2 SIZE"),
        (GOOD.replace("TYPE F", "TYPE Q"), "its field x has the unknown layout TYPE Q, SIZE 4, COUNT 1"),
        (GOOD.replace("SIZE 4", "SIZE 3"), "its field x has the unknown layout TYPE F, SIZE 3, COUNT 1"),
        (GOOD.replace("COUNT 1", "COUNT -1"), "its field x has the unknown layout TYPE F, SIZE 4, COUNT -1"),
        (GOOD.replace("WIDTH 2", "WIDTH -2"), "its WIDTH is -2, expected a count"),
        (GOOD.replace("x y z", "x y q") + "0" * 24, "it has no z among its fields x, y, q"),
        (GOOD.replace("binary", "zipped"), "its DATA is 'zipped', expected ascii, binary or binary_compressed"),
        (GOOD.replace("COUNT 1 1 1", "COUNT 0 0 0"), "its points have no bytes"),
        (many(ASCII, 10**30) + "1 2 3\n", f"it is truncated: 1 of {10**30} points"),
        (GOOD + "0" * 23, "it is truncated: 1 of 2 points"),
        (many(GOOD, 9999999999999) + "0" * 24, "it is truncated: 2 of 9999999999999 points"),
        (GOOD.replace("WIDTH 2", "WIDTH 0"), "its WIDTH of 0 times its HEIGHT of 1 is not its POINTS, 2"),
        (GOOD.replace("POINTS 2", "POINTS 3") + "0" * 36, "its WIDTH of 2 times its HEIGHT of 1 is not its POINTS, 3"),
        (GOOD.replace("WIDTH 2\n", "").replace("POINTS 2\n", ""), "its header has no WIDTH"),
        (GOOD.replace("COUNT 1 1 1", "COUNT 1 1 2") + "0" * 32, "its field z has 2 numbers per point, expected 1"),
        (GOOD.replace("x y z", "x y x"), "it has two fields named 'x'"),
        (ASCII.replace("COUNT 1", f"COUNT {10**8}") + "1 2 3\n" * 2, "it is truncated: 0 of 2 points"),
        (ASCII + "1 2 3\n", "it is truncated: 1 of 2 points"),
        (ASCII, "it is truncated: 0 of 2 points"),
        (ASCII + "1 2 3\n1 2\n", "z[1]: expected a number, got the end of the line"),
        (ASCII + "1 2 3\n1 2 3 4\n", "point 1: expected 3 numbers, got more"),
        (ASCII + "1 2 3\n1 2 3,5\n", "z[1]: expected a number with a point, not a comma, got '3,5'"),
        (ASCII + "1 2 3\n1 2 a\n", "z[1]: expected a number, got something else"),
    ],
)
def test_bad_files(content: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_bytes(content.encode())
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(caught.value) == f"{path}: not a readable .pcd point cloud: {reason}"


def test_compressed_without_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cloud.pcd"
    pypcd4.PointCloud.from_xyz_points(np.zeros((50, 3))).save(path, pypcd4.Encoding.BINARY_COMPRESSED)
    monkeypatch.setitem(sys.modules, "lzf", None)
    with pytest.raises(MissingExtraError) as caught:
        PointCloud.load(path)
    assert str(caught.value) == 'reading compressed PCD files needs lzf: pip install "lidarsim[formats]"'


@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_fields_of_no_bytes_as_ousters_software_writes_them(data: str, tmp_path: Path) -> None:
    path = tmp_path / "ouster.pcd"
    head = header("x y z _ intensity _ none", "4 4 4 1 4 1 4", "F F F U F U F", "1 1 1 0 1 0 0", width=2, data=data)
    rows = np.array([[1, 2, 3, 0.5], [4, 5, 6, 0.25]], "<f4")
    text = "".join(f"{' '.join(map(str, row))}\n" for row in rows.tolist()).encode()
    path.write_bytes(head.encode() + (text if data == "ascii" else rows.tobytes()))
    cloud = PointCloud.load(path)
    assert (cloud.fields, cloud.xyz.tolist()) == (("xyz", "intensity"), [[1, 2, 3], [4, 5, 6]])
    assert cloud.intensity.tolist() == [0.5, 0.25]
