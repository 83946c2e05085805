"""PLY beside Open3D, PyVista, plyfile and trimesh."""

import sys
from pathlib import Path

import numpy as np
import plyfile
import pytest
import pyvista
import trimesh

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
        column=rng.integers(0, 2**31, COUNT),
        normal=rng.normal(size=(COUNT, 3)),
        flow=rng.normal(size=(COUNT, 2)),
        tiny=rng.integers(-128, 128, COUNT, np.int8),
        small=rng.integers(-(2**15), 2**15, COUNT, np.int16),
    )


def test_plyfile_reads_every_field(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "cloud.ply")
    data = plyfile.PlyData.read(tmp_path / "cloud.ply")["vertex"].data
    columns = dict(zip("xyz", cloud.xyz.T, strict=True))
    columns |= {f"n{axis}": column for axis, column in zip("xyz", cloud.normal.T, strict=True)}
    columns |= {f"flow.{i}": column for i, column in enumerate(cloud.flow.T)}
    columns |= {name: getattr(cloud, name) for name in cloud.fields if getattr(cloud, name).ndim == 1}
    assert set(data.dtype.names) == set(columns)
    wider = {"label": np.float64, "column": np.int32, "tiny": np.int32, "small": np.int32}
    for name, column in columns.items():
        assert data[name].dtype == wider.get(name, column.dtype)
        np.testing.assert_array_equal(data[name], column)


def test_open3d_reads_the_same_points(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "cloud.ply")
    read = import_open3d().t.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    np.testing.assert_array_equal(read.point.positions.numpy(), cloud.xyz)
    np.testing.assert_array_equal(read.point.normals.numpy(), cloud.normal)
    for name in ("intensity", "time", "ring", "column", "return_count", "object_id", "label", "tiny", "small"):
        np.testing.assert_array_equal(read.point[name].numpy()[:, 0], getattr(cloud, name))
    assert len(list(read.point.items())) == len(cloud.fields) + 1  # flow is in two columns


