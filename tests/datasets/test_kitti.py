"""KITTI's detection layout, read back from its files alone by the words of its development kit and of OpenPCDet."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, HalfspaceIntersection
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.datasets.layouts._camera import view_of_box
from lidarsim.datasets.layouts.kitti import Camera, Kitti
from lidarsim.datasets.samples import Annotation

NAMES = {1: "Pedestrian", 2: "Car", 3: "Van", 40: "road"}


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_euler("z", yaw).as_matrix(), (x, y, z)
    return matrix


def drive(speed: float) -> Any:
    """A recipe of a car that drives past a walker, a turning car, a van of three parts, and a wall of no instance."""

    def scenes(*_: object) -> Any:
        span = np.linspace(-1.0, 2.0, 61)
        scene = ls.Scene(class_names=NAMES)
        scene.add(ls.Plane((0, 0, 1), 0.0), label=40)
        walk = ls.Trajectory(span, [pose(14, 4 - 1.4 * t, 0, -1.6) for t in span])
        scene.add(ls.Ellipsoid((0, 0, 0.88), (0.2, 0.28, 0.88)), label=1, motion=walk)
        turn = ls.Trajectory(span, [pose(22 + 12 * t, -4, 0, 0.6 * t) for t in span])
        scene.add(ls.Box((4.5, 1.9, 1.5), center=(0, 0, 0.8)), label=2, motion=turn)
        for center, size in (((0, 0, 1), (3, 2, 1.6)), ((2, 0, 0.7), (1, 1.9, 1)), ((-2, 0, 1.1), (1, 2, 1.8))):
            scene.add(ls.Box(size, center=center), label=3, instance=99, transform=pose(25, 5, 0, 0.5))
        scene.add(ls.Box((1, 9, 3), center=(60, 0, 1.5)), label=40, instance=0)
        ego = ls.Trajectory(span, [pose(speed * t, 0, 1.8, 0.1 * t) for t in span])
        lidar = ls.Lidar(ls.patterns.Spinning(np.radians(np.linspace(-25, 15, 40)), columns=900, rate=10.0))
        return scene, lidar, ego

    return scenes


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fast")
    ls.generate(drive(30.0), out, frames=4, layout="kitti", pictures=0)
    return out


def read(folder: Path, number: int) -> tuple[np.ndarray, list[list[str]], dict[str, np.ndarray]]:
    """Points, labels and calibration of a frame."""
    points = np.fromfile(folder / f"velodyne/{number:06}.bin", np.float32).reshape(-1, 4)
    labels = [line.split(" ") for line in (folder / f"label_2/{number:06}.txt").read_text().splitlines()]
    lines = (line.split(": ") for line in (folder / f"calib/{number:06}.txt").read_text().splitlines())
    return points, labels, {name: np.array(values.split(), float).reshape(3, -1) for name, values in lines}


def own_axes(points: np.ndarray, label: list[str], matrices: dict[str, np.ndarray]) -> np.ndarray:
    """Points in the frame of a box, divided by half of its size, as the development kit places a box."""
    height, width, length, *where, turn = map(float, label[8:])
    camera = points[:, :3].astype(float) @ matrices["Tr_velo_to_cam"][:, :3].T + matrices["Tr_velo_to_cam"][:, 3]
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    local = (camera - where) @ rotation + [0, height / 2, 0]
    return local / (np.array([length, height, width]) / 2)


def test_the_points_of_instances_are_in_their_boxes(fast: Path) -> None:
    """All that is above the road and nearer than the wall is in a box."""
    for number in range(4):
        points, labels, matrices = read(fast / "training", number)
        assert [*matrices] == ["P0", "P1", "P2", "P3", "R0_rect", "Tr_velo_to_cam", "Tr_imu_to_velo"]
        assert {label[0] for label in labels} == {"Pedestrian", "Car", "Van"}
        assert len(labels) == 3  # a van of three parts is one instance
        inside = np.array([(np.abs(own_axes(points, label, matrices)) <= 1).all(axis=1) for label in labels])
        above = (points[:, 2] > -1.79) & (points[:, 0] < 45 - 3 * number)
        assert above.sum() > 150
        assert inside[:, above].any(axis=0).all()
        assert (inside[:, above].sum(axis=1) > 5).all()


def test_boxes_stay_with_raw_points_where_asked_for(tmp_path: Path) -> None:
    """Without deskewing, points of slow instances are in their boxes all the same, and the card says what is done."""
    ls.generate(drive(8.0), tmp_path, frames=2, layout="kitti", pictures=0, deskew=False)
    points, labels, matrices = read(tmp_path / "training", 0)
    scene, lidar, ego = drive(8.0)()
    cloud = lidar.scan(scene, ego).point_cloud()
    np.testing.assert_array_equal(points[:, :3], cloud.xyz.astype(np.float32))
    (van,) = (label for label in labels if label[0] == "Van")
    assert (np.abs(own_axes(points[cloud.label == 3], van, matrices)) <= 1.05).all()
    assert "not deskewed. Each box is where its points are on average" in (tmp_path / "README.md").read_text()


def test_calibration_and_rectangles_fit_together(fast: Path) -> None:
    camera = Camera()
    for number in range(4):
        _, labels, matrices = read(fast / "training", number)
        assert np.array_equal(matrices["R0_rect"], np.eye(3))
        np.testing.assert_array_equal(matrices["P2"][:, 2], [camera.width / 2, camera.height / 2, 1])
        for label in labels:
            truncation, occlusion, alpha, *rectangle = map(float, label[1:8])
            height, width, length, x, y, z, turn = map(float, label[8:])
            corners = np.array(list(np.ndindex(2, 2, 2))) * [length, -height, width] - [length / 2, 0, width / 2]
            rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
            pixels = np.append(corners @ rotation.T + [x, y, z], np.ones((8, 1)), axis=1) @ matrices["P2"].T
            pixels = pixels[:, :2] / pixels[:, 2:]
            limits = np.array([camera.width - 1, camera.height - 1])
            if (pixels >= 0).all() and (pixels <= limits).all():
                assert truncation == 0
                # Pixels up to 2**11 at distances over 10 m: some hundred roundings of these.
                expected = [*pixels.min(axis=0), *pixels.max(axis=0)]
                np.testing.assert_allclose(rectangle, expected, rtol=0, atol=2.0**11 * 256 * 2.0**-53)
            assert occlusion in {0, 1, 2}
            seen_from = turn - np.arctan2(x, z) - alpha
            assert np.sin(seen_from) == pytest.approx(0, abs=64 * 2.0**-53)
            assert np.cos(seen_from) > 0.0
            assert -np.pi <= alpha <= np.pi


def test_rotations_are_those_of_the_fronts(fast: Path) -> None:
    """Not of the backs, which boxes have as well: the front is along the x axis of the development kit's box."""
    turns = {"Pedestrian": lambda _: -1.6, "Car": lambda time: 0.6 * time, "Van": lambda _: 0.5}
    for number, frame in enumerate(ls.datasets.load(fast)):
        _, labels, matrices = read(fast / "training", number)
        for label in labels:
            rotation = float(label[14])
            front = matrices["Tr_velo_to_cam"][:, :3].T @ (np.cos(rotation), 0.0, -np.sin(rotation))
            expected = frame.pose[:3, :3].T @ pose(0, 0, 0, turns[label[0]](frame.time))[:3, 0]
            np.testing.assert_allclose(front, expected, rtol=0, atol=64 * 2.0**-53)  # some tens of roundings


