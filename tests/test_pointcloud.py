"""Point clouds: fields, and the guarantees of saving and loading for all formats."""

import copy
import os
import pickle
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim import io
from lidarsim.errors import FileFormatError
from lidarsim.scan.fields import CANONICAL
from lidarsim.scan.formats import check_output
from lidarsim.scan.pointcloud import PointCloud, field_names

assert io, "the formats register themselves on import"

XYZ = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
HALF = np.zeros(2, np.float16)
MASKED = np.ma.array([1, 2], mask=[0, 1])
NAMES = "PointCloud: expected ASCII identifiers, not its attributes, as names of fields, got "
UNMASKED = "expected a number for each point, got a masked array; fill it"
ANY = "label: expected integers from 0 to 4294967295, got label = "


@pytest.fixture
def cloud() -> PointCloud:
    return PointCloud(xyz=XYZ, intensity=[0.25, 0.5], ring=[3, 7], flow=np.ones((2, 2), np.float32))


def test_only_the_given_fields_are_present_in_the_fixed_order(cloud: PointCloud) -> None:
    assert cloud.fields == ("xyz", "intensity", "ring", "flow")
    assert PointCloud(zeta=[0], alpha=[0], label=[0], range=[0], xyz=[[0, 0, 0]]).fields == (
        "xyz", "range", "label", "alpha", "zeta",
    )  # fmt: skip
    assert len(cloud) == 2


def test_mapping_and_keywords_are_one() -> None:
    assert PointCloud({"xyz": XYZ, "ring": [0, 1]}, label=[1, 2]).fields == ("xyz", "ring", "label")


def test_every_canonical_field_gets_its_dtype_and_shape() -> None:
    cloud = PointCloud({name: np.ones((2, *shape), np.int64) for name, (shape, _) in CANONICAL.items()})
    assert cloud.fields == tuple(CANONICAL)
    for name, (shape, dtype) in CANONICAL.items():
        array = getattr(cloud, name)
        assert array.dtype == dtype
        assert array.shape == (2, *shape)
        assert array.flags.c_contiguous


def test_a_cloud_of_a_cloud_has_all_that_it_has() -> None:
    given = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0)).scan(ls.Scene(), TURN).point_cloud()
    given.class_names, given.flow = {7: "ball"}, np.ones((len(given), 2))
    made = PointCloud(given)
    assert made.fields == given.fields
    assert all(getattr(made, name).ctypes.data == getattr(given, name).ctypes.data for name in given.fields)
    assert (made.class_names, made._in_sensor_frame) == ({7: "ball"}, True)
    more = PointCloud(given, class_names={7: "sphere"}, cluster=np.zeros(len(given)))
    assert more.class_names == {7: "sphere"}
    assert {*more.fields} - {*given.fields} == {"cluster"}
    assert given.class_names == {7: "ball"}


def test_arrays_of_the_right_dtype_are_kept() -> None:
    ring = np.array([1, 2], np.uint16)
    cloud = PointCloud(xyz=XYZ, ring=ring)
    assert np.shares_memory(cloud.xyz, XYZ)
    assert np.shares_memory(cloud.ring, ring)


@pytest.mark.parametrize("dtype", ["?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8", ">f8", ">i2"])
def test_other_fields_keep_their_dtype_in_native_order(dtype: str) -> None:
    cloud = PointCloud(xyz=XYZ, extra=np.array([0, 1], dtype))
    assert cloud.extra.dtype == np.dtype(dtype).newbyteorder("=")
    assert cloud.extra.tolist() == [0, 1]


def test_absent_field_names_those_present(cloud: PointCloud) -> None:
    with pytest.raises(AttributeError) as error:
        cloud.label  # noqa: B018
    assert str(error.value) == "this point cloud has no 'label'; its fields are xyz, intensity, ring, flow"
    assert not hasattr(cloud, "label")


