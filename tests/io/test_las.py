"""LAS and LAZ beside laspy."""

import struct
import subprocess
import sys
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pyproj
import pytest

import lidarsim as ls
from lidarsim import io
from lidarsim.errors import FileFormatError, MissingExtraError
from lidarsim.io import _records, las
from lidarsim.io.las import Writer, read
from lidarsim.scan.pointcloud import PointCloud

assert io, "the formats register themselves on import"

COUNT = 20_000  # more than a block
UTM = np.array([500_000.0, 5_400_000.0, 300.0])
HALF_A_STEP = 0.5e-4 + 2 * np.spacing(5.4e6)  # of 0.1 mm, and the roundings of offset + step · scale and of its inverse


def make(count: int = COUNT) -> PointCloud:
    rng = np.random.default_rng(0)
    return PointCloud(
        xyz=UTM + rng.uniform(-200, 200, (count, 3)),
        range=rng.random(count) * 100,
        intensity=rng.random(count),
        time=rng.random(count),
        ring=rng.integers(0, 65536, count),
        return_number=rng.integers(1, 16, count),
        return_count=rng.integers(1, 16, count),
        object_id=rng.integers(-1, 2**31, count),
        label=rng.integers(0, 256, count),
        normal=rng.normal(size=(count, 3)),
        flow=rng.normal(size=(count, 2)),
        scan_angle=rng.uniform(-3, 3, count),
    )


@pytest.fixture(scope="module")
def cloud() -> PointCloud:
    return make()


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_laspy_reads_every_field(cloud: PointCloud, tmp_path: Path, suffix: str) -> None:
    cloud.save(tmp_path / f"cloud{suffix}")
    las = laspy.read(tmp_path / f"cloud{suffix}")
    assert (str(las.header.version), las.header.point_format.id, las.header.are_points_compressed) == (
        "1.4",
        6,
        suffix == ".laz",
    )
    assert not las.header.global_encoding.wkt
    assert las.header.parse_crs() is None
    np.testing.assert_allclose(las.xyz, cloud.xyz, rtol=0, atol=HALF_A_STEP)
    np.testing.assert_array_equal(las.intensity, np.rint(cloud.intensity * np.float32(10_000)))
    np.testing.assert_array_equal(las.scan_angle, np.rint(np.degrees(cloud.scan_angle) / 0.006))
    same = {
        "gps_time": cloud.time,
        "return_number": cloud.return_number,
        "number_of_returns": cloud.return_count,
        "classification": cloud.label,
    }
    extra = {name: getattr(cloud, name) for name in ("range", "ring", "object_id")}
    extra |= {f"Normal{axis}": column for axis, column in zip("XYZ", cloud.normal.T, strict=True)}
    extra |= {f"flow.{i}": column for i, column in enumerate(cloud.flow.T)}
    assert set(las.point_format.extra_dimension_names) == set(extra)
    for name, column in (same | extra).items():
        assert np.asarray(las[name]).dtype.kind == column.dtype.kind
        np.testing.assert_array_equal(las[name], column)
    for name, column in extra.items():
        assert las[name].dtype == column.dtype
    counts = np.bincount(cloud.return_number, minlength=16)[1:]
    np.testing.assert_array_equal(las.header.number_of_points_by_return, counts)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_every_field_comes_back(cloud: PointCloud, tmp_path: Path, suffix: str) -> None:
    cloud.save(tmp_path / f"cloud{suffix}")
    loaded = PointCloud.load(tmp_path / f"cloud{suffix}")
    assert loaded.fields == cloud.fields
    np.testing.assert_allclose(loaded.xyz, cloud.xyz, rtol=0, atol=HALF_A_STEP)
    # Half a step of 1e-4, and the rounding to float32 of numbers below 1.
    np.testing.assert_allclose(loaded.intensity, cloud.intensity, rtol=0, atol=0.5e-4 + 2**-24)
    np.testing.assert_allclose(loaded.scan_angle, cloud.scan_angle, rtol=0, atol=np.radians(0.003) + 1e-15)
    for name in set(cloud.fields) - {"xyz", "intensity", "scan_angle"}:
        assert getattr(loaded, name).dtype == getattr(cloud, name).dtype
        np.testing.assert_array_equal(getattr(loaded, name), getattr(cloud, name))


def test_fields_that_every_file_has(tmp_path: Path) -> None:
    PointCloud(xyz=np.zeros((2, 3))).save(tmp_path / "cloud.las")
    loaded = PointCloud.load(tmp_path / "cloud.las")
    assert loaded.fields == ("xyz", "intensity", "time", "return_number", "return_count", "label")
    assert not any(getattr(loaded, name).any() for name in loaded.fields)


