"""What every format promises: bit for bit what was saved, and an error for any part of a file."""

import math
import tracemalloc
from pathlib import Path
from typing import Any

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lidarsim import io
from lidarsim.errors import FileFormatError
from lidarsim.scan.fields import CANONICAL
from lidarsim.scan.pointcloud import PointCloud

assert io, "the formats register themselves on import"

FORMATS = {
    ".npz": ["?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"],
    ".pcd": ["i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"],
    ".ply": ["i1", "i2", "i4", "u1", "u2", "u4", "f4", "f8"],
}


def assert_same(got: PointCloud, want: PointCloud) -> None:
    assert got.fields == want.fields
    for name in want.fields:
        a, b = getattr(got, name), getattr(want, name)
        assert (a.dtype, a.shape) == (b.dtype, b.shape), name
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b))  # a NaN is a NaN, whatever its payload
        assert a[~np.isnan(a)].tobytes() == b[~np.isnan(b)].tobytes(), name


@st.composite
def clouds(draw: st.DrawFn, dtypes: list[str]) -> PointCloud:
    n = draw(st.integers(0, 8))
    fields: dict[str, Any] = {"xyz": draw(hnp.arrays(np.float64, (n, 3)))}
    for name in draw(st.sets(st.sampled_from(sorted(CANONICAL)[:-1]))):
        shape, dtype = CANONICAL[name]
        fields[name] = draw(hnp.arrays(dtype, (n, *shape)))
    for name in draw(st.sets(st.sampled_from(["a", "b_0", "b_1", "rgb", "class", "file", "allow_pickle"]))):
        shape = draw(st.sampled_from([(), (1,), (2,), (3,), (12,)]))
        fields[name] = draw(hnp.arrays(draw(st.sampled_from(dtypes)), (n, *shape)))
    return PointCloud(fields)


@pytest.mark.parametrize("suffix", FORMATS)
@given(data=st.data())
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_every_bit_comes_back(suffix: str, data: st.DataObject, tmp_path: Path) -> None:
    cloud = data.draw(clouds(FORMATS[suffix]))
    path = tmp_path / f"cloud{suffix}"
    cloud.save(path, float32=False)
    assert_same(PointCloud.load(path), cloud)


NASTY = [
    *("nx", "ny", "nz", "normal_x", "normal_y", "normal_z", "NormalX", "NormalY", "NormalZ", "X", "Y", "Z", "Normal"),
    *("Intensity", "LABEL", "label_raw", "ring_raw", "a_b", "a_b_2", "f", "f_0", "class", "None", "x_", "_x", "__"),
    *(
        "class_names_",
        "save_",
        "rgb",
        "red",
        "gps_time_",
        "scales",
        "offsets",
        "bit_fields",
        "array",
        "unnamed",
        "A",
        "a",
    ),
    *("return_num", "scan_angle_rank", "point_format", "e5", "nan", "inf", "end_header", "vertex", "property", "DATA"),
    *("a" * 32, "a" * 33, "a" * 70_000),
]
LAS = {"synthetic", "key_point", "withheld", "overlap", "classification", "user_data", "scan_angle", "gps_time", "nir"}
"""Names of LAS's own dimensions, which it keeps in types of its own."""

TEXT = ["i1", "i4", "i8", "u1", "u4", "u8", "f4", "f8"]