def test_fields_can_be_set_and_removed(cloud: PointCloud) -> None:
    cloud.cluster = np.array([0, 1])
    cloud.intensity *= 2
    del cloud.ring
    assert cloud.fields == ("xyz", "intensity", "cluster", "flow")
    assert cloud.intensity.tolist() == [0.5, 1.0]
    with pytest.raises(AttributeError, match=r"^a point cloud cannot be without 'xyz'$"):
        del cloud.xyz


@pytest.mark.parametrize("index", [slice(1, 2), np.array([False, True]), np.array([1])])
def test_selection_keeps_all_fields(cloud: PointCloud, index: object) -> None:
    part = cloud[index]
    assert part.fields == cloud.fields
    assert part.xyz.tolist() == [[4, 5, 6]]
    assert part.ring.tolist() == [7]
    assert part.ring.dtype == np.uint16


@pytest.mark.parametrize("index", [1, -1, np.int8(1), np.array(1), [1], np.array([1], np.uint8)])
def test_one_index_selects_one_point(cloud: PointCloud, index: object) -> None:
    assert cloud[index].xyz.tolist() == [[4, 5, 6]]


def test_no_index_selects_no_point(cloud: PointCloud) -> None:
    for index in ([], (np.empty(0, int)), [False, False], slice(0)):
        assert len(cloud[index]) == 0
        assert cloud[index].fields == cloud.fields


@pytest.mark.parametrize(
    ("index", "error", "message"),
    [
        (None, TypeError, "None"),
        (True, TypeError, "True"),
        (np.True_, TypeError, "np.True_"),
        (1.5, TypeError, "1.5"),
        ([0.0, 1.0], TypeError, "float64 of shape (2,)"),
        ([[0], [1]], TypeError, "int64 of shape (2, 1)"),
        (np.ones((2, 3), bool), TypeError, "bool of shape (2, 3)"),
        ([[0], [0, 1]], ValueError, "a ragged sequence"),
    ],
)
def test_what_is_no_index_is_refused(cloud: PointCloud, index: object, error: type[Exception], message: str) -> None:
    expected = f"index: expected a slice, an integer, or integers or a mask of shape (m,), got {message}"
    with pytest.raises(error, match=f"^{re.escape(expected)}$"):
        cloud[index]


def test_copies_and_pickles(cloud: PointCloud) -> None:
    for other in (copy.copy(cloud), copy.deepcopy(cloud), pickle.loads(pickle.dumps(cloud))):  # noqa: S301
        assert other.fields == cloud.fields
        np.testing.assert_array_equal(other.xyz, cloud.xyz)