def test_images_tell_their_size(fast: Path) -> None:
    data = (fast / "training/image_2/000002.png").read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    (length,) = struct.unpack(">I", data[8:12])
    width, height, depth, kind = struct.unpack(">IIBB", data[16 : 16 + length][:10])
    assert (width, height, depth, kind) == (1242, 375, 8, 2)
    rows = zlib.decompress(data[data.index(b"IDAT") + 4 :])
    assert len(rows) == height * (1 + 3 * width)
    assert not any(rows)


def test_a_frame_without_instances_has_a_line(tmp_path: Path) -> None:
    """OpenPCDet concatenates what the lines say, and of none it cannot."""

    def scenes(*_: object) -> Any:
        scene = ls.Scene()
        scene.add(ls.Sphere((-9, 0, 0), 1.0), label=1)  # behind the camera
        lidar = ls.Lidar(ls.patterns.Spinning([0.0], columns=360))
        return scene, lidar, None

    ls.generate(scenes, tmp_path, layout="kitti", pictures=0)
    line = (tmp_path / "training/label_2/000000.txt").read_text()
    assert line == "DontCare -1 -1 -10 0 0 0 0 -1 -1 -1 -1000 -1000 -1000 -10\n"


@pytest.mark.parametrize(("hidden", "level"), [(0.0, "0"), (0.5, "1"), (0.75, "2")])
def test_occlusion_is_what_a_wall_hides(tmp_path: Path, hidden: float, level: str) -> None:
    """A target of a hundred columns, of which a wall in front hides a share: 0.8 and 0.4 divide the levels."""

    def scenes(*_: object) -> Any:
        scene = ls.Scene()
        scene.add(ls.Box((1, 4, 2), center=(10.5, 0, 0)), label=1)
        if hidden:  # at 5 m, the columns are 0.5 m to both sides
            scene.add(ls.Box((0.1, 1 + hidden, 2), center=(5.05, hidden / 2 - 1, 0)), instance=0)
        lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-0.1, 0.1, 100), [0.0], rate=10.0))
        return scene, lidar, None

    ls.generate(scenes, tmp_path, layout="kitti", pictures=0, class_names={1: "Car"})
    (line,) = (tmp_path / "training/label_2/000000.txt").read_text().splitlines()
    assert line.split()[2] == level
    assert line.startswith("Car ")


