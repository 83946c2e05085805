"""Reading data sets for viewing: every layout that lidarsim writes, KITTI's own format, and damaged files."""

from __future__ import annotations

import io
import json
import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim import cli
from lidarsim.datasets.reading import Frame, open_frames
from lidarsim.errors import FileFormatError, LidarsimError

RECIPE = """
sequences: 2
frames: 2
seed: 3
layout: {layout}
class_names: {{'40': road, '10': car}}
run:
  sensor: {{preset: velodyne-vlp16}}
  cloud: {{deskew: start}}
  pose: {{position_m: [5, 1, 2], linear_m_per_s: [3, 0, 0], rotation_deg: {{yaw: 30}}}}
  scene:
    - {{shape: plane, normal: [0, 0, 1], label: 40}}
    - {{shape: box, size_m: [4, 2, 1.5], center_m: [12, 4, 0.75], label: 10}}
"""


def make_set(folder: Path, layout: str) -> Path:
    (folder / "recipe_of_test.yaml").write_text(RECIPE.format(layout=layout), encoding="utf-8")
    ls.generate(folder / "recipe_of_test.yaml", folder / "set", pictures=0)
    return folder / "set"


def frames(path: Path, first: int = 0) -> list[Frame]:
    return list(open_frames(path).read(first))


@pytest.mark.parametrize("layout", ["semantickitti", "nuscenes", "shards", "bags"])
def test_every_layout_is_read_as_it_was_written(layout: str, tmp_path: Path) -> None:
    folder = make_set(tmp_path, layout)
    found = open_frames(folder)
    all_of_them = frames(folder)
    assert len(all_of_them) == 4
    assert found.count == (None if layout == "bags" else 4)
    assert [len(frame.cloud) for frame in frames(folder, 3)] == [len(all_of_them[3].cloud)]
    for frame in all_of_them:
        assert frame.cloud.class_names.items() >= {(40, "road"), (10, "car")}
        assert len(frame.cloud) > 5000
        if layout == "bags":
            continue
        car, road = (frame.cloud.xyz[frame.cloud.label == label] for label in (10, 40))
        assert len(car) > 50
        if layout == "semantickitti":  # world coordinates are those of the first sensor pose
            continue
        # float32 holds the range of less than 256 m to 2⁻¹⁶ m.
        assert np.abs(road[:, 2]).max() < 1e-3
        assert (np.abs(car - [12, 4, 0.75]) <= np.array([2, 1, 0.75]) + 1e-3).all()
    assert (all_of_them[1].pose[:3, 3] != all_of_them[0].pose[:3, 3]).any() == (layout != "bags")


def test_boxes_of_nuscenes_hold_their_points(tmp_path: Path) -> None:
    for frame in frames(make_set(tmp_path, "nuscenes")):
        assert frame.boxes is not None
        assert frame.boxes.label.tolist() == [10]
        # The boxes have room for points in float32, whose coordinates, up to 16 m, are rounded by 2**-24 of them.
        room = frame.boxes.size - [[4, 2, 1.5]]
        assert (room >= 0).all()
        assert room.max() < 4 * np.sqrt(3) * 2**-24 * (16 + 5)
        np.testing.assert_allclose(frame.boxes.center, [[12, 4, 0.75]], rtol=1e-12)
        points = frame.cloud.xyz[frame.cloud.label == 10]
        to_middle = points + 1e-3 * np.sign([12, 4, 0.75] - points)  # float32 moves points on the surface by less
        assert frame.boxes.contain(to_middle).all()


@pytest.mark.parametrize("layout", ["openpcdet", "mmdetection3d"])
def test_frames_without_boxes_are_shown(layout: str, tmp_path: Path) -> None:
    folder = make_set(tmp_path, f"{{type: {layout}, boxes: {{max_range_m: 1}}}}")
    found = frames(folder)
    assert [len(frame.boxes or ()) for frame in found] == [0] * 4
    ls.show(found[0].cloud, boxes=found[0].boxes, save=tmp_path / "a.html")