SHEAR = np.array([[1.5, 0.25, 0.0, 3.0], [0.0, 0.5, -0.75, -1e5], [0.3, 0.0, 2.0, 0.1], [0.0, 0.0, 0.0, 1.0]])
TURN = RigidTransform.from_components([5e6, 4e5, 300.0], Rotation.from_euler("ZYX", [0.4, -1.1, 2.0]))
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def on_a_sphere(points: int = 50) -> PointCloud:
    normal = np.random.default_rng(4).normal(size=(points, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    names = {2: "ball"}
    return PointCloud(xyz=3.0 * normal + 1.0, normal=normal, label=np.full(points, 2), class_names=names)


@pytest.mark.parametrize("transform", [TURN, MIRROR, SHEAR, SHEAR @ MIRROR], ids=["turn", "mirror", "shear", "both"])
def test_transformed_points_and_normals(transform: RigidTransform | np.ndarray) -> None:
    cloud = on_a_sphere()
    moved = cloud.transformed(transform)
    matrix = transform.as_matrix() if isinstance(transform, RigidTransform) else transform
    for before, after, normal in zip(cloud.xyz, moved.xyz, moved.normal.astype(float), strict=True):
        for row, got in zip(matrix[:3], after, strict=True):
            terms = [Fraction(m) * Fraction(p) for m, p in zip(row, [*before, 1.0], strict=True)]
            # Three products and three sums are each rounded by 2⁻⁵³ of at most the sum of the terms' magnitudes.
            assert abs(Fraction(got) - sum(terms)) <= 6 * Fraction(2) ** -53 * sum(map(abs, terms))
        # A unit vector in float32 has components that are off by half an ulp of 1 at most, 2⁻²⁵.
        assert abs(np.linalg.norm(normal) - 1.0) <= np.sqrt(3.0) * 2.0**-25
    # Tangents stay tangents, and outside stays outside: that alone tells the normal, also of a mirror image.
    outward = cloud.normal.astype(float)
    for axis in np.eye(3):
        tangents = np.cross(outward, axis) @ matrix[:3, :3].T
        # Rounded components of the normal by 2⁻²⁵ each; the rest is of the order of 2⁻⁵³.
        allowed = (2.0**-25 + 2.0**-48) * np.abs(tangents).sum(axis=1)
        assert (np.abs((tangents * moved.normal).sum(axis=1)) <= allowed).all()
    assert ((outward @ matrix[:3, :3].T * moved.normal).sum(axis=1) > 0).all()


def test_transformed_keeps_the_rest_and_shares_it() -> None:
    cloud = on_a_sphere()
    moved = cloud.transformed(SHEAR)
    assert (moved.fields, moved.class_names) == (cloud.fields, cloud.class_names)
    assert np.shares_memory(moved.label, cloud.label)
    assert not np.shares_memory(moved.xyz, cloud.xyz)
    assert (moved.xyz.dtype, moved.normal.dtype) == (np.float64, np.float32)
    still = cloud.transformed(np.eye(4))
    for name in cloud.fields:
        np.testing.assert_array_equal(getattr(still, name), getattr(cloud, name))


def test_transformed_normals_without_a_direction_stay_so() -> None:
    cloud = PointCloud(xyz=XYZ, normal=[[0, 0, 0], [0, 0, 1]])
    assert cloud.transformed(MIRROR).normal.tolist() == [[0, 0, 0], [0, 0, 1]]
    missing = PointCloud(xyz=XYZ, normal=[[np.nan] * 3, [0, 0, 1]]).transformed(SHEAR)
    assert np.isnan(missing.normal).all(axis=1).tolist() == [True, False]


@pytest.mark.parametrize(
    ("transform", "message"),
    [
        (np.eye(3), "transform: expected shape (4, 4), got (3, 3); a rotation is transform[:3, :3]"),
        (np.diag([1.0, 0.0, 1.0, 1.0]), "transform: expected an invertible matrix, got determinant 0"),
        (np.full((4, 4), np.nan), "transform: expected finite numbers, got transform[0][0] = nan"),
        (np.ones((4, 4)), "transform: expected a last row of (0, 0, 0, 1), got (1.0, 1.0, 1.0, 1.0)"),
    ],
)
def test_bad_transforms(transform: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        on_a_sphere().transformed(transform)
    assert str(caught.value) == message


def test_concatenated_clouds_keep_order_fields_and_names() -> None:
    first = PointCloud(xyz=XYZ, ring=[3, 7], class_names={1: "car"})
    second = PointCloud(xyz=XYZ[:1] + 9, ring=[9], class_names={1: "car", 2: "road"})
    whole = PointCloud.concatenate(iter([first, second]))
    assert whole.ring.tolist() == [3, 7, 9]
    np.testing.assert_array_equal(whole.xyz, np.concatenate([XYZ, XYZ[:1] + 9]))
    assert (whole.fields, whole.ring.dtype, whole.class_names) == (first.fields, np.uint16, {1: "car", 2: "road"})
    with pytest.raises(ValueError, match="expected one name for each label, got 'car' and 'bus' for 1"):
        PointCloud.concatenate([first, PointCloud(xyz=XYZ, ring=[1, 2], class_names={1: "bus"})])
    flows = [PointCloud(xyz=XYZ, flow=np.ones((2, columns))) for columns in (2, 3)]
    with pytest.raises(
        ValueError, match=r"expected entries of 'flow' of one shape in all, got \(2,\) and, in clouds\[1\]"
    ):
        PointCloud.concatenate(flows)


def test_a_sum_is_the_concatenation(cloud: PointCloud) -> None:
    both = cloud + cloud[:1]
    assert both.fields == cloud.fields
    for name in cloud.fields:
        np.testing.assert_array_equal(getattr(both, name), np.concatenate([getattr(cloud, name)] * 2)[:3])
    with pytest.raises(ValueError, match="the same fields in all, got clouds"):
        _ = cloud + PointCloud(XYZ)
    with pytest.raises(TypeError, match="unsupported operand"):
        _ = cloud + 1.0  # type: ignore[operator]


def test_to_pandas_has_a_column_per_component_and_the_classes() -> None:
    pandas = pytest.importorskip("pandas")
    cloud = PointCloud(
        xyz=XYZ, normal=[[0, 0, 1], [1, 0, 0]], label=[7, 9], ring=[3, 4], flow=np.ones((2, 2), np.float32),
        class_names={7: "car", 3: "car", 8: "tree"},
    )  # fmt: skip
    frame = cloud.to_pandas()
    columns = {"x": XYZ[:, 0], "y": XYZ[:, 1], "z": XYZ[:, 2], "ring": cloud.ring, "label": cloud.label,
               "nx": cloud.normal[:, 0], "ny": cloud.normal[:, 1], "nz": cloud.normal[:, 2],
               "flow.0": [1, 1], "flow.1": [1, 1]}  # fmt: skip
    assert list(frame.columns) == list(columns)
    for name, column in columns.items():
        np.testing.assert_array_equal(frame[name], column)
    kinds = [frame.dtypes[name] for name in ("x", "ring", "label", "nx", "flow.0")]
    assert kinds == ["float64", "uint16", "uint32", "float32", "float32"]
    frame.loc[0, "x"] = 99.0
    assert cloud.xyz[0, 0] == XYZ[0, 0]  # a copy
    named = cloud.to_pandas(class_names=True)["class"]
    assert list(named.cat.categories) == ["car", "tree"]
    assert named[0] == "car"
    assert pandas.isna(named[1])  # no class has 9
    assert "class" not in PointCloud(XYZ).to_pandas(class_names=True)
    with pytest.raises(TypeError, match="class_names: expected True or False"):
        cloud.to_pandas(class_names={7: "car"})  # type: ignore[arg-type]


def test_copies_share_nothing_and_records_hold_every_field(cloud: PointCloud) -> None:
    cloud.class_names = {7: "wall"}
    other, records = cloud.copy(), cloud.to_structured()
    assert (other.fields, other.class_names) == (cloud.fields, cloud.class_names)
    assert records.dtype.names == cloud.fields
    for name in cloud.fields:
        assert not np.shares_memory(getattr(other, name), getattr(cloud, name))
        assert records[name].dtype == getattr(cloud, name).dtype
        np.testing.assert_array_equal(records[name], getattr(cloud, name))
        np.testing.assert_array_equal(getattr(other, name), getattr(cloud, name))


def test_repr_of_odd_clouds() -> None:
    assert repr(PointCloud(xyz=np.empty((0, 3)))) == "PointCloud: 0 points\n  xyz  float64 × 3"
    assert repr(PointCloud(xyz=[[np.nan, 0, 0]], on=[True])) == (
        "PointCloud: 1 point\n  xyz  float64 × 3\n  on   bool         1 … 1"
    )
    assert repr(PointCloud(xyz=[[np.nan, 0, 0], [1, 2, 3], [4, 0, np.inf]])) == (
        "PointCloud: 3 points\n  xyz  float64 × 3  (1, 2, 3) … (1, 2, 3)"
    )


@pytest.mark.parametrize(
    ("fields", "error", "message"),
    [
        ({}, TypeError, "PointCloud: expected a field 'xyz', got no fields"),
        ({"ring": [1], "label": [2]}, TypeError, "PointCloud: expected a field 'xyz', got ring, label"),
        ({"xyz": [1, 2, 3]}, ValueError, "xyz: expected shape (n, 3), got (3,)"),
        ({"xyz": [[1, 2]]}, ValueError, "xyz: expected shape (n, 3), got (1, 2)"),
        ({"xyz": [[1, 2, 3], [4]]}, ValueError, "xyz: expected numbers of shape (n, 3), got a ragged sequence"),
        ({"xyz": [["a", "b", "c"]]}, TypeError, "xyz: expected real numbers, got dtype <U1"),
        ({"xyz": [[1, 2, 3j]]}, TypeError, "xyz: expected real numbers, got dtype complex128"),
        ({"xyz": XYZ, "ring": [1]}, ValueError, "ring: expected one entry for each of the 2 points, got 1"),
        ({"xyz": XYZ, "ring": [[1], [2]]}, ValueError, "ring: expected shape (n,), got (2, 1)"),
        ({"xyz": XYZ, "normal": [1, 2]}, ValueError, "normal: expected shape (n, 3), got (2,)"),
        ({"xyz": XYZ, "ring": [0, 65536]}, ValueError, "ring: expected integers from 0 to 65535, got ring[1] = 65536"),
        ({"xyz": XYZ, "ring": [-1, 0]}, ValueError, "ring: expected integers from 0 to 65535, got ring[0] = -1"),
        ({"xyz": XYZ, "ring": [0, 2.5]}, ValueError, "ring: expected integers from 0 to 65535, got ring[1] = 2.5"),
        ({"xyz": XYZ, "ring": [np.nan, 0]}, ValueError, "ring: expected integers from 0 to 65535, got ring[0] = nan"),
        ({"xyz": XYZ, "label": -1}, ValueError, f"{ANY}-1"),
        ({"xyz": XYZ, "label": 1.5}, ValueError, f"{ANY}1.5"),
        ({"xyz": XYZ, "label": 2**40}, ValueError, f"{ANY}{2**40}"),
        ({"xyz": XYZ, "label": 10**400}, TypeError, "label: expected real numbers, got dtype object"),
        ({"xyz": XYZ, "label": np.nan}, ValueError, f"{ANY}nan"),
        ({"xyz": XYZ, "label": 1j}, TypeError, "label: expected real numbers, got dtype complex128"),
        ({"xyz": XYZ, "label": 7}, ValueError, "label: expected one entry for each of the 2 points, got 1"),
        ({"xyz": XYZ[:0], "label": -1}, ValueError, f"{ANY}-1"),
        ({"xyz": XYZ[:0], "ring": [1]}, ValueError, "ring: expected one entry for each of the 0 points, got 1"),
        ({"xyz": XYZ, "time": MASKED}, ValueError, f"time: {UNMASKED}"),
        ({"xyz": XYZ, "ring": [True, False]}, TypeError, "ring: expected real numbers, got dtype bool"),
        ({"xyz": XYZ, "tag": ["a", "b"]}, TypeError, "tag: expected bool, integers, float32 or float64, got dtype <U1"),
        ({"xyz": XYZ, "q": HALF}, TypeError, "q: expected bool, integers, float32 or float64, got dtype float16"),
        ({"xyz": XYZ, "tag": 1}, ValueError, "tag: expected shape (n,) or (n, m), got ()"),
        ({"xyz": XYZ, "tag": np.zeros((2, 0))}, ValueError, "tag: expected shape (n,) or (n, m), got (2, 0)"),
        ({"xyz": XYZ, "save": [0, 1]}, ValueError, f"{NAMES}'save'"),
        ({"xyz": XYZ, "x": [0, 1]}, ValueError, f"{NAMES}'x'"),
        ({"xyz": XYZ, "a b": [0, 1]}, ValueError, f"{NAMES}'a b'"),
    ],
)  # fmt: skip
def test_bad_fields(fields: dict[str, object], error: type[Exception], message: str) -> None:
    with pytest.raises(error) as caught:
        PointCloud(fields)
    assert str(caught.value) == message


def test_whole_floats_are_integers_and_integers_of_any_width() -> None:
    cloud = PointCloud(xyz=XYZ, ring=np.array([0.0, 65535.0]), label=np.array([0, 2**32 - 1], np.uint64))
    assert cloud.ring.tolist() == [0, 65535]
    assert cloud.label.tolist() == [0, 2**32 - 1]


def test_a_float32_does_not_become_infinite() -> None:
    for name, values, where in (("intensity", [1, 1e39], "[1]"), ("normal", [[0, 0, 1], [0, 1e39, 0]], "[1][1]")):
        with pytest.raises(ValueError, match="expected numbers that float32 can hold") as caught:
            PointCloud({"xyz": XYZ, name: values})
        assert str(caught.value) == f"{name}: expected numbers that float32 can hold, got {name}{where} = 1e+39"


def test_paths_that_no_file_can_have(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for use in (PointCloud.load, PointCloud(XYZ).save):
        with pytest.raises(ValueError, match=r"^path: expected a path without null characters, got 'a\\x00\.npz'$"):
            use("a\0.npz")
        with pytest.raises(TypeError, match=r"^path: expected a path, got 5$"):
            use(5)  # type: ignore[arg-type]
        with (
            os.scandir(os.fsencode(tmp_path)) as entries,
            pytest.raises(TypeError, match=r"^path: expected a path, got"),
        ):
            use(next(entries))  # type: ignore[arg-type]


@pytest.mark.parametrize("suffix", [".npz", ".pcd", ".ply"])
def test_coordinates_beyond_float32_are_not_written_as_infinite(suffix: str, tmp_path: Path) -> None:
    cloud = PointCloud(xyz=[[1, 2, 3], [4, np.inf, -1e39]])
    with pytest.raises(
        ValueError, match=r"^xyz: expected numbers that float32 can hold, got xyz\[1\]\[2\] = -1e\+39; float32=F"
    ):
        cloud.save(tmp_path / f"a{suffix}", float32=True)
    assert not list(tmp_path.iterdir())
    cloud.save(tmp_path / f"a{suffix}", float32=False)
    np.testing.assert_array_equal(PointCloud.load(tmp_path / f"a{suffix}").xyz, cloud.xyz)


def test_names_of_columns_become_names_of_fields_each_another() -> None:
    names = [
        "a b",
        "a_b",
        "a-b",
        "a_b_2",
        "",
        "2d",
        "_",
        "x",
        "save",
        "class",
        "Größe",
        "__dict__",
        "ring",
        "ring",
        "a b",
    ]
    assert field_names(names) == [
        "a_b_3", "a_b", "a_b_4", "a_b_2", "unnamed", "_2d", "__", "x_", "save_", "class", "Gr__e", "__dict___", "ring",
        "ring_2", "a_b_5",
    ]  # fmt: skip
    many = field_names(["a b"] * 20_000)  # with the square of their number it would take a minute
    assert (len(set(many)), many[-1]) == (20_000, "a_b_20000")


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".npz", ".PCD"])
class TestSaving:
    def test_file_appears_complete_and_alone(self, cloud: PointCloud, tmp_path: Path, suffix: str) -> None:
        cloud.save(tmp_path / f"a{suffix}")
        assert [path.name for path in tmp_path.iterdir()] == [f"a{suffix}"]
        np.testing.assert_array_equal(PointCloud.load(str(tmp_path / f"a{suffix}")).xyz, XYZ)

    def test_float32_rounds_the_positions_alone(self, tmp_path: Path, suffix: str) -> None:
        cloud = PointCloud(xyz=[[0.1, 1e9 + 1, 3]], time=[0.1])
        cloud.save(tmp_path / f"a{suffix}", float32=True)
        loaded = PointCloud.load(tmp_path / f"a{suffix}")
        assert loaded.xyz.tolist() == [[float(np.float32(0.1)), 1e9, 3.0]]
        assert loaded.time.tolist() == [0.1]
        assert cloud.xyz[0, 0] == 0.1

    def test_full_disk_leaves_the_old_file(self, cloud: PointCloud, tmp_path: Path, suffix: str) -> None:
        resource = pytest.importorskip("resource", reason="Windows has no limit on the size of a file")
        path = tmp_path / f"a{suffix}"
        cloud.save(path)
        before = path.read_bytes()
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        big = PointCloud(xyz=np.ones((10_000, 3)))
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
        try:
            with pytest.raises(OSError, match=r"cannot be written") as caught:
                big.save(path)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert str(caught.value) == f"{path}: cannot be written: File too large"
        assert path.read_bytes() == before
        assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("scan.qqq", "unknown extension '.qqq', expected .bin, .csv, "),
        ("scan", "no extension, expected .bin, .csv, "),
        (".pcd", "no extension, expected .bin, .csv, "),
    ],
)
def test_unknown_extension(cloud: PointCloud, tmp_path: Path, name: str, message: str) -> None:
    path = tmp_path / name
    for use in (cloud.save, check_output):
        with pytest.raises(FileFormatError) as caught:
            use(path)
        assert str(caught.value).startswith(f"{path}: {message}")
    assert not list(tmp_path.iterdir())
    path.write_text("anything")
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(caught.value).startswith(f"{path}: {message}")