def test_a_rig_has_a_folder_per_sensor(tmp_path: Path) -> None:
    def scenes(*_: object) -> Any:
        scene, lidar, ego = drive(5.0)()
        mount = pose(1.0, 0.5, 0.2, 0.3)
        return scene, ls.Rig({"top": (lidar, None), "side": (lidar, mount)}), ego

    ls.generate(scenes, tmp_path, frames=2, layout="kitti", pictures=0)
    assert ls.datasets.verify(tmp_path) == []
    _, _, matrices = read(tmp_path / "side/training", 1)
    imu = np.vstack([matrices["Tr_imu_to_velo"], [0, 0, 0, 1]])
    np.testing.assert_allclose(np.linalg.inv(imu), pose(1.0, 0.5, 0.2, 0.3), rtol=0, atol=1e-11)  # twelve decimals
    assert (tmp_path / "top/ImageSets/train.txt").read_text() == "000000\n000001\n"


@pytest.mark.parametrize("name", ["big car", "", "a\tb", "DontCare", "a\u2028b", "\x1b[31m"])
def test_names_that_labels_cannot_have(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=r"^class_names\[2\]: expected printable text without spaces") as caught:
        ls.generate(drive(1.0), tmp_path / "out", layout="kitti", pictures=0, class_names={2: name})
    assert str(caught.value).isprintable()
    assert not any(tmp_path.iterdir())


def hull(corners: np.ndarray, projection: np.ndarray, width: int, height: int) -> tuple[float, np.ndarray] | None:
    """The share of a box within the view and its rectangle there, by Qhull."""
    focal, column, row = projection[0, 0], projection[0, 2], projection[1, 2]
    sides = np.array([
        [-focal, 0, -column, 0], [focal, 0, column - (width - 1), 0],
        [0, -focal, -row, 0], [0, focal, row - (height - 1), 0],
    ])  # fmt: skip
    both = np.concatenate([ConvexHull(corners).equations, sides / np.linalg.norm(sides, axis=1, keepdims=True)])
    inner = deepest(both)
    if inner is None:
        return None
    points = HalfspaceIntersection(both, inner).intersections
    pixels = points @ projection[:, :3].T
    pixels = pixels[pixels[:, 2] > 1e-6]
    return ConvexHull(points).volume / ConvexHull(corners).volume, pixels[:, :2] / pixels[:, 2:]


def deepest(halfspaces: np.ndarray) -> np.ndarray | None:
    """The point farthest within halfspaces; None if there is none a millimetre within."""
    from scipy.optimize import linprog

    ones = np.linalg.norm(halfspaces[:, :3], axis=1, keepdims=True)
    found = linprog(
        [0, 0, 0, -1], np.hstack([halfspaces[:, :3], ones]), -halfspaces[:, 3], bounds=[(None, None)] * 3 + [(0, None)]
    )
    return found.x[:3] if found.success and found.x[3] > 1e-3 else None


@given(
    st.tuples(st.floats(-15, 15), st.floats(-6, 6), st.floats(-6, 25)),
    st.tuples(*[st.floats(0.3, 8)] * 3),
    st.tuples(*[st.floats(-4, 4)] * 3),
)
def test_what_the_camera_sees_of_a_box(center: Any, size: Any, turn: Any) -> None:
    camera = Camera()
    rotation = Rotation.from_rotvec(turn).as_matrix()
    corners = center + (np.array(list(np.ndindex(2, 2, 2))) - 0.5) * size @ rotation.T
    found = view_of_box(corners, camera.projection, camera.width, camera.height)
    expected = hull(corners, camera.projection, camera.width, camera.height)
    if expected is None:
        assert found is None or found[1] > 1 - 0.1
        return
    assert found is not None
    rectangle, outside = found
    assert outside == pytest.approx(1 - expected[0], abs=1e-6)
    low, high = expected[1].min(axis=0), expected[1].max(axis=0)
    np.testing.assert_allclose(rectangle, [*low, *high], atol=0.1)


def test_the_boxes_in_the_statistics_are_those_with_labels() -> None:
    layout, rng, counts = Kitti(type="kitti"), np.random.default_rng(0), [0, 0]
    for turn in Rotation.random(500, rng).as_matrix():
        center = rng.uniform((-5, -20, -8), (30, 20, 8))
        box = Annotation(1, 2, 9, tuple(center), (4.0, 2.0, 1.5), tuple(turn.ravel()), (0.0, 0.0, 0.0), 1.0, 0.0, 0.0)
        line = layout._label(box, NAMES)
        assert layout._sees(box) == bool(line), center
        counts[bool(line)] += 1
    assert min(counts) > 100