@pytest.mark.slow("fields of any name and number come back")
@pytest.mark.parametrize("suffix", [*FORMATS, ".las", ".laz", ".csv", ".xyz"])
@given(data=st.data())
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_fields_of_any_name_come_back_or_are_refused_before_anything_is_written(
    suffix: str, data: st.DataObject, tmp_path: Path
) -> None:
    identifiers = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,9}", fullmatch=True)
    names = data.draw(st.sets(st.sampled_from(NASTY) | identifiers, min_size=1, max_size=5)) - LAS - set(CANONICAL)
    names = {name for name in names if name not in {"_", "x", "y", "z"} and not hasattr(PointCloud, name)}
    n = data.draw(st.integers(0, 4))
    fields: dict[str, Any] = {"xyz": np.arange(3.0 * n).reshape(n, 3)}
    if data.draw(st.booleans()):
        fields["normal"] = data.draw(hnp.arrays(np.float32, (n, 3)))
    for name in names:
        dtype = data.draw(st.sampled_from(FORMATS.get(suffix, TEXT)))
        fields[name] = data.draw(hnp.arrays(dtype, data.draw(st.sampled_from([(n,), (n, 2)]))))
    cloud, path = PointCloud(fields), tmp_path / f"cloud{suffix}"
    path.unlink(missing_ok=True)
    try:
        cloud.save(path)
    except FileFormatError as error:
        assert any(str(error).startswith(name[:100]) for name in names)  # noqa: PT017
        assert not path.exists()
        return
    loaded = PointCloud.load(path)
    if suffix in FORMATS:
        assert_same(loaded, cloud)
    for name, values in fields.items():
        back = getattr(loaded, name)
        np.testing.assert_array_equal(back, values)
        assert back.dtype == values.dtype or suffix in {".csv", ".xyz"}


def test_names_that_must_be_refused(tmp_path: Path) -> None:
    """The test above holds whatever is refused; these are, and nothing else of the kind."""
    in_las = {"X", "Y", "Z", "bit_fields", "scales", "offsets", "a" * 33, "a" * 70_000}
    refused = {
        ".npz": {"a" * 70_000},
        ".pcd": {"normal_x", "normal_y", "normal_z"},
        ".ply": {"nx", "ny", "nz"},
        ".csv": {"nx", "ny", "nz"},
        ".xyz": {"nx", "ny", "nz"},
        ".las": {"NormalX", "NormalY", "NormalZ"} | in_las,
    }
    for suffix, names in refused.items():
        for name in NASTY:
            cloud, path = (
                PointCloud({"xyz": np.ones((1, 3)), "normal": [[0, 0, 1]], name: [7.0]}),
                tmp_path / f"a{suffix}",
            )
            if name in names:
                with pytest.raises(FileFormatError, match=rf"^{name[:100]}"):
                    cloud.save(path)
                assert not path.exists()
            else:
                cloud.save(path)
                assert PointCloud.load(path).normal.tolist() == [[0, 0, 1]]
                path.unlink()