def test_no_points(tmp_path: Path) -> None:
    for suffix in (".las", ".laz"):
        make(0).save(tmp_path / f"cloud{suffix}")
        assert PointCloud.load(tmp_path / f"cloud{suffix}").fields[:3] == ("xyz", "range", "intensity")
        assert len(laspy.read(tmp_path / f"cloud{suffix}").x) == 0


def test_brighter_than_the_scale_is_the_brightest(tmp_path: Path) -> None:
    with pytest.warns(
        UserWarning, match=r"^intensity: LAS's intensity ends at 6\.5535; what is brighter is written as"
    ):
        PointCloud(xyz=np.zeros((4, 3)), intensity=[0, 1, 6.5535, np.inf]).save(tmp_path / "cloud.las")
    assert laspy.read(tmp_path / "cloud.las").intensity.tolist() == [0, 10_000, 65_535, 65_535]


def test_dimensions_of_las_by_their_own_names(tmp_path: Path) -> None:
    fields = {name: [1, 2] for name in ("user_data", "point_source_id", "red", "green", "blue")}
    PointCloud(xyz=np.zeros((2, 3)), **fields).save(tmp_path / "cloud.las")
    las = laspy.read(tmp_path / "cloud.las")
    assert las.point_format.id == 7
    assert not list(las.point_format.extra_dimension_names)
    loaded = PointCloud.load(tmp_path / "cloud.las")
    for name in fields:
        assert las[name].tolist() == [1, 2]
        assert getattr(loaded, name).tolist() == [1, 2]


def test_we_read_what_laspy_writes(tmp_path: Path) -> None:
    header = laspy.LasHeader(version="1.2", point_format=3)
    header.scales, header.offsets = np.full(3, 0.25), np.array([10.0, 20.0, 30.0])
    las = laspy.LasData(header)
    las.xyz = [[10.25, 20.5, 30.75], [11, 21, 31]]
    las.intensity, las.classification, las.scan_angle_rank = [100, 200], [2, 6], [-15, 30]
    las.gps_time, las.red = [1.5, 2.5], [7, 8]
    las.add_extra_dim(laspy.ExtraBytesParams("vector", "3f4"))
    las["vector"] = [[1, 2, 3], [4, 5, 6]]
    las.write(tmp_path / "cloud.las")
    loaded = PointCloud.load(tmp_path / "cloud.las")
    assert loaded.xyz.tolist() == [[10.25, 20.5, 30.75], [11, 21, 31]]
    assert loaded.intensity.tolist() == [np.float32(0.01), np.float32(0.02)]
    assert loaded.label.tolist() == [2, 6]
    assert loaded.time.tolist() == [1.5, 2.5]
    assert loaded.red.tolist() == [7, 8]
    assert loaded.vector.tolist() == [[1, 2, 3], [4, 5, 6]]
    np.testing.assert_array_equal(loaded.scan_angle, np.radians([-15, 30]))


def write_dimensions(path: Path, dimensions: dict[str, tuple[str, list[float]]], point_format: int = 6) -> None:
    """Write a file of three points to which a program has added dimensions, also by names that laspy cannot write."""
    dimensions = {{"x": "q", "scales": "scalez"}.get(name, name): part for name, part in dimensions.items()}
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind) for name, (kind, _) in dimensions.items()])
    las = laspy.LasData(header)
    las.xyz, las.classification, las.gps_time = np.arange(9.0).reshape(3, 3), [2, 6, 9], [0.5, 0.25, 0]
    las.number_of_returns = [1, 2, 3]
    for name, (_, values) in dimensions.items():
        las.points.array[name] = values
    las.write(path)
    content = path.read_bytes()
    for name, other in ((b"q", b"x"), (b"scalez", b"scales")):
        content = content.replace(name.ljust(32, b"\0"), other.ljust(32, b"\0"))
    path.write_bytes(content)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("point_format", [3, 6])
