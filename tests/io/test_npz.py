"""NPZ beside NumPy itself."""

from io import BytesIO
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest

from lidarsim import io
from lidarsim.errors import FileFormatError
from lidarsim.scan.pointcloud import PointCloud

assert io, "the formats register themselves on import"


def test_numpy_reads_what_we_write(tmp_path: Path) -> None:
    cloud = PointCloud(xyz=np.random.default_rng(0).normal(size=(9, 3)), ring=range(9), normal=np.ones((9, 3)))
    cloud.save(tmp_path / "cloud.npz")
    with np.load(tmp_path / "cloud.npz") as archive:
        assert archive.files == ["xyz", "ring", "normal"]
        for name in archive.files:
            assert archive[name].dtype == getattr(cloud, name).dtype
            np.testing.assert_array_equal(archive[name], getattr(cloud, name))


def test_we_read_what_numpy_compressed(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "cloud.npz", xyz=np.ones((2, 3), np.float32), gain=np.array([1, 2], ">i2"))
    cloud = PointCloud.load(tmp_path / "cloud.npz")
    assert cloud.xyz.tolist() == [[1, 1, 1], [1, 1, 1]]
    assert cloud.xyz.dtype == np.float64
    assert cloud.gain.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({"points": np.ones((2, 3))}, "PointCloud: expected a field 'xyz', got points"),
        ({"xyz": np.ones((2, 2))}, "xyz: expected shape (n, 3), got (2, 2)"),
        ({"xyz": np.ones((2, 3)), "ring": [1]}, "ring: expected one entry for each of the 2 points, got 1"),
        ({"xyz": np.array([[print] * 3])}, "Object arrays cannot be loaded when allow_pickle=False"),
    ],
)
def test_not_a_point_cloud(arrays: dict[str, np.ndarray], reason: str, tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    np.savez(path, **arrays)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(caught.value) == f"{path}: not a readable .npz point cloud: {reason}"


def test_arrays_of_any_name_and_value(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    arrays = {"a b": [1, 2], "a-b": [3, 4], "save": [5, 6], "": [7, 8], "label": [-1, 7], "class_names": [9, 9]}
    with ZipFile(path, "w") as file:
        for name, values in {"xyz": np.zeros((2, 3)), **arrays, "ring": [True, False], "range": [[1.0], [2.0]]}.items():
            with file.open(f"{name}.npy", "w") as entry:
                np.save(entry, values)
    cloud = PointCloud.load(path)
    assert {name: getattr(cloud, name).tolist() for name in cloud.fields} == {
        "xyz": [[0, 0, 0]] * 2, "a_b": [1, 2], "a_b_2": [3, 4], "save_": [5, 6], "unnamed": [7, 8], "label": [0, 7],
        "label_raw": [-1, 7], "class_names_": [9, 9], "ring": [1, 0], "ring_raw": [True, False],
        "range_raw": [[1], [2]],
    }  # fmt: skip
    with ZipFile(path, "w") as file:
        for name in ("xyz.npy", "a.npy", "a"):
            with file.open(name, "w") as entry:
                np.save(entry, np.zeros((2, 3)))
    with pytest.raises(FileFormatError, match="it has two arrays named 'a'"):
        PointCloud.load(path)


def test_a_bare_array(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    np.save(tmp_path / "array.npy", np.ones((2, 3)))
    (tmp_path / "array.npy").rename(path)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(caught.value) == f"{path}: not a readable .npz point cloud: it does not begin as a NumPy archive does"


def archive(path: Path, header: dict[str, object], data: bytes = b"", version: tuple[int, int] = (1, 0)) -> None:
    """Write an archive of one array with any header."""
    entry = BytesIO()
    write = np.lib.format.write_array_header_1_0 if version == (1, 0) else np.lib.format.write_array_header_2_0
    write(entry, header)
    with ZipFile(path, "w", ZIP_DEFLATED) as file:
        file.writestr("xyz.npy", entry.getvalue() + data)


def test_an_array_that_claims_more_than_it_has(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    for version in ((1, 0), (2, 0)):
        archive(path, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)}, bytes(24), version)
        with pytest.raises(FileFormatError) as caught:
            PointCloud.load(path)
        assert "xyz: its array claims 24,000,000,000,000 bytes of " in str(caught.value)
    archive(path, {"descr": "<f8", "fortran_order": False, "shape": (2, 3)}, bytes(48), (2, 0))
    assert len(PointCloud.load(path)) == 2


def test_a_bomb(tmp_path: Path) -> None:
    path = tmp_path / "cloud.npz"
    points = 4_000_000
    archive(path, {"descr": "<f8", "fortran_order": False, "shape": (points, 3)}, bytes(points * 24))
    assert path.stat().st_size < points * 24 // 100
    with pytest.raises(FileFormatError, match="more than 100 times as many: refused as a decompression bomb"):
        PointCloud.load(path)