@pytest.mark.parametrize("greatest", [2**31 - 1, 2**31, 2**32 - 1])
def test_numbers_of_types_that_open3d_passes_over_come_back_in_them(greatest: int, tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    kind = "int32" if greatest < 2**31 else "float64"
    cloud = PointCloud(
        xyz=np.zeros((2, 3)),
        label=[1, greatest],
        cluster=np.array([0, greatest], np.uint32),
        pair=np.array([[1, -2], [3, -4]], np.int16),
    )
    cloud.save(path)
    header = path.read_bytes().partition(b"end_header")[0].decode().splitlines()
    assert [line for line in header if line.startswith("property")][3:] == [
        f"property {kind} label", f"property {kind} cluster", "property int32 pair.0", "property int32 pair.1",
    ]  # fmt: skip
    read = PointCloud.load(path)
    for name in cloud.fields:
        assert getattr(read, name).dtype == getattr(cloud, name).dtype
        np.testing.assert_array_equal(getattr(read, name), getattr(cloud, name))


def test_pyvista_reads_the_same_points(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "cloud.ply")
    read = pyvista.read(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(read.points, cloud.xyz.astype(np.float32))  # VTK's reader has float32 alone
    np.testing.assert_array_equal(read.point_data["Normals"], cloud.normal)


@pytest.mark.parametrize("ascii_", [False, True])
def test_we_read_what_open3d_writes(ascii_: bool, tmp_path: Path) -> None:
    o3d = import_open3d()
    xyz = np.random.default_rng(0).normal(size=(COUNT, 3)).astype(np.float32)
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(xyz))
    cloud.point.intensity = o3d.core.Tensor(np.arange(COUNT, dtype=np.float32)[:, None])
    cloud.point.normals = o3d.core.Tensor(np.tile(np.float32([0, 0, 1]), (COUNT, 1)))
    cloud.point.colors = o3d.core.Tensor(np.full((COUNT, 3), 255, np.uint8))
    path = tmp_path / "cloud.ply"
    assert o3d.t.io.write_point_cloud(str(path), cloud, write_ascii=ascii_)
    read = PointCloud.load(path)
    # Its text has six significant digits: off by half a unit of the last, then rounded to float32.
    np.testing.assert_allclose(read.xyz, xyz, rtol=5e-6 + 2**-23 if ascii_ else 0, atol=0)
    assert read.intensity.tolist() == list(range(COUNT))
    assert read.normal.tolist() == [[0, 0, 1]] * COUNT
    assert read.blue.tolist() == [255] * COUNT


def test_we_read_the_vertices_of_a_mesh(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    box.export(tmp_path / "box.ply")
    np.testing.assert_array_equal(PointCloud.load(tmp_path / "box.ply").xyz, box.vertices.astype(np.float32))


def test_big_endian(tmp_path: Path) -> None:
    cloud = PointCloud(xyz=np.arange(6.0).reshape(2, 3), ring=[4, 500], flow=np.ones((2, 2)))
    cloud.save(tmp_path / "cloud.ply")
    ply = plyfile.PlyData.read(tmp_path / "cloud.ply")
    ply.byte_order = ">"
    ply.write(tmp_path / "big.ply")
    read = PointCloud.load(tmp_path / "big.ply")
    for name in cloud.fields:
        assert getattr(read, name).dtype == getattr(cloud, name).dtype
        np.testing.assert_array_equal(getattr(read, name), getattr(cloud, name))


def test_lists_are_left_out(tmp_path: Path) -> None:
    vertices = np.zeros(3, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("near", "O")])
    vertices["x"], vertices["ring"] = [1, 2, 3], [4, 5, 6]
    vertices["near"] = [[1], [2, 3], []]
    plyfile.PlyData([plyfile.PlyElement.describe(vertices, "vertex")]).write(tmp_path / "cloud.ply")
    read = PointCloud.load(tmp_path / "cloud.ply")
    assert read.fields == ("xyz", "ring")
    assert read.xyz[:, 0].tolist() == [1, 2, 3]
    assert read.ring.tolist() == [4, 5, 6]


VERTEX = [("x", "float"), ("y", "double"), ("z", "float32"), ("ring", "ushort"), ("k", "int8"), ("n", "uint")]
TYPES = {"float": "f4", "double": "f8", "float32": "f4", "ushort": "u2", "int8": "i1", "uint": "u4"}


def sample(
    encoding: str, *, before: str = "", head: str = "ply", comment: str = "comment", newline: str = "\n"
) -> bytes:
    """A file of two points in an encoding, its header with the odd parts of other programs."""
    order = ">" if "big" in encoding else "<"
    records = np.array(
        [(1, 2, 3, 4, -5, 6), (10, 13, 10, 500, 13, 2**32 - 1)], [(n, order + TYPES[t]) for n, t in VERTEX]
    )
    rows = newline.join(" ".join(map(str, row)) for row in records.tolist()) + newline
    lines = [head, f"format {encoding} 1.0", comment, *([before] if before else []), "element vertex 2"]
    lines += [f"property {kind} {name}" for name, kind in VERTEX] + ["end_header"]
    text = (newline.join(lines) + newline).encode()
    skipped = {"": b"", "element camera 1": b"\x0a\x0d"}.get(before.partition(newline)[0], b"")
    if encoding == "ascii":
        return text + (f"10 13{newline}" if skipped else "").encode() + rows.encode()
    return text + skipped + records.tobytes()


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"], ids=["LF", "CRLF", "CR"])
@pytest.mark.parametrize(
    "odd",
    [
        {},
        {"head": "ply "},
        {"comment": "comment Straße Zürich\tx"},
        {"comment": "obj_info\tnum_cols 1"},
        {"comment": "comment"},
        {"comment": "  comment indented, with end_header\t"},
        {"comment": ""},
        {"before": "element face 0\rproperty list uchar int vertex_indices"},
        {"before": "element camera 1\rproperty uchar a\rproperty uchar b"},
    ],
    ids=str,
)
def test_headers_of_other_programs(encoding: str, newline: str, odd: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    odd = {key: value.replace("\r", newline) for key, value in odd.items()}
    path.write_bytes(sample(encoding, newline=newline, **odd))
    cloud = PointCloud.load(path)
    assert cloud.xyz.tolist() == [[1, 2, 3], [10, 13, 10]]
    assert (cloud.ring.tolist(), cloud.k.tolist(), cloud.n.tolist()) == ([4, 500], [-5, 13], [6, 2**32 - 1])
    assert (cloud.k.dtype, cloud.n.dtype) == (np.int8, np.uint32)
    if all(part.isascii() and part not in {"ply ", ""} for part in odd.values()):
        vertex = plyfile.PlyData.read(path)["vertex"]
        assert vertex["n"].tolist() == [6, 2**32 - 1]


def test_a_comment_that_is_not_ascii_beside_open3d(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_text(
        "ply\nformat ascii 1.0\ncomment Straße\nelement vertex 1\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n",
        encoding="utf-8",
    )
    read = import_open3d().t.io.read_point_cloud(str(path))
    np.testing.assert_array_equal(PointCloud.load(path).xyz, read.point.positions.numpy())


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_names_and_lists_of_other_programs(encoding: str, tmp_path: Path) -> None:
    """Beside lists, for which plyfile reads the file, names stay as they are."""
    path = tmp_path / "cloud.ply"
    names = {"a b": 4.0, "a-b": 5.0, "größe": 6.0, "Intensity": 7.0, "label": -1.0}
    lines = [
        "ply",
        f"format {encoding} 1.0",
        "element vertex 1",
        *(f"property double {name}" for name in [*"xyz", *names]),
    ]
    numbers = np.array([1, 2, 3, *names.values()])
    for lists in ([], ["property list uchar double near by"]):
        head = "\n".join([*lines, *lists, "end_header\n"]).encode()
        if encoding == "ascii":
            rest = " ".join(map(str, numbers)).encode() + b" 2 8 9" * bool(lists)
        else:
            rest = numbers.tobytes() + (b"\x02" + np.array([8.0, 9.0]).tobytes()) * bool(lists)
        path.write_bytes(head + rest)
        cloud = PointCloud.load(path)
        assert {name: getattr(cloud, name).tolist() for name in cloud.fields} == {
            "xyz": [[1, 2, 3]], "label": [0], "label_raw": [-1],
            "a_b": [4], "a_b_2": [5], "gr__e": [6], "Intensity": [7],
        }  # fmt: skip


def test_numbers_of_a_text_that_its_type_cannot_hold(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    kinds = ["float x", "float y", "float z", "uchar alpha", "int label"]
    lines = ["ply", "format ascii 1.0", "element vertex 2", *(f"property {kind}" for kind in kinds), "end_header"]
    path.write_text("\n".join([*lines, "1 2 3 300 -1", "1 2 3 nan 5.0"]))
    cloud = PointCloud.load(path)
    assert (cloud.alpha.tolist(), cloud.alpha.dtype, cloud.label.tolist()) == ([0, 0], np.uint8, [0, 5])
    np.testing.assert_array_equal(cloud.alpha_raw, [300, np.nan])
    assert (cloud.label_raw.tolist(), cloud.label_raw.dtype) == ([-1, 5], np.int32)


def test_the_end_of_a_header_at_the_end_of_a_block(tmp_path: Path) -> None:
    """Headers are read in pieces of 65,536 bytes."""
    path = tmp_path / "cloud.ply"
    whole = sample("binary_little_endian")
    for size in range(65_530, 65_542):
        fill = size - whole.index(b"end_header\n") - len("end_header\n")
        path.write_bytes(sample("binary_little_endian", comment="comment " + "a" * fill))
        assert PointCloud.load(path).ring.tolist() == [4, 500]


HEAD = "ply\nformat ascii 1.0\n"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("PLY\n", "it does not begin with 'ply'"),
        (HEAD + "end_header\n", "it has no element 'vertex' among its elements (none)"),
        (HEAD + "element face 0\nend_header\n", "it has no element 'vertex' among its elements face"),
        (
            HEAD + "element vertex 1\nproperty float x\nend_header\n0\n",
            "it has no y among its fields x",
        ),
        (
            HEAD + "element vertex 2\nproperty float x\nend_header\n0\n",
            "it is truncated: its header claims 2 of the element 'vertex'",
        ),
        (
            "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\nend_header\n",
            "it is truncated: its header claims 1000000000000 of the element 'vertex'",
        ),
        (HEAD + "element vertex two\nend_header\n", "line 3 of its header is not understood: 'element vertex two'"),
        (HEAD + "element vertex 2\n", "its header has no end"),
        ("ply\nelement vertex 0\nend_header\n", "its header has no format"),
        ("ply\nformat text 1.0\nend_header\n", "line 2 of its header is not understood: 'format text 1.0'"),
        ("plywood\nend_header\n", "it does not begin with 'ply' alone, but with b'plywood'"),
        (HEAD + "property float x\nend_header\n", "line 3 of its header is not understood: 'property float x'"),
        (
            HEAD + "element vertex 0\nproperty float x\nproperty int x\nend_header\n",
            "its element 'vertex' has two properties named 'x'",
        ),
        (
            HEAD + "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 a\n",
            "z[0]: expected a number, got something else",
        ),
    ],
)
def test_bad_files(content: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    path.write_text(content)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(caught.value) == f"{path}: not a readable .ply point cloud: {reason}"


def test_without_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cloud.ply"
    monkeypatch.setitem(sys.modules, "plyfile", None)
    PointCloud(xyz=np.zeros((1, 3))).save(path)  # needs none
    assert len(PointCloud.load(path)) == 1
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "property list uchar int near\nend_header\n1 2 3 0\n"
    )
    with pytest.raises(MissingExtraError) as caught:
        PointCloud.load(path)
    assert str(caught.value) == 'reading PLY files that have lists needs plyfile: pip install "lidarsim[formats]"'