def test_points_and_boxes_in_world_coordinates_stay_there(tmp_path: Path) -> None:
    def drive(_: np.random.Generator, __: int) -> tuple[ls.Scene, ls.Lidar, ls.Trajectory]:
        scene = ls.Scene()
        scene.add(ls.Box((4, 2, 1.5), (12, 4, 0.75)), label=10)
        pose = np.eye(4)
        pose[:3, 3] = 5, 1, 2
        return (
            scene,
            ls.Lidar.preset("velodyne-vlp16", noise="datasheet"),
            ls.Trajectory.from_twist(pose, (3, 0, 0), (0, 0, 1)),
        )

    ls.generate(drive, tmp_path, frames=2, layout={"type": "shards", "boxes": True}, frame="world", pictures=0)
    for frame in frames(tmp_path):
        assert frame.boxes is not None
        np.testing.assert_allclose(frame.boxes.center, [[12, 4, 0.75]], rtol=1e-12)
        # The range of the preset is off by less than 0.2 m (its σ is 0.03 m).
        assert (np.abs(frame.clouds[0].xyz - [12, 4, 0.75]) <= np.array([2, 1, 0.75]) + 0.2).all()


CALIBRATION = """P2: 700 0 600 0 0 700 180 0 0 0 1 0
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.1 1 0 0 -0.3
"""
LABELS = """Car 0.00 0 -1.58 587.01 173.33 614.12 200.12 1.65 1.67 3.64 -0.65 1.71 46.70 -1.59
DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10
Pedestrian 0.00 0 -0.20 712.40 143.00 810.73 307.92 1.89 0.48 1.20 1.84 1.47 8.41 0.01 0.9
"""


def kitti(folder: Path) -> Path:
    for name in ("velodyne", "label_2", "calib"):
        (folder / "training" / name).mkdir(parents=True)
    ls.PointCloud(xyz=[[4, 0, 0], [0, 3, 1]], intensity=[0.5, 0.1]).save(folder / "training/velodyne/000007.bin")
    (folder / "training/label_2/000007.txt").write_text(LABELS, encoding="utf-8")
    (folder / "training/calib/000007.txt").write_text(CALIBRATION, encoding="utf-8")
    return folder


def test_kitti_says_that_there_are_no_boxes_behind(tmp_path: Path) -> None:
    folder = kitti(tmp_path)
    assert open_frames(folder).note == "boxes are only of what the camera ahead sees"
    shutil.rmtree(folder / "training" / "label_2")
    assert open_frames(folder).note == ""


def test_the_titles_of_frames_count_from_the_first_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_set(tmp_path, "bags")
    assert (frames(folder)[0].time or 0.0) > 1e9  # the time of a clock
    titles: list[object] = []
    monkeypatch.setattr(cli.commands.ls, "show", lambda *_, **looks: titles.append(looks["title"]))
    page = str(tmp_path / "a.html")
    for first, expected in {0: ("frame 0, 0.00 s", "frame 1, 0.10 s"), 1: ("frame 1, 0.10 s",)}.items():
        with pytest.raises(SystemExit) as end:
            cli.main(["view", str(folder), "--frame", str(first), "--frames", str(len(expected)), "--html", page])
        assert not end.value.code
        assert titles[-1] == expected