def test_added_dimensions_lose_nothing_and_replace_nothing(point_format: int, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"cloud{suffix}"
    write_dimensions(
        path,
        {
            "label": ("i4", [-1, 7, 8]),
            "label 2": ("u1", [1, 2, 3]),
            "time": ("f8", [5, 6, 7]),
            "return_count": ("u1", [0, 0, 0]),
            "x": ("f4", [7, 8, 9]),
            "ring": ("f4", [np.nan, 1, 2]),
            "Amplitude [dB]": ("f4", [4, 5, 6]),
            "Amplitude (dB)": ("f4", [6, 5, 4]),
            "user_data_": ("u2", [0, 0, 0]),
        },
        point_format,
    )
    cloud = PointCloud.load(path)
    assert cloud.xyz.tolist() == np.arange(9.0).reshape(3, 3).tolist()
    expected = {
        "label": [2, 6, 9], "time": [0.5, 0.25, 0], "return_count": [1, 2, 3], "label_2": [-1, 7, 8],
        "label_2_2": [1, 2, 3], "time_2": [5, 6, 7], "return_count_2": [0, 0, 0], "x_2": [7, 8, 9],
        "Amplitude__dB_": [4, 5, 6], "Amplitude__dB__2": [6, 5, 4], "user_data_": [0, 0, 0],
        "ring": [0, 1, 2],
    }  # fmt: skip
    assert {name: getattr(cloud, name).tolist() for name in expected} == expected
    np.testing.assert_array_equal(cloud.ring_raw, [np.nan, 1, 2])
    colours = {"red", "green", "blue"} if point_format == 3 else set()
    assert set(cloud.fields) == {*expected, *colours, "xyz", "intensity", "return_number", "ring_raw"}
    write_dimensions(path, {"scales": ("u2", [1, 2, 3])})
    with pytest.raises(FileFormatError, match="it has a dimension named 'scales', which laspy cannot read"):
        PointCloud.load(path)


def test_pieces_have_the_same_fields_wherever_a_value_does_not_fit(tmp_path: Path) -> None:
    path = tmp_path / "cloud.las"
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.add_extra_dims([laspy.ExtraBytesParams("ring", "i4"), laspy.ExtraBytesParams("object_id", "i8")])
    las = laspy.LasData(header)
    las.xyz = np.zeros((COUNT, 3))
    las.ring, las.object_id = np.r_[np.full(COUNT - 1, 7), -1], np.arange(COUNT)
    las.write(path)
    pieces = list(read(path))
    assert len(pieces) == 2
    assert pieces[0].fields == pieces[1].fields
    assert "object_id_raw" not in pieces[0].fields
    whole = PointCloud.concatenate(pieces)
    assert whole.ring_raw.tolist() == las.ring.tolist()
    assert whole.ring.tolist() == [*las.ring[:-1].tolist(), 0]


def test_laz_of_one_stream_as_the_first_laszip_wrote_it(tmp_path: Path) -> None:
    """A chunk of lazrs without its table is what LASzip 1.2 wrote: the points in one stream, by version 1 of each item.

    Its description, of 34 bytes and 6 for each item: the compressor and coder, the version, options, the size of
    chunks, two numbers that are not used, and the number of items.
    """
    path = tmp_path / "cloud.laz"
    header = laspy.LasHeader(version="1.2", point_format=3)
    las = laspy.LasData(header)
    rng = np.random.default_rng(0)
    las.xyz = rng.uniform(-100, 100, (COUNT, 3))
    las.intensity, las.gps_time = rng.integers(0, 65536, COUNT), np.sort(rng.random(COUNT))
    items = [(6, 20, 2), (7, 8, 2), (8, 6, 2)]
    vlr = struct.pack("<HHBBHIIqqH", 2, 0, 2, 2, 0, 0, 50_000, -1, -1, 3) + b"".join(
        struct.pack("<HHH", *i) for i in items
    )
    stream = BytesIO()
    compressor = lazrs.LasZipCompressor(stream, lazrs.LazVlr(vlr))
    compressor.compress_many(las.points.array.tobytes())
    compressor.done()
    data = stream.getvalue()
    chunk = data[8 : int.from_bytes(data[:8], "little")]
    old = struct.pack("<HHBBHIIqqH", 1, 0, 1, 2, 0, 0, 0, -1, -1, 3) + b"".join(struct.pack("<HHH", *i) for i in items)
    las.write(tmp_path / "plain.las")
    content = bytearray((tmp_path / "plain.las").read_bytes())
    start = int.from_bytes(content[96:100], "little")
    record = struct.pack("<H16sHH32s", 0, b"laszip encoded", 22204, len(old), b"") + old
    content[96:104] = struct.pack("<II", start + len(record), 1)
    content[104] |= 0x80  # compressed
    content = content[:start] + record
    path.write_bytes(content + chunk)
    cloud = PointCloud.load(path)
    np.testing.assert_array_equal(cloud.xyz, las.xyz)
    np.testing.assert_array_equal(cloud.time, las.gps_time)
    path.write_bytes(content + chunk[: len(chunk) // 2])
    with pytest.raises(FileFormatError):
        PointCloud.load(path)


def test_a_panic_of_the_decoder_is_an_error() -> None:
    item = struct.pack("<HHBBHIIqqH", 1, 0, 1, 2, 0, 0, 0, -1, -1, 1) + struct.pack("<HHH", 6, 20, 1)
    decompressor = lazrs.LasZipDecompressor(BytesIO(bytes(1000)), item)

    def decompress() -> None:
        with las._panics():
            decompressor.decompress_many(bytearray(200))

    with pytest.raises(BaseException, match="Variable-size chunks") as caught:
        decompressor.decompress_many(bytearray(200))
    assert type(caught.value).__name__ == "PanicException"
    with pytest.raises(FileFormatError, match="its compressed data is damaged: "):
        decompress()


@pytest.mark.skipif(sys.platform == "win32", reason="there, a process has no such descriptors")
def test_laz_without_standard_error(tmp_path: Path) -> None:
    path = tmp_path / "cloud.laz"
    make(10).save(path)
    code = f"import lidarsim as ls; print(len(ls.PointCloud.load({str(path)!r})))"
    command = ["sh", "-c", 'exec "$0" -c "$1" 2>&-', sys.executable, code]
    result = subprocess.run(command, stdout=subprocess.PIPE, check=True)
    assert result.stdout == b"10\n"


def test_copc_is_read_and_not_written(tmp_path: Path) -> None:
    cloud, path = make(10), tmp_path / "cloud.copc.laz"
    for write in (cloud.save, Writer):
        with pytest.raises(FileFormatError, match=r"cloud\.copc\.laz: COPC, which is LAZ sorted into an octree"):
            write(path)
    assert not list(tmp_path.iterdir())
    cloud.save(tmp_path / "cloud.laz")
    (tmp_path / "cloud.laz").rename(path)
    assert len(PointCloud.load(path)) == len(next(read(path))) == 10


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"label": [0, 256]}, "label: expected 0 to 255 for LAS's classification, got label[1] = 256"),
        (
            {"return_count": [16, 0]},
            "return_count: expected 0 to 15 for LAS's number_of_returns, got return_count[0] = 16",
        ),
        ({"intensity": [0, -0.5]}, "intensity: expected numbers >= 0, got intensity[1] = -0.5"),
        ({"intensity": [np.nan, 0]}, "intensity: expected numbers >= 0, got intensity[0] = nan"),
        ({"scan_angle": [0, 180.0]}, "scan_angle: expected angles from -π to π, got scan_angle[1] = 180"),
        ({"user_data": [1, -1]}, "user_data: expected 0 to 255 for LAS's user_data, got user_data[1] = -1"),
        ({"user_data": [0, 1.5]}, "user_data: expected 0 to 255 for LAS's user_data, got user_data[1] = 1.5"),
        ({"X": [0, 0]}, "X: LAS cannot hold a field of this name beside the others; save without it"),
        ({"a" * 33: [0, 0]}, f"{'a' * 33}: LAS cannot hold a field of this name beside the others; save without it"),
        (
            {"time": [0, 0], "gps_time": [0, 0]},
            "time: LAS cannot hold a field of this name beside the others; save without it",
        ),
        ({"on": [True, False]}, "on: this format cannot hold bool; convert it, or save as .npz"),
        (
            {"xyz": [[0, 0, 0], [0, 0, 1e6]]},
            "z: expected coordinates over at most 429 km, 32 bits in steps of 0.1 mm, got 0 to 1e+06 m",
        ),
        (
            {"xyz": [[0, 0, 0], [np.nan, 0, 0]]},
            "x: expected finite coordinates, got x[1] = nan",
        ),
        ({"xyz": [[0, -np.inf, 0], [0, 0, 0]]}, "y: expected finite coordinates, got y[0] = -inf"),
        (
            {"xyz": [[-1e308, 0, 0], [1e308, 0, 0]]},
            "x: expected coordinates over at most 429 km, 32 bits in steps of 0.1 mm, got -1e+308 to 1e+308 m",
        ),
    ],
)  # fmt: skip
def test_what_does_not_fit(fields: dict[str, list[float]], message: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.las"
    path.write_bytes(b"old")
    with pytest.raises(FileFormatError) as caught:
        PointCloud(**({"xyz": np.zeros((2, 3))} | fields)).save(path)
    assert str(caught.value) == message
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_misfit_after_the_first_block_is_told_by_its_place(tmp_path: Path) -> None:
    for name, wrong in {"label": 256, "intensity": -1.0, "xyz": [np.nan, 0, 0]}.items():
        cloud = PointCloud(xyz=np.zeros((COUNT, 3)), label=np.zeros(COUNT), intensity=np.zeros(COUNT))
        getattr(cloud, name)[COUNT - 1] = wrong
        with pytest.raises(FileFormatError, match=rf"\[{COUNT - 1}\] = "):
            cloud.save(tmp_path / "cloud.las")


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_frames_of_a_flight_go_into_one_file(cloud: PointCloud, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"flight{suffix}"
    with Writer(path) as flight:
        for start in range(0, COUNT, 5000):
            flight.write(cloud[start : start + 5000])
            assert not path.exists()
    assert list(tmp_path.iterdir()) == [path]
    np.testing.assert_allclose(laspy.read(path).xyz, cloud.xyz, rtol=0, atol=HALF_A_STEP)
    pieces = list(read(path))
    assert len(pieces) == 2
    assert not {"synthetic", "user_data"} & set(PointCloud.load(path).fields)
    assert {"synthetic", "user_data"} < set(pieces[0].fields)
    np.testing.assert_array_equal(np.concatenate([piece.object_id for piece in pieces]), cloud.object_id)


def test_coordinates_as_wide_as_32_bits_hold(tmp_path: Path) -> None:
    path, reach = tmp_path / "wide.las", 1e-4 * (2**31 - 5_000)
    for middle in (0.0, 5_000_000.0):
        cloud = PointCloud(xyz=[[middle - reach, 0, 0], [middle + reach, 0, 0]])
        cloud.save(path)
        assert np.abs(PointCloud.load(path).xyz - cloud.xyz).max() <= HALF_A_STEP
    far = PointCloud(xyz=np.full((2, 3), 1e308))
    far.save(path)
    assert np.array_equal(PointCloud.load(path).xyz, far.xyz)
    written = path.read_bytes()
    with pytest.raises(FileFormatError, match="x: expected coordinates over at most 429 km"):
        PointCloud(xyz=[[-reach, 0, 0], [reach + 1.0, 0, 0]]).save(path)
    assert path.read_bytes() == written


@pytest.mark.parametrize("far", [400e3, -400e3, 1e300])
def test_a_strip_too_far_from_the_first(far: float, tmp_path: Path) -> None:
    path = tmp_path / "flight.laz"
    with pytest.raises(FileFormatError) as caught, Writer(path) as flight:  # noqa: PT012
        flight.write(PointCloud(xyz=[[-3.0, 0.0, 0.0], [0.0, 7.0, 0.0]]))
        flight.write(PointCloud(xyz=[[0.0, 0.0, 0.0], [0.0, far, 0.0]]))
    expected = "coordinates within 214 km of 4 m, the middle of the first points"
    assert str(caught.value) == f"y: expected {expected}, got y[1] = {far:g}"
    assert not list(tmp_path.iterdir())


def test_an_error_in_the_block_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "flight.laz"
    path.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), Writer(path) as flight:  # noqa: PT012
        flight.write(make(10))
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_frames_have_the_same_fields(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cloud: expected the fields") as caught, Writer(tmp_path / "a.las") as flight:  # noqa: PT012
        flight.write(PointCloud(xyz=[[0, 0, 0]], ring=[1]))
        flight.write(PointCloud(xyz=[[0, 0, 0]]))
    assert str(caught.value) == "cloud: expected the fields x, y, z, ring, got x, y, z"
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="expected to be written in a with block"):
        Writer(tmp_path / "a.las").write(make(1))
    with pytest.raises(FileFormatError, match=r"unknown extension '.pcd', expected .las or .laz"):
        Writer(tmp_path / "a.pcd")


def test_the_same_cloud_gives_the_same_bytes_on_any_day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Later(laspy.header.date):
        @classmethod
        def today(cls) -> "Later":
            return cls(2031, 5, 4)

    make(100).save(tmp_path / "a.laz")
    monkeypatch.setattr(laspy.header, "date", Later)
    make(100).save(tmp_path / "b.laz")
    assert (tmp_path / "a.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()


def patch(content: bytes, *changes: tuple[int, bytes]) -> bytes:
    data = bytearray(content)
    for place, new in changes:
        data[place : place + len(new)] = new
    return bytes(data)


MANY = (10**12).to_bytes(8, "little")
COUNT_AT = 247  # of the 64-bit number of points in a header of version 1.4


@pytest.mark.parametrize(
    ("suffix", "changes", "reason"),
    [
        (".las", [(25, b"\x09")], "it is of the unknown version 1.9"),
        (".las", [(COUNT_AT, MANY)], "it is truncated: 300 of 1000000000000 points"),
        (".laz", [(COUNT_AT, MANY)], None),
        (".las", [(96, b"\xff" * 4)], "it is truncated: its header claims points at byte 4294967295 after 1 records"),
        (".las", [(100, b"\xff" * 4)], None),
    ],
)
def test_damaged_files(suffix: str, changes: list[tuple[int, bytes]], reason: str | None, tmp_path: Path) -> None:
    path = tmp_path / f"cloud{suffix}"
    make(300).save(path)
    path.write_bytes(patch(path.read_bytes(), *changes))
    for load in (PointCloud.load, lambda path: list(read(path))):
        with pytest.raises(FileFormatError) as caught:
            load(path)
        assert str(caught.value).startswith(f"{path}: not a readable ")
        assert reason is None or str(caught.value).endswith(f": {reason}")


def test_a_table_of_chunks_that_claims_too_many(tmp_path: Path) -> None:
    path = tmp_path / "cloud.laz"
    make(300).save(path)
    content = path.read_bytes()
    start = int.from_bytes(content[96:100], "little")
    table = int.from_bytes(content[start : start + 8], "little")
    path.write_bytes(patch(content, (table + 4, b"\xff" * 4)))
    with pytest.raises(FileFormatError, match="its table claims more chunks than the file has bytes for"):
        PointCloud.load(path)
    point = int.from_bytes(content[105:107], "little")
    path.write_bytes(patch(content, (start + 8 + point + 4, b"\xff" * 4)))  # the size of the first layer
    with pytest.raises(FileFormatError, match="it is truncated inside a chunk"):
        PointCloud.load(path)


def test_a_bomb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cloud.laz"
    PointCloud(xyz=np.zeros((200_000, 3))).save(path)
    assert len(PointCloud.load(path)) == 200_000
    assert path.stat().st_size < 200_000 * 30 // 100
    monkeypatch.setattr(_records, "SMALL", 1 << 16)
    with pytest.raises(FileFormatError, match="refused as a decompression bomb"):
        PointCloud.load(path)


@pytest.mark.parametrize(
    ("package", "suffix", "what"), [("laspy", ".las", "LAS files"), ("lazrs", ".laz", "LAZ files")]
)
def test_without_the_extra(
    package: str, suffix: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"cloud{suffix}"
    make(3).save(path)
    before = path.read_bytes()
    monkeypatch.setitem(sys.modules, package, None)
    for use in (PointCloud.load, make(3).save):
        with pytest.raises(MissingExtraError) as caught:
            use(path)
        assert str(caught.value) == f'{what} needs {package}: pip install "lidarsim[formats]"'
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


UTM_ZONE = "EPSG:25832"


@pytest.mark.parametrize("given", [25832, UTM_ZONE, pyproj.CRS(UTM_ZONE), pyproj.CRS(UTM_ZONE).to_wkt()])
def test_coordinate_reference_system(given: int | str | pyproj.CRS, tmp_path: Path) -> None:
    PointCloud(xyz=[UTM]).save(tmp_path / "cloud.laz", crs=given)
    header = laspy.read(tmp_path / "cloud.laz").header
    assert header.global_encoding.wkt
    assert header.parse_crs().to_epsg() == 25832
    wkt = header.vlrs.get("WktCoordinateSystemVlr")[0].string
    assert wkt.startswith('PROJCS["ETRS89 / UTM zone 32N",GEOGCS[')  # version 1, as the standard requires
    assert not header.vlrs.get("GeoKeyDirectoryVlr")


def test_heights_have_a_system_too(tmp_path: Path) -> None:
    PointCloud(xyz=[UTM]).save(tmp_path / "cloud.las", crs="EPSG:25832+7837")
    assert laspy.read(tmp_path / "cloud.las").header.parse_crs().sub_crs_list[1].name == "DHHN2016 height"


def test_geotiff_keys_where_asked_for(tmp_path: Path) -> None:
    with Writer(tmp_path / "cloud.las", crs=UTM_ZONE, geokeys=True) as file:
        file.write(PointCloud(xyz=[UTM]))
    header = laspy.read(tmp_path / "cloud.las").header
    assert header.global_encoding.wkt
    assert [header.parse_crs(prefer_wkt=wkt).to_epsg() for wkt in (True, False)] == [25832, 25832]
    keys = {key.id: key.value_offset for key in header.vlrs.get("GeoKeyDirectoryVlr")[0].geo_keys}
    assert (keys[1024], keys[3072]) == (1, 25832)  # GTModelTypeGeoKey: projected; ProjectedCSTypeGeoKey


@pytest.mark.parametrize(
    ("crs", "geokeys", "message"),
    [
        ("EPSG:1", False, "crs: expected an EPSG code, such as EPSG:25832, or WKT, got 'EPSG:1'"),
        (-1, False, "crs: expected an EPSG code, such as EPSG:25832, or WKT, got -1"),
        ("EPSG:4326", False, "crs: expected a projected system, since coordinates are in m, got WGS 84, whose coord"),
        ("EPSG:2225", False, r"in metres, got NAD83 / California zone 1 \(ftUS\), in US survey foot; convert"),
        ("EPSG:25832+6360", False, "crs: expected a system in metres, got .*, in US survey foot"),
        ("EPSG:25832+7837", True, "crs: expected a horizontal system with an EPSG code, for GeoTIFF keys, got ETRS89"),
        (None, True, "crs: expected a coordinate reference system for the GeoTIFF keys, got None"),
    ],
)
def test_systems_that_do_not_fit(crs: int | str | None, geokeys: bool, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        Writer(tmp_path / "cloud.las", crs=crs, geokeys=geokeys)
    assert not list(tmp_path.iterdir())


def test_a_system_is_for_points_in_the_world_and_for_las(tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), 0.0))
    scan = ls.Lidar.preset("velodyne-vlp16").scan(scene, np.eye(4) + np.outer([0, 0, 1, 0], [0, 0, 0, 3.0]))
    elsewhere = r"^crs: expected points in the world.*, got points in a sensor frame; point_cl"
    with pytest.raises(ValueError, match=elsewhere):
        scan.point_cloud().save(tmp_path / "cloud.las", crs=UTM_ZONE)
    with pytest.raises(ValueError, match=elsewhere), Writer(tmp_path / "cloud.las", crs=UTM_ZONE) as file:
        file.write(scan.point_cloud())
    with pytest.raises(
        ValueError, match=r"^crs: expected a file that can hold it \(\.las and \.laz\), got '.*cloud\.ply'$"
    ):
        scan.point_cloud("world").save(tmp_path / "cloud.ply", crs=UTM_ZONE)
    with pytest.raises(ValueError, match=r"^start: expected a file that can hold it \(\.las and \.laz\), got "):
        scan.point_cloud("world").save(tmp_path / "cloud.ply", start=5.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_coordinates_are_not_rounded_to_float32(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^float32: expected a format with float32 coordinates, got LAS"):
        PointCloud(xyz=[UTM]).save(tmp_path / f"a{suffix}", float32=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("start", "expected"),
    [
        # Week 1930 began on 2017-01-01 00:00:00 GPS time, 18 s before that UTC; the leap second is the 18th.
        ("2017-01-01T00:00:00+00:00", 1930 * 604_800 + 18 - 1_000_000_000),
        ("2016-12-31T23:59:59+00:00", 1930 * 604_800 - 1 + 17 - 1_000_000_000),
        ("1980-01-06T00:00:00+00:00", -1_000_000_000),
        ("1999-08-22T01:00:00.25+02:00", 1024 * 604_800 - 3600 + 13.25 - 1_000_000_000),  # the first roll-over
    ],
)
def test_gps_time(start: str, expected: float, tmp_path: Path) -> None:
    PointCloud(xyz=[UTM, UTM], time=[0.0, 0.5]).save(tmp_path / "a.las", start=datetime.fromisoformat(start))
    las = laspy.read(tmp_path / "a.las")
    assert las.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    assert las.gps_time.tolist() == [expected, expected + 0.5]


def test_seconds_of_ones_own(tmp_path: Path) -> None:
    with Writer(tmp_path / "a.las") as file:
        for k in range(3):
            file.write(PointCloud(xyz=[UTM], time=[0.05]), start=0.1 * k)
        with pytest.raises(
            ValueError, match="start: expected seconds, as for the first cloud of the file, got datetime"
        ):
            file.write(PointCloud(xyz=[UTM], time=[0.05]), start=datetime(2026, 5, 1, tzinfo=UTC))
    las = laspy.read(tmp_path / "a.las")
    assert las.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.WEEK_TIME
    assert las.gps_time.tolist() == [0.05, 0.1 + 0.05, 0.1 * 2 + 0.05]


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (
            "1980-01-05T23:59:59+00:00",
            "start: expected a moment since the GPS epoch, 1980-01-06 UTC, got 1980-01-05T23",
        ),
        ("2026-05-01T10:00:00", r"got 2026-05-01T10:00:00; 2026-05-01T10:00:00\+00:00 is one in UTC"),
    ],
)
def test_moments_that_do_not_fit(start: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        PointCloud(xyz=[UTM]).save(tmp_path / "a.las", start=datetime.fromisoformat(start))
    assert not list(tmp_path.iterdir())


def test_a_flight_may_begin_without_points(tmp_path: Path) -> None:
    """The offset is near the first points, not near the origin, from which those in UTM are too far."""
    empty = PointCloud(xyz=np.empty((0, 3)), intensity=np.empty(0, np.float32))
    with Writer(tmp_path / "a.las") as file:
        for cloud in (empty, empty, PointCloud(xyz=[UTM], intensity=[0.5]), empty):
            file.write(cloud, start=2.0)
    las = laspy.read(tmp_path / "a.las")
    assert np.abs(las.xyz - [UTM]).max() < 1e-4
    assert las.header.offsets.tolist() == np.rint(UTM).tolist()
    assert (las.intensity.tolist(), las.gps_time.tolist()) == ([5000], [2.0])
    with Writer(tmp_path / "b.las") as file:
        file.write(PointCloud(xyz=np.empty((0, 3)), normal=np.empty((0, 3), np.float32)))
    assert "NormalX" in laspy.read(tmp_path / "b.las").point_format.extra_dimension_names


def scan_of_a_flight(pattern: ls.patterns.Pattern, **flight: object) -> ls.Scan:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -100.0))
    down = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    return ls.Lidar(pattern).scan(scene, ls.Trajectory.from_twist(np.eye(4), **flight) @ down)


def test_lines_of_a_polygon() -> None:
    pattern = ls.patterns.PolygonMirror(sweep=1.2, field_of_view=0.7, line_rate=100, pulse_rate=5e3, rate=10)
    fields = las.flight_fields(scan_of_a_flight(pattern, linear=(50, 0, 0)), point_source_id=7)
    angle, ends = fields["scan_angle"], np.flatnonzero(fields["edge_of_flight_line"])
    # Ten lines a frame, from the left to the right: negative angles first.
    assert len(ends) == 10
    assert (angle[np.append(0, ends[:-1] + 1)] < -0.33).all()
    assert (angle[ends] > 0.33).all()
    assert (fields["scan_direction_flag"] == 1).all()
    assert (fields["point_source_id"] == 7).all()
    assert fields["point_source_id"].dtype == np.uint16


@pytest.mark.parametrize(
    "pattern",
    [
        ls.patterns.OscillatingMirror(field_of_view=0.7, scan_rate=25.0, pulse_rate=3e3, rate=10.0, turn=0.2),
        ls.patterns.OscillatingMirror(field_of_view=0.7, scan_rate=23.7, pulse_rate=1e3, rate=7.0),
        ls.patterns.PolygonMirror(sweep=1.57, field_of_view=1.0, line_rate=30, pulse_rate=1e3, rate=7.0),
        ls.patterns.PolygonMirror([0, 0.1], sweep=1.57, field_of_view=1.0, line_rate=33.3, pulse_rate=1e3, rate=7.0),
    ],
)
def test_lines_go_on_from_frame_to_frame(pattern: ls.patterns.Pattern) -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -100.0))
    down = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    flight = ls.Trajectory.from_twist(np.eye(4), linear=(50, 0, 0)) @ down
    found = [(scan, las.flight_fields(scan)) for scan in ls.Lidar(pattern).frames(scene, flight, 30)]
    rings = np.concatenate([scan.pulses.ring for scan, _ in found])
    for ring in np.unique(rings):
        angle, grows, ends = (
            np.concatenate([fields[name] for _, fields in found])[rings == ring]
            for name in ("scan_angle", "scan_direction_flag", "edge_of_flight_line")
        )
        steps = np.diff(angle) > 0
        if isinstance(pattern, ls.patterns.PolygonMirror):  # it only falls back from the end of a line to a start
            assert grows.all()
            assert (ends[:-1] == ~steps).all()
        else:  # it turns where the steps change their sign
            assert (grows[1:] == steps).all()
            assert (ends[1:-1] == (steps[1:] != steps[:-1])).all()