WORDS = st.text(st.characters(codec="utf-8", exclude_characters='",;#\t', exclude_categories=["C", "Z"]), min_size=1)
ODD = st.sampled_from(
    ["a b", "a-b", "a_b", "a_b_2", "save", "xyz", "normal", "class_names", "f", "f.0", "f.1", "fields"]
)


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".csv"])
@given(data=st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_columns_of_any_name_and_number_are_all_there(suffix: str, data: st.DataObject, tmp_path: Path) -> None:
    canonical = st.sampled_from([name for name, (shape, _) in CANONICAL.items() if not shape])
    names = data.draw(st.sets(WORDS | ODD | canonical, max_size=8)) - set("xyz_XYZ")
    names = {name.replace(" ", "-") for name in names} if suffix == ".pcd" else names
    names = {name for name in names if not name.startswith("//")}
    row = data.draw(
        st.lists(st.sampled_from([-1.0, math.nan, 0.5, 1e30, 70_000.0, 3.0]), min_size=(k := len(names)), max_size=k)
    )
    columns, values = ["x", "y", "z", *names], [1.0, 2.0, 3.0, *row]
    numbers = " ".join(map(repr, values))
    head = {
        ".pcd": f"VERSION .7\nFIELDS {' '.join(columns)}\nSIZE{' 8' * (k + 3)}\nTYPE{' F' * (k + 3)}\n"
        "WIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n",
        ".ply": "ply\nformat ascii 1.0\nelement vertex 1\n"
        + "".join(f"property double {name}\n" for name in columns)
        + "end_header\n",
        ".csv": ",".join(columns) + "\n",
    }[suffix]
    path = tmp_path / f"cloud{suffix}"
    path.write_text(head + (numbers.replace(" ", ",") if suffix == ".csv" else numbers) + "\n", encoding="utf-8")
    cloud = PointCloud.load(path)
    assert cloud.xyz.tolist() == [[1, 2, 3]]
    held = [float(value) for name in cloud.fields[1:] for value in np.ravel(getattr(cloud, name))]
    for value in {repr(value) for value in row}:
        near = {repr(float(value)), repr(float(np.float32(value)))}
        assert sum(repr(number) in near for number in held) >= sum(repr(number) == value for number in row)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("points", [0, 1, 1000])
def test_all_fields_of_lidarsim(suffix: str, points: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    fields = {
        name: rng.integers(0, 200, (points, *shape)).astype(dtype)
        if issubclass(dtype, np.integer)
        else rng.normal(scale=1e6, size=(points, *shape)).astype(dtype)
        for name, (shape, dtype) in CANONICAL.items()
    }
    cloud = PointCloud(fields)
    path = tmp_path / f"cloud{suffix}"
    cloud.save(path, float32=False)
    assert_same(PointCloud.load(path), cloud)


NAMES = {0: "road", 7: "Fußgänger", 8: '"quoted" \\ # name', 9: "two\nlines", 10: "", 2**32 - 1: "last"}


@pytest.mark.parametrize("suffix", FORMATS)
def test_names_of_classes(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"cloud{suffix}"
    cloud = PointCloud(xyz=[[1, 2, 3]], label=[7], class_names=NAMES)
    cloud.save(path)
    assert PointCloud.load(path).class_names == NAMES
    assert_same(PointCloud.load(path), cloud)
    PointCloud(xyz=[[1, 2, 3]]).save(path)
    assert PointCloud.load(path).class_names == {}


@pytest.mark.parametrize("suffix", [".bin", ".csv", ".label", ".las", ".mcap", ".pcd.bin", ".xyz"])
def test_formats_without_a_place_for_names_leave_them_out(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"cloud{suffix}"
    cloud = PointCloud(xyz=[[1, 2, 3]], intensity=[0.5], ring=[3], label=[7], class_names=NAMES)
    cloud.save(path)
    if suffix != ".label":  # it has no points
        assert PointCloud.load(path).class_names == {}


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("name", ["a" * 100_000, "a" * (1 << 24), "end\0", "\0", "\ud800", " a\r\n\tb "], ids=range(6))
def test_odd_names_of_classes_come_back_or_are_refused(suffix: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / f"cloud{suffix}"
    cloud = PointCloud(xyz=[[1, 2, 3]], class_names={7: name, 9: "road"})
    refused = name.endswith("\0") if suffix == ".npz" else len(name) > 1 << 23
    if len(name) > 1 << 23 or refused:
        with pytest.raises(FileFormatError, match="this format cannot hold"):
            cloud.save(path)
        assert not path.exists()
    else:
        cloud.save(path)
        assert PointCloud.load(path).class_names == cloud.class_names


@pytest.mark.slow("fields of any name and number come back")
@pytest.mark.parametrize("suffix", FORMATS)
def test_thousands_of_fields(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"cloud{suffix}"
    cloud = PointCloud({"xyz": [[1, 2, 3]]} | {f"a_rather_long_name_of_a_field_{i}": [i / 100] for i in range(3000)})
    cloud.save(path)
    assert_same(PointCloud.load(path), cloud)


@pytest.mark.parametrize("suffix", FORMATS)
def test_same_cloud_same_bytes(suffix: str, tmp_path: Path) -> None:
    cloud = PointCloud(xyz=[[math.pi, 2, 3]], ring=[1])
    cloud.save(tmp_path / f"a{suffix}")
    cloud.save(tmp_path / f"b{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", FORMATS)
def test_no_part_of_a_file_is_taken_for_a_whole(suffix: str, tmp_path: Path) -> None:
    whole, part = tmp_path / f"whole{suffix}", tmp_path / f"part{suffix}"
    PointCloud(xyz=np.ones((5, 3)), ring=range(5)).save(whole)
    content = whole.read_bytes()
    for size in range(len(content)):
        part.write_bytes(content[:size])
        with pytest.raises(FileFormatError) as caught:
            PointCloud.load(part)
        message = str(caught.value)
        assert message.startswith(f"{part}: not a readable {suffix} point cloud: ")
        assert "\n" not in message


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("content", [b"", b"\n", b"\x00" * 100, b"\xff\xfe" * 50, b"PK\x03\x04", b"hello world, " * 9])
def test_foreign_content_is_one_clear_line(suffix: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"foreign{suffix}"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    message = str(caught.value)
    taken_for = ".npz" if content.startswith(b"PK") else suffix
    assert message.startswith(f"{path}: not a readable {taken_for} point cloud: ")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("suffix", "dtype"), [(".pcd", "bool"), (".ply", "bool"), (".ply", "int64"), (".ply", "uint64")]
)
def test_a_dtype_that_a_format_cannot_hold(suffix: str, dtype: str, tmp_path: Path) -> None:
    cloud = PointCloud(xyz=np.ones((2, 3)), extra=np.zeros(2, dtype))
    with pytest.raises(FileFormatError) as caught:
        cloud.save(tmp_path / f"cloud{suffix}")
    assert str(caught.value) == f"extra: this format cannot hold {dtype}; convert it, or save as .npz"
    assert not list(tmp_path.iterdir())


@pytest.mark.slow("memory of each format is bounded")
@pytest.mark.parametrize(
    "suffix", [*FORMATS, ".las", ".laz", ".csv", ".xyz", ".pts", ".ptx", ".bin", ".pcd.bin", ".label", ".mcap", ".db3"]
)
def test_memory(suffix: str, tmp_path: Path) -> None:
    """Writing takes at most twice the memory of the cloud besides it, reading at most twice that of what it gives."""
    points = (
        40_960 if suffix in {".csv", ".xyz", ".pts", ".ptx"} else 65_536
    )  # text takes its time while memory is traced
    rng = np.random.default_rng(1)
    cloud = PointCloud(
        {
            name: rng.integers(0, 15, (points, *shape)).astype(dtype)
            if issubclass(dtype, np.integer)
            else rng.random((points, *shape)).astype(dtype)
            for name, (shape, dtype) in CANONICAL.items()
        }
    )
    path = tmp_path / f"cloud{suffix}"
    cloud[:2].save(path)  # imports what it needs
    if suffix != ".label":
        PointCloud.load(path)
    peaks = []
    tracemalloc.start()
    try:
        cloud.save(path)
        peaks.append(tracemalloc.get_traced_memory()[1])
        if suffix != ".label":
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            loaded = PointCloud.load(path)
            peaks.append(tracemalloc.get_traced_memory()[1] - before)
    finally:
        tracemalloc.stop()
    assert peaks[0] < 2 * size(cloud)
    if suffix != ".label":
        assert peaks[1] < 2 * size(loaded)


def size(cloud: PointCloud) -> int:
    return sum(getattr(cloud, name).nbytes for name in cloud.fields)


@pytest.mark.parametrize(
    "suffix", [".las", ".laz", ".e57", ".csv", ".xyz", ".pts", ".ptx", ".bin", ".pcd.bin", ".label", ".mcap", ".db3"]
)
def test_a_full_disk_leaves_the_old_file(suffix: str, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource", reason="Windows has no limit on the size of a file")
    path = tmp_path / f"cloud{suffix}"
    points = np.random.default_rng(0).normal(size=(50_000, 3))
    PointCloud(xyz=np.ones((2, 3)), label=[1, 2]).save(path)
    before = path.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, hard))
    try:
        with pytest.raises(OSError, match="cannot be written") as caught:
            PointCloud(xyz=points, label=np.ones(len(points))).save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert str(caught.value).startswith(f"{path}: cannot be written: ")
    assert str(caught.value).count("cannot be written") == 1
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