def test_kitti_has_the_boxes_that_openpcdet_makes_of_its_labels(tmp_path: Path) -> None:
    (frame,) = frames(kitti(tmp_path))
    boxes = frame.boxes
    assert boxes is not None
    assert [boxes.class_names[label] for label in boxes.label.tolist()] == ["Car", "Pedestrian"]
    # boxes3d_kitti_camera_to_lidar of OpenPCDet: the bottom's middle in the lidar's frame, raised by h/2; l, w, h; and
    # the heading -(rotation_y + π/2).
    np.testing.assert_allclose(boxes.center, [[47.0, 0.65, -1.81 + 1.65 / 2], [8.71, -1.84, -1.57 + 1.89 / 2]])
    np.testing.assert_allclose(boxes.size, [[3.64, 1.67, 1.65], [1.20, 0.48, 1.89]])
    turns = Rotation.from_rotvec([[0, 0, -(yaw + np.pi / 2)] for yaw in (-1.59, 0.01)]).as_matrix()
    np.testing.assert_allclose(boxes.rotation, turns, atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(boxes.rotation), 1.0)


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("label_2", "Car 1 2 3", "000007.txt: line 1: expected 15 or 16 columns, got 4"),
        ("label_2", LABELS.replace("46.70", "nan"), "000007.txt: line 1: expected finite numbers, got "),
        ("label_2", LABELS.replace("46.70", "far"), "000007.txt: line 1: expected finite numbers, got "),
        ("calib", "", "000007.txt: expected R0_rect and Tr_velo_to_cam, got neither"),
        ("calib", CALIBRATION.replace("1 0 0 0 1 0 0 0 1", "1 0"), "000007.txt: R0_rect: expected 9 numbers, got 2"),
        (
            "calib",
            CALIBRATION.replace("1 0 0 0 1 0 0 0 1", "0 " * 9),
            "000007.txt: expected transforms that can be inv",
        ),
    ],
)
def test_damaged_labels_of_kitti(file: str, text: str, message: str, tmp_path: Path) -> None:
    path = kitti(tmp_path) / "training" / file / "000007.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError) as caught:
        frames(tmp_path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.slow("hostile tables of nuScenes end in documented errors")
@pytest.mark.parametrize(
    ("table", "row", "key", "value", "message"),
    [
        ("sample_data", 0, "filename", "../secret.pcd.bin", "names something that is no regular file beside or below"),
        ("sample_data", 0, "filename", "/etc/passwd", "names a file by other than a relative path"),
        ("sample_data", 0, "ego_pose_token", "gone", "expected tokens of rows that exist, got 'gone'"),
        ("sample_annotation", 0, "size", [1, 2], "sample_annotation.json: 0.size: "),
        ("sample_annotation", 0, "translation", [1, "x", 2], "sample_annotation.json: 0.translation.1: "),
        ("sample", 1, "next", "SELF", "expected a chain of samples per scene, got one sample twice"),
        ("calibrated_sensor", 0, "rotation", [0, 0, 0, 0], "expected a rotation, got a quaternion of zeros"),
    ],
)
def test_hostile_tables_of_nuscenes(
    table: str, row: int, key: str, value: object, message: str, tmp_path: Path
) -> None:
    folder = make_set(tmp_path, "nuscenes")
    (tmp_path / "secret.pcd.bin").write_bytes(b"\0" * 20)
    path = folder / "v1.0-lidarsim" / f"{table}.json"
    rows = json.loads(path.read_text(encoding="utf-8"))
    rows[row][key] = rows[row]["token"] if value == "SELF" else value
    path.write_text(json.dumps(rows), encoding="utf-8")
    with pytest.raises(FileFormatError) as caught:
        frames(folder)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_tables_that_are_no_tables(tmp_path: Path) -> None:
    folder = make_set(tmp_path, "nuscenes")
    for text in ("", "{", "[" * 100_000, "3", '{"token": 1}'):
        (folder / "v1.0-lidarsim/sample.json").write_text(text, encoding="utf-8")
        with pytest.raises(FileFormatError, match=r"sample\.json: "):
            open_frames(folder)


def test_labels_stand_beside_points(tmp_path: Path) -> None:
    cloud = ls.PointCloud(xyz=[[4, 0, 0], [0, 3, 1]], intensity=[0.5, 0.1], label=[40, 10], instance=[0, 7])
    for number in (2, 10):
        cloud.save(tmp_path / f"{number}.bin")
    cloud.save(tmp_path / "10.label")
    bare, labelled = frames(tmp_path)  # 2 before 10
    assert "label" not in bare.cloud.fields
    assert (labelled.cloud.label.tolist(), labelled.cloud.instance.tolist()) == ([40, 10], [0, 7])
    assert labelled.cloud.class_names == {40: "road", 10: "car"}
    assert frames(tmp_path / "10.bin")[0].cloud.label.tolist() == [40, 10]
    (tmp_path / "10.label").write_bytes(b"\0" * 12)
    with pytest.raises(FileFormatError, match=r"10\.label: expected a label for each of the 2 points, got 3"):
        frames(tmp_path)


def test_classes_of_las_have_the_names_of_the_standard(tmp_path: Path) -> None:
    ls.PointCloud(xyz=[[4, 0, 0], [0, 3, 1]], label=[2, 5]).save(tmp_path / "a.las")
    (frame,) = frames(tmp_path / "a.las")
    assert frame.cloud.class_names == {2: "ground", 5: "high vegetation"}


def test_damaged_shards(tmp_path: Path) -> None:
    folder = make_set(tmp_path, "shards")
    path = folder / "shards" / "000000.tar"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileFormatError, match=r"000000\.tar: not a readable tar file"):
        frames(folder)
    with tarfile.open(path, "w") as tar:
        info = tarfile.TarInfo("../000000_000000.npz")
        tar.addfile(info)
    with pytest.raises(FileFormatError, match=r"000000\.tar: expected a JSON beside each archive, got none for"):
        frames(folder)