@pytest.mark.parametrize("suffix", [".npz", ".pcd", ".ply", ".las", ".laz"])
@pytest.mark.parametrize("name", ["scan", "scan.dat", "scan.ply", "scan.csv"])
def test_content_tells_the_format_whatever_the_name(cloud: PointCloud, tmp_path: Path, name: str, suffix: str) -> None:
    cloud.save(tmp_path / f"saved{suffix}")
    (tmp_path / f"saved{suffix}").rename(tmp_path / name)
    assert PointCloud.load(tmp_path / name).ring.tolist() == [3, 7]


def test_the_longest_suffix_tells_the_format(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "SCAN.PCD.BIN")
    assert (tmp_path / "SCAN.PCD.BIN").stat().st_size == 2 * 20
    cloud.save(tmp_path / "scan.bin")
    assert (tmp_path / "scan.bin").stat().st_size == 2 * 16


@pytest.mark.parametrize("suffix", [".npz", ".pcd", ".ply", ".las", ".laz", ".csv", ".xyz"])
def test_chosen_fields(cloud: PointCloud, tmp_path: Path, suffix: str) -> None:
    cloud.save(tmp_path / f"a{suffix}", fields=["ring"])
    loaded = PointCloud.load(tmp_path / f"a{suffix}")
    assert loaded.ring.tolist() == [3, 7]
    assert not hasattr(loaded, "flow")
    np.testing.assert_array_equal(loaded.xyz, XYZ)
    cloud.save(tmp_path / f"a{suffix}", fields=["flow", "xyz"])
    assert not hasattr(PointCloud.load(tmp_path / f"a{suffix}"), "ring")