def test_scan_angles_include_the_roll_and_other_patterns_have_no_lines() -> None:
    cone = ls.patterns.Palmer(half_angle=0.3, scan_rate=20.0, pulse_rate=4e3, rate=10.0)
    scan = scan_of_a_flight(cone, linear=(50, 0, 0), angular=(1.5, 0, 0))  # a roll of 0.15 rad within the frame
    fields, xyz = las.flight_fields(scan), scan.point_cloud("world").xyz
    path = np.asarray(scan.poses)[:, :3, 3]
    # The line of flight is x, since the roll leaves it there.
    expected = np.arctan2(-(xyz[:, 1] - path[:, 1]), path[:, 2] - xyz[:, 2])
    # Coordinates of 100 m round a few times, 100 m away.
    assert np.abs(fields["scan_angle"] - expected).max() <= 8 * 2.0**-53
    assert np.abs(expected).max() > 0.4
    assert not fields["scan_direction_flag"].any()
    assert not fields["edge_of_flight_line"].any()


def test_flights_without_fields() -> None:
    grid = ls.patterns.Grid([-0.1, 0.1], [0.0], rate=10.0)
    assert las.flight_fields(scan_of_a_flight(grid, angular=(0, 0, 0.1)))["scan_angle"].tolist() == [0.0, 0.0]
    with pytest.raises(TypeError, match=r"^scan: expected one of a sensor that moves along a trajectory, got one of a"):
        las.flight_fields(ls.Lidar(grid).scan(ls.Scene()))
    with pytest.raises(ValueError, match=r"^point_source_id: expected an integer"):
        las.flight_fields(scan_of_a_flight(grid, linear=(1, 0, 0)), point_source_id=65_536)