def test_damaged_tables_of_semantickitti(tmp_path: Path) -> None:
    sequence = make_set(tmp_path, "semantickitti") / "sequences" / "00"
    for name, text, message in (
        ("times.txt", "0.0\n", "expected a time for each of the 2 frames, got 1"),
        ("times.txt", "soon\n", "line 1: expected finite numbers, got soon"),
        ("calib.txt", "Tr: 1 2 3\n", "Tr: expected 12 numbers, got 3"),
        ("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "expected a pose for each of the 2 frames, got 1"),
        ("poses.txt", "a b c\n", "not a readable file of KITTI poses"),
    ):
        before = (sequence / name).read_bytes()
        (sequence / name).write_text(text, encoding="utf-8")
        with pytest.raises(FileFormatError) as caught:
            frames(tmp_path / "set")
        assert f"{name}: {message}" in str(caught.value)
        (sequence / name).write_bytes(before)
    assert len(frames(tmp_path / "set")) == 4


def test_nothing_to_show(tmp_path: Path) -> None:
    with pytest.raises(LidarsimError, match="expected a data set or a folder of point clouds, got neither"):
        open_frames(tmp_path)


@pytest.mark.parametrize("form", ["PAX 1.0", "PAX 0.1", "PAX 0.0", "GNU"])
@pytest.mark.parametrize("sparse", ["0.json", "0.npz"])
def test_sparse_members_of_shards_are_refused_unread(form: str, sparse: str, tmp_path: Path) -> None:
    """A few bytes in the file claim 3 GB, which `tarfile` would make of zeros."""
    size = 3 << 30
    about = {"sequence": 0, "frame": 0, "seconds": 0, "pose": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}
    with tarfile.open(tmp_path / "0.tar", "w", format=tarfile.PAX_FORMAT) as tar:
        for name, data in (("0.json", json.dumps(about).encode()), ("0.npz", b"x")):
            member = tarfile.TarInfo(name)
            span = size - len(data), len(data)
            if name == sparse and form == "PAX 1.0":
                spans = b"1\n%d\n%d\n" % span
                data = spans.ljust(512, b"\0") + data  # noqa: PLW2901
                numbers = {"major": "1", "minor": "0", "name": name, "realsize": str(size)}
                member.pax_headers = {f"GNU.sparse.{key}": value for key, value in numbers.items()}
            elif name == sparse and form != "GNU":
                spans_0 = {"offset": str(span[0]), "numbytes": str(span[1])}
                numbers = {"size": str(size), "numblocks": "1"}
                numbers |= {"map": "{},{}".format(*span)} if form == "PAX 0.1" else spans_0
                member.pax_headers = {f"GNU.sparse.{key}": value for key, value in numbers.items()}
            member.size = len(data)
            if name != sparse or form != "GNU":
                tar.addfile(member, io.BytesIO(data))
                continue
            member.type = tarfile.GNUTYPE_SPARSE
            header = bytearray(member.tobuf(tarfile.GNU_FORMAT))
            header[386:410] = b"%011o\0%011o\0" % span
            header[483:495] = b"%011o\0" % size
            header[148:156] = b" " * 8
            header[148:156] = b"%06o\0 " % sum(header)
            block = bytes(header) + data.ljust(512, b"\0")
            assert tar.fileobj is not None
            tar.fileobj.write(block)
            tar.offset += len(block)
    with pytest.raises(FileFormatError, match=rf"'{sparse}' is sparse, of 3,221,225,472 bytes; expected a whole file"):
        list(open_frames(tmp_path).read(0))