def test_chosen_fields_must_be_there(cloud: PointCloud, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="fields: expected") as caught:
        cloud.save(tmp_path / "a.pcd", fields=["label"])
    known = "xyz, intensity, ring, flow"
    assert str(caught.value) == f"fields: expected fields of this point cloud ({known}), got 'label'"
    with pytest.raises(TypeError, match=r"^fields: expected a sequence of names, got 'ring'$"):
        cloud.save(tmp_path / "a.pcd", fields="ring")
    assert not list(tmp_path.iterdir())


def test_output_folder_that_does_not_exist(cloud: PointCloud, tmp_path: Path) -> None:
    path = tmp_path / "none" / "scan.pcd"
    for use in (cloud.save, check_output):
        with pytest.raises(FileNotFoundError) as caught:
            use(path)
        assert str(caught.value) == f"{path}: the folder {tmp_path / 'none'} does not exist"


def test_output_below_a_file(cloud: PointCloud, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    path = tmp_path / "file" / "scan.pcd"
    for use in (cloud.save, check_output):
        with pytest.raises(NotADirectoryError) as caught:
            use(path)
        assert str(caught.value) == f"{path}: {tmp_path / 'file'} is not a folder"


def test_output_that_is_a_folder(cloud: PointCloud, tmp_path: Path) -> None:
    (tmp_path / "scan.pcd").mkdir()
    for use in (cloud.save, check_output):
        with pytest.raises(IsADirectoryError) as caught:
            use(tmp_path / "scan.pcd")
        assert str(caught.value) == f"{tmp_path / 'scan.pcd'}: expected a file to write, got a folder"


def test_output_folder_without_permission(cloud: PointCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)  # permissions do not stop an administrator
    for use in (cloud.save, check_output):
        with pytest.raises(PermissionError) as caught:
            use(tmp_path / "scan.pcd")
        assert str(caught.value) == f"{tmp_path / 'scan.pcd'}: no permission to write in the folder {tmp_path}"


def test_good_output_is_checked_without_a_trace(tmp_path: Path) -> None:
    check_output(tmp_path / "scan.pcd")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", ["pcd", "ply", "npz"])
class TestLoading:
    def test_missing_file(self, tmp_path: Path, suffix: str) -> None:
        path = tmp_path / f"none.{suffix}"
        with pytest.raises(FileNotFoundError) as caught:
            PointCloud.load(path)
        assert str(caught.value) == f"{path}: no such file"

    def test_folder(self, tmp_path: Path, suffix: str) -> None:
        path = tmp_path / f"folder.{suffix}"
        path.mkdir()
        with pytest.raises(IsADirectoryError) as caught:
            PointCloud.load(path)
        assert str(caught.value) == f"{path}: expected a file, got a folder"

    def test_unreadable_file(self, tmp_path: Path, suffix: str) -> None:
        (tmp_path / "file").touch()
        path = tmp_path / "file" / f"scan.{suffix}"
        with pytest.raises(OSError, match="cannot be read") as caught:
            PointCloud.load(path)
        assert str(caught.value) == f"{path}: cannot be read: Not a directory"


def test_numpy_takes_a_cloud_as_its_points() -> None:
    cloud = PointCloud(xyz=np.arange(6.0).reshape(2, 3), ring=[0, 1])
    assert np.shares_memory(np.asarray(cloud), cloud.xyz)
    assert np.asarray(cloud).shape == (2, 3)
    assert np.array_equal(np.asarray(cloud, dtype=np.float32), cloud.xyz.astype(np.float32))
    copied = np.array(cloud)
    assert np.array_equal(copied, cloud.xyz)
    assert not np.shares_memory(copied, cloud.xyz)
    assert np.allclose(cloud, cloud.xyz)


@pytest.mark.parametrize(
    ("name", "content", "hint"),
    [
        ("a.pcap", bytes.fromhex("d4c3b2a1020004"), "recorded packets are not read; convert them to"),
        ("a.csv", bytes.fromhex("0a0d0d0a"), "recorded packets are not read; convert them to"),
        ("a.bag", b"", "bags of ROS 1 are not read; convert it: rosbags-convert"),
        ("world.sdf", b"<sdf/>", "it is of a scene, not of points: lidarsim.Scene.from_file"),
        ("robot.xacro", b"", "it is of a scene, not of points: lidarsim.Scene.from_file"),
        ("car.LWO", b"FORM", "it is of a scene, not of points: lidarsim.Scene.from_file"),
        ("car.glb", b"glTF", "it is of a scene, not of points: lidarsim.Scene.from_file"),
        ("a.mcap.zstd", b"", "compressed files are not read, but for bags by lidarsim.io.rosbag.read"),
        ("scan.fls", b"", "scans of FARO are not read; convert them to E57 with FARO SCENE"),
        ("a.npy", b"", "an array does not name its columns: PointCloud(numpy.load(path)"),
    ],
)
def test_what_to_do_with_files_that_are_not_read(name: str, content: bytes, hint: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    assert str(caught.value).startswith(f"{path}: {hint}")


def test_arrays_in_place_of_names_are_named(tmp_path: Path) -> None:
    cloud = PointCloud(xyz=np.zeros((2, 3)))
    with pytest.raises(TypeError, match=r"field: expected the name of a field, got "):
        cloud.raster(np.zeros((0, 3)), cell=1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"crs: expected a file that can hold it"):
        cloud.save(tmp_path / "a.pcd", crs=np.zeros((0, 3)))  # type: ignore[arg-type]
    cloud.save(tmp_path / "a.pcd", start=0)
