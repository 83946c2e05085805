"""ROS 2 bags beside rosbags and mcap-ros2-support."""

from __future__ import annotations

import re
import shutil
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_ros2.decoder import DecoderFactory
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.errors import FileFormatError, MissingExtraError
from lidarsim.io import _records, rosbag
from lidarsim.scan.fields import CANONICAL
from lidarsim.scan.pointcloud import PointCloud

COUNT = 500
START = 1_577_836_800 * 10**9
CUSTOM = "livox_ros_driver2/msg/CustomMsg"
CLOUD = "sensor_msgs/msg/PointCloud2"


@pytest.fixture(scope="module")
def ros() -> Any:
    """Types of ROS and of Livox, whose definitions are https://github.com/Livox-SDK/livox_ros_driver2."""
    store = get_typestore(Stores.ROS2_JAZZY)
    point = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
    message = "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
    store.register(get_types_from_msg(point, "livox_ros_driver2/msg/CustomPoint"))
    store.register(get_types_from_msg(f"{message}CustomPoint[] points\n", CUSTOM))
    return store


@pytest.fixture
def cloud() -> PointCloud:
    rng = np.random.default_rng(0)
    return PointCloud(
        xyz=rng.uniform(-50, 50, (COUNT, 3)),
        range=rng.uniform(1, 50, COUNT),
        intensity=rng.uniform(0, 1.2, COUNT),
        time=np.sort(rng.uniform(0, 0.1, COUNT)),
        ring=rng.integers(0, 128, COUNT),
        return_number=rng.integers(1, 3, COUNT),
        return_count=np.full(COUNT, 2),
        label=np.arange(COUNT),
    )


def sensor(name: str, **more: Any) -> Any:
    """What the writer asks of a lidar."""
    return SimpleNamespace(**({"model": name, "range_offset": 0.0, "measurement": ls.Measurement()} | more))


def messages(path: Path, ros: Any) -> dict[str, list[tuple[int, Any]]]:
    """Times of recording and messages by topic, as rosbags reads them."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with Reader(path) as bag:
        for connection, stamp, data in bag.messages(bag.connections):
            message = ros.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp, message))
    return found


def points(message: Any) -> np.ndarray:
    """The points of a PointCloud2, by the definition of sensor_msgs/PointField."""
    codes = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
    dtype = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": [f"<{codes[field.datatype]}" for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    return np.frombuffer(bytes(message.data), dtype)


def only(path: Path, ros: Any) -> Any:
    ((_, message),) = messages(path, ros)["/lidar/points"]
    return message


LAYOUTS = {
    "velodyne": "x f4 0, y f4 4, z f4 8, intensity f4 12, ring u2 16, time f4 18; 22",
    "ouster": "x f4 0, y f4 4, z f4 8, intensity f4 16, t u4 20, reflectivity u2 24, ring u2 26, ambient u2 28, "
    "range u4 32; 48",
    "hesai": "x f4 0, y f4 4, z f4 8, intensity f4 12, ring u2 16, timestamp f8 18; 26",
    "autoware": "x f4 0, y f4 4, z f4 8, intensity u1 12, return_type u1 13, channel u2 14, azimuth f4 16, "
    "elevation f4 20, distance f4 24, time_stamp u4 28; 32",
    "livox_cloud": "x f4 0, y f4 4, z f4 8, intensity f4 12, tag u1 16, line u1 17, timestamp f8 18; 26",
}


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_layouts_of_the_drivers(layout: str, suffix: str, cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    path = tmp_path / f"drive{suffix}"
    with rosbag.Writer(path, layout=layout, start=100.0) as bag:
        bag.write_cloud(cloud, 2.5, lidar=sensor("lidar", range_offset=0.0125))
    message = only(path, ros)
    got, step = points(message), message.point_step
    fields = ", ".join(f"{name} {part.str[1:]} {at}" for name, (part, at) in got.dtype.fields.items())
    assert f"{fields}; {step}" == LAYOUTS[layout]
    assert message.row_step == step * COUNT
    assert (message.height, message.width, len(message.data)) == (1, COUNT, step * COUNT)
    assert message.is_dense
    assert not message.is_bigendian
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (102, 500_000_000)
    assert message.header.frame_id == "lidar"
    x, y, z = cloud.xyz.T
    whole = 150 if layout == "livox_cloud" else 100  # of a white diffuser
    expected = {
        **dict(zip("xyz", cloud.xyz.T, strict=True)),
        **dict.fromkeys(("intensity", "reflectivity"), np.rint(whole * cloud.intensity)),
        **dict.fromkeys(("ring", "channel", "line"), cloud.ring),
        "tag": 16 * (cloud.return_number.astype(int) - 1),
        **dict.fromkeys(("t", "time_stamp"), np.rint(cloud.time * 1e9)),
        "ambient": np.zeros(COUNT),
        "time": cloud.time,
        "timestamp": (102.5e9 + np.rint(cloud.time * 1e9)) / (1 if layout == "livox_cloud" else 1e9),
        "range": np.rint(1000 * (cloud.range + 0.0125)),
        "azimuth": np.arctan2(y, x),
        "elevation": np.arcsin(z / np.sqrt(x * x + y * y + z * z)),
        "distance": np.sqrt(x * x + y * y + z * z),
        "return_type": np.full(COUNT, 3),
    }
    for name in got.dtype.names:
        # Rounded to the type, half an ulp of it; the angles and the absolute time besides to a few ulps of float64.
        near = np.spacing(2 * np.pi)
        eps = {"f4": 2.0**-24, "f8": 2.0**-52}.get(got.dtype[name].str[1:], 0)
        np.testing.assert_allclose(got[name], expected[name], rtol=1.001 * eps, atol=near * (eps > 0), err_msg=name)


def test_mcap_ros2_reads_the_same(cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with rosbag.Writer(path, trajectory=np.eye(4)) as bag:
        bag.write_cloud(cloud)
        bag.write_cloud(PointCloud(xyz=np.random.default_rng(0).normal(size=(50_000, 3))), 0.1)  # more than a chunk
        bag.write_cloud(cloud[:10], 0.2)
    ours = messages(path, ros)
    theirs: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_summary().statistics.chunk_count == 2
        for _, channel, entry, message in reader.iter_decoded_messages():
            theirs.setdefault(channel.topic, []).append((entry.log_time, message))
    assert {topic: len(entries) for topic, entries in theirs.items()} == {
        topic: len(entries) for topic, entries in ours.items()
    }
    for (recorded, a), (stamp, b) in zip(ours["/lidar/points"], theirs["/lidar/points"], strict=True):
        assert recorded == stamp
        assert bytes(a.data) == bytes(b.data)
        assert a.width == b.width
        assert a.header.stamp.nanosec == b.header.stamp.nanosec
    transform = theirs["/tf_static"][0][1].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", "lidar")


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_samples_of_an_imu(suffix: str, cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    mount = RigidTransform.from_components([1, 2, 3], Rotation.from_euler("z", 0.5)).as_matrix()
    noisy = ls.ImuErrors(noise_density=0.002)
    imu = ls.Imu(200.0, mount=mount, gyroscope=noisy, accelerometer=ls.ImuErrors(bias=0.1), name="imu")
    drive = ls.Trajectory.from_twist(np.eye(4), (10, 0, 0), (0, 0, 0.3))
    samples = imu.measure(drive, end=0.25)
    path = tmp_path / f"drive{suffix}"
    with rosbag.Writer(path, sensors={"top": np.eye(4), "imu": imu}, trajectory=drive, start=100.0) as bag:
        bag.write_imu(samples)
        bag.write_cloud(cloud, 0.1, sensor="top")
    found = messages(path, ros)
    assert len(found["/top/points"]) == 1
    assert len(found["/imu/data_raw"]) == len(samples) == 51
    for k, (recorded, message) in enumerate(found["/imu/data_raw"]):
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        assert recorded == stamp == 100 * 10**9 + 5_000_000 * k
        assert message.header.frame_id == "imu"
        rate, force = message.angular_velocity, message.linear_acceleration
        assert [rate.x, rate.y, rate.z] == samples.angular_rate[k].tolist()
        assert [force.x, force.y, force.z] == samples.specific_force[k].tolist()
        assert message.orientation_covariance[0] == -1
        np.testing.assert_allclose(
            message.angular_velocity_covariance, np.eye(3).ravel() * 0.002**2 * 200, rtol=2.0**-51
        )
        assert not message.linear_acceleration_covariance.any()
    (_, frames), *_ = found["/tf_static"]
    placed = {frame.child_frame_id: frame.transform.translation for frame in frames.transforms}
    assert (placed["imu"].x, placed["imu"].y, placed["imu"].z) == (1, 2, 3)


def test_samples_of_unknown_imus_are_refused(tmp_path: Path) -> None:
    samples = ls.Imu(10.0).measure(ls.Trajectory.from_twist(np.eye(4)), end=0.1)
    bag = rosbag.Writer(tmp_path / "drive.mcap")
    with pytest.raises(ValueError, match="expected to be written in a with block"):
        bag.write_imu(samples)
    with bag, pytest.raises(ValueError, match="sensor: expected one of lidar, got 'imu'"):
        bag.write_imu(samples)


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
@pytest.mark.parametrize("count", [0, 1, 2, COUNT])
def test_livox_custom_messages(count: int, suffix: str, cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    path = tmp_path / f"drive{suffix}"
    cloud = cloud[:count]
    with rosbag.Writer(path, layout="livox", sensors={"mid360": np.eye(4)}) as bag:
        bag.write_cloud(cloud, 1.5)
    ((_, message),) = messages(path, ros)["/mid360/points"]
    with Reader(path) as bag:
        (data,) = (bytes(data) for connection, _, data in bag.messages() if connection.msgtype == CUSTOM)
    assert data == bytes(ros.serialize_cdr(message, CUSTOM))
    assert (message.point_num, message.lidar_id, message.rsvd.tolist()) == (count, 0, [0, 0, 0])
    assert message.timebase == START + 1_500_000_000
    assert (message.header.stamp.sec * 10**9 + message.header.stamp.nanosec) == message.timebase
    got = {name: [getattr(point, name) for point in message.points] for name in ("x", "offset_time", "line", "tag")}
    assert got["x"] == np.float32(cloud.xyz[:, 0]).tolist()
    assert got["offset_time"] == np.rint(cloud.time * 1e9).tolist()
    assert got["line"] == cloud.ring.tolist()
    assert got["tag"] == ((cloud.return_number - 1) << 4).tolist()
    shine = np.minimum(np.rint(150 * cloud.intensity), 255)
    assert [point.reflectivity for point in message.points] == shine.tolist()

    (read,) = rosbag.read(path)
    assert (read.topic, read.frame_id, read.stamp) == ("/mid360/points", "mid360", START + 1_500_000_000)
    np.testing.assert_array_equal(read.cloud.xyz, cloud.xyz.astype(np.float32))
    np.testing.assert_array_equal(read.cloud.ring, cloud.ring)
    np.testing.assert_allclose(read.cloud.time, cloud.time, rtol=0, atol=0.5e-9 + np.spacing(0.1))
    np.testing.assert_array_equal(read.cloud.reflectivity, shine)


@pytest.mark.parametrize(
    ("preset", "layout"),
    [
        ("velodyne-vlp16", "velodyne"),
        ("ouster-os1-64", "ouster"),
        ("hesai-xt32", "hesai"),
        ("robosense-rs16", "hesai"),
        ("livox-mid40", "livox"),
        ("sick-lms111", "velodyne"),
    ],
)
def test_the_layout_is_that_of_the_sensor(preset: str, layout: str, ros: Any, tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 20.0), material=ls.Material(reflectivity=0.5))
    path = tmp_path / "drive.mcap"
    scan = ls.Lidar.preset(preset).scan(scene, time=1.0)
    with rosbag.Writer(path) as bag:
        bag.write(scan)
    message = only(path, ros)
    cloud = scan.point_cloud()
    assert len(cloud) > 100
    if layout == "livox":
        assert message.point_num == len(cloud)
    else:
        assert ", ".join(field.name for field in message.fields) == ", ".join(rosbag.LAYOUTS[layout].names or ())
        np.testing.assert_array_equal(points(message)["z"], cloud.xyz[:, 2].astype(np.float32))
        assert np.unique(points(message)["intensity"]).tolist() == [50]
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == START + 10**9


def test_the_layout_stays_that_of_the_sensor_in_a_rig(ros: Any, tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 20.0))
    presets = {"top": "ouster-os1-128", "left": "hesai-xt32", "rear": "velodyne-vlp16"}
    rig = ls.Rig({name: (ls.Lidar.preset(preset), None) for name, preset in presets.items()})
    (scans,) = rig.frames(scene, None, 1)
    with rosbag.Writer(tmp_path / "drive.mcap", sensors=rig) as bag:
        bag.write(scans)
    found = messages(tmp_path / "drive.mcap", ros)
    for name, layout in (("top", "ouster"), ("left", "hesai"), ("rear", "velodyne")):
        ((_, message),) = found[f"/{name}/points"]
        assert tuple(field.name for field in message.fields) == rosbag.LAYOUTS[layout].names


@pytest.mark.parametrize(
    ("layout", "values"),
    [
        ("velodyne", {0: 0, 0.004: 0, 0.006: 1, 0.5: 50, 1: 100, 1.01: 101, 2: 200, 2.55: 255, 1000: 255}),
        ("hesai", {0: 0, 1: 100, 2.55: 255, np.inf: 255}),
        ("ouster", {0: 0, 1: 100, 1.5: 150, 9: 255}),
        ("livox", {0: 0, 0.5: 75, 1: 150, 1.01: 152, 1.7: 255, 9: 255}),
    ],
)
def test_intensity_in_the_vendors_units(layout: str, values: dict[float, int], ros: Any, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with rosbag.Writer(path, layout=layout) as bag:
        bag.write_cloud(PointCloud(xyz=np.ones((len(values), 3)), intensity=list(values)))
    message = only(path, ros)
    got = [p.reflectivity for p in message.points] if layout == "livox" else points(message)["intensity"].tolist()
    assert got == list(values.values())


def test_kinds_of_returns(cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    cloud = cloud[:6]
    cloud.return_number, cloud.return_count = [1, 2, 1, 2, 1, 1], [2, 2, 2, 2, 1, 1]
    cloud.range = [5, 9, 9, 5, 7, 7]
    beam = ls.Beam(divergence_azimuth=1e-3)
    several = {
        "strongest": [3] * 6,
        "first": [2] * 6,
        "last": [1] * 6,
        "dual": [3, 1, 3, 8, 3, 3],
        3: [2, 1, 2, 1, 2, 2],
    }
    for returns, kinds in several.items():
        lidar = sensor("lidar", measurement=ls.Measurement(returns=returns, beam=beam))
        with rosbag.Writer(tmp_path / "drive.mcap", layout="autoware") as bag:
            bag.write_cloud(cloud, lidar=lidar)
        assert points(only(tmp_path / "drive.mcap", ros))["return_type"].tolist() == kinds, returns
    with rosbag.Writer(tmp_path / "drive.mcap", layout="autoware") as bag:
        bag.write_cloud(cloud)
    assert points(only(tmp_path / "drive.mcap", ros))["return_type"].tolist() == [0] * 6


def test_the_vendors_zero_of_range_may_differ_by_the_ring(cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    cloud.ring = np.arange(COUNT) % 2
    with rosbag.Writer(tmp_path / "drive.mcap") as bag:
        bag.write_cloud(cloud, lidar=sensor("ouster-x", range_offset=(0.5, -0.25)))
    got = points(only(tmp_path / "drive.mcap", ros))["range"]
    np.testing.assert_array_equal(got, np.rint(1000 * (cloud.range + np.where(cloud.ring == 0, 0.5, -0.25))))


def test_ousters_range_by_its_own_formula(ros: Any, tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 20.0))
    scan = ls.Lidar.preset("ouster-os1-128").scan(scene)
    with rosbag.Writer(tmp_path / "drive.mcap") as bag:
        bag.write(scan)
    got = points(only(tmp_path / "drive.mcap", ros))
    # The maker's formula puts a point (range − n) from the beam's origin, which is n = 15.806 mm from the axis; half a
    # millimetre is lost as range is whole ones, and as much as float32 loses at 20 m.
    direction = scan.pulses.directions[scan.status == ls.Status.hit]
    origin = scan.pulses.origins[scan.status == ls.Status.hit]
    np.testing.assert_allclose(np.hypot(*origin[:, :2].T), 0.015806, rtol=2.0**-51)
    xyz = origin + (got["range"] / 1000 - 0.015806)[:, None] * direction
    for axis, name in enumerate("xyz"):
        np.testing.assert_allclose(got[name], xyz[:, axis], rtol=0, atol=0.5e-3 + 2.0**-20)


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
@pytest.mark.parametrize("layout", rosbag.LAYOUTS)
def test_memory_of_each_layout(layout: str, suffix: str, tmp_path: Path) -> None:
    """Writing takes at most twice the memory of a scan's cloud besides it, reading twice that of what it gives."""
    rng, points = np.random.default_rng(0), 50_000  # more than the 1 MiB at which rosbags ends a chunk
    cloud = PointCloud(
        {
            name: rng.integers(0, 9, (points, *shape)).astype(dtype)
            for name, (shape, dtype) in CANONICAL.items()
            if name != "radial_velocity"
        }
        | {"time": np.sort(rng.random(points))}
    )
    for number in range(2):  # once for the imports
        with rosbag.Writer(tmp_path / f"{number}{suffix}", layout=layout) as bag:
            tracemalloc.start()
            bag.write_cloud(cloud)
            written = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
        tracemalloc.start()
        (message,) = rosbag.read(tmp_path / f"{number}{suffix}")
        read = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert len(message.cloud) == points
    for peak, whole in ((written, cloud), (read, message.cloud)):
        size = sum(getattr(whole, name).nbytes for name in whole.fields)
        assert peak < 2 * size + 2**17  # the buffer in which zstd decompresses


def test_points_are_dense_and_in_firing_order(cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    mixed = cloud[np.random.default_rng(1).permutation(COUNT)]
    mixed.xyz[::5, 1] = np.nan
    with rosbag.Writer(tmp_path / "drive.mcap") as bag:
        bag.write_cloud(mixed)
    message = only(tmp_path / "drive.mcap", ros)
    got = points(message)
    assert message.is_dense
    assert message.width == COUNT - COUNT // 5 == len(got)
    assert np.isfinite(got["y"]).all()
    assert (np.diff(got["time"]) >= 0).all()
    kept = mixed[np.isfinite(mixed.xyz[:, 1])]
    np.testing.assert_array_equal(got["ring"], kept.ring[np.argsort(kept.time)])


def test_fields_that_the_cloud_has_not_are_zero(ros: Any, tmp_path: Path) -> None:
    PointCloud(xyz=[[1, 2, 3], [4, 5, 6]]).save(tmp_path / "cloud.mcap")
    got = points(only(tmp_path / "cloud.mcap", ros))
    assert got["x"].tolist() == [1, 4]
    for name in ("intensity", "ring", "time"):
        assert got[name].tolist() == [0, 0]


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_transforms_odometry_and_clock(suffix: str, cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    start = RigidTransform.from_components((5, 6, 7), Rotation.from_euler("z", 0.5))
    drive = ls.Trajectory.from_twist(start, linear=(8, 0, 0), angular=(0, 0, 0.3))
    mount = RigidTransform.from_components((1, 0, 2), Rotation.from_euler("y", 0.1))
    path = tmp_path / f"drive{suffix}"
    cloud.time[-1] = 0.0999
    with rosbag.Writer(path, sensors={"top": mount}, trajectory=drive, rate=50.0) as bag:
        for frame in range(3):
            bag.write_cloud(cloud, frame / 10)
    found = messages(path, ros)
    assert set(found) == {"/tf_static", "/tf", "/odom", "/clock", "/top/points"}
    ((_, static),) = found["/tf_static"]
    (fixed,) = static.transforms
    assert (fixed.header.frame_id, fixed.child_frame_id) == ("base_link", "top")
    translation, quaternion = fixed.transform.translation, fixed.transform.rotation
    assert (translation.x, translation.y, translation.z) == (1, 0, 2)
    turn = Rotation.from_quat([quaternion.x, quaternion.y, quaternion.z, quaternion.w])
    assert (turn * mount.rotation.inv()).magnitude() <= 2.0**-50  # quaternions round

    times = [START + round(tick * 1e9 / 50) for tick in range(15)]
    for topic in ("/tf", "/odom", "/clock"):
        assert [stamp for stamp, _ in found[topic]] == times
    assert [clock.clock.sec * 10**9 + clock.clock.nanosec for _, clock in found["/clock"]] == times
    for (stamp, odometry), (_, transforms) in zip(found["/odom"], found["/tf"], strict=True):
        pose = drive.at((stamp - START) / 1e9)
        assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "base_link")
        assert odometry.header.stamp.sec * 10**9 + odometry.header.stamp.nanosec == stamp
        where, facing = odometry.pose.pose.position, odometry.pose.pose.orientation
        # The pose and the quaternion round a few times.
        np.testing.assert_allclose([where.x, where.y, where.z], pose.translation, rtol=0, atol=2.0**-50 * 8)
        turned = Rotation.from_quat([facing.x, facing.y, facing.z, facing.w])
        assert (turned * pose.rotation.inv()).magnitude() <= 2.0**-50
        (moved,) = transforms.transforms
        assert (moved.header.frame_id, moved.child_frame_id) == ("map", "base_link")
        assert moved.transform.translation.x == where.x
        assert moved.transform.rotation.w == facing.w
        linear, angular = odometry.twist.twist.linear, odometry.twist.twist.angular
        # A velocity is turned into the axes of the body.
        np.testing.assert_allclose([linear.x, linear.y, linear.z], [8, 0, 0], rtol=0, atol=2.0**-50 * 8)
        np.testing.assert_allclose([angular.x, angular.y, angular.z], [0, 0, 0.3], rtol=0, atol=2.0**-50)

    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for _, message in found["/top/points"]]
    assert stamps == [START, START + 10**8, START + 2 * 10**8]
    recorded = [stamp for stamp, _ in found["/top/points"]]
    assert recorded == [stamp + 99_900_000 for stamp in stamps], "a cloud is there when its last point is"
    with Reader(path) as bag:
        latched = {
            connection.topic: connection.ext.offered_qos_profiles[0].durability for connection in bag.connections
        }
    assert latched["/tf_static"] is QosDurability.TRANSIENT_LOCAL
    assert latched["/tf"] is QosDurability.VOLATILE


def test_without_a_trajectory_or_beyond_its_end(cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    with rosbag.Writer(tmp_path / "still.mcap") as bag:
        bag.write_cloud(cloud)
    assert set(messages(tmp_path / "still.mcap", ros)) == {"/tf_static", "/clock", "/lidar/points"}
    short = ls.Trajectory([0.0, 0.035], [np.eye(4)] * 2)
    with rosbag.Writer(tmp_path / "short.mcap", trajectory=short) as bag:
        bag.write_cloud(cloud)
    assert len(messages(tmp_path / "short.mcap", ros)["/odom"]) == 4


def test_several_sensors(cloud: PointCloud, ros: Any, tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 20.0))
    lidar = ls.Lidar.preset("velodyne-vlp16")
    scans = {"left": lidar.scan(scene), "right": replace(lidar, model="ouster-like").scan(scene)}
    sensors = {"left": SimpleNamespace(mount=np.eye(4)), "right": RigidTransform.from_translation((0, 0, 1))}
    with rosbag.Writer(tmp_path / "drive.mcap", sensors=sensors, layout={"left": "hesai"}) as bag:
        bag.write(scans)
        bag.write_cloud(cloud, 0.1, sensor="left")
    found = messages(tmp_path / "drive.mcap", ros)
    ((_, static),) = found["/tf_static"]
    assert [transform.child_frame_id for transform in static.transforms] == ["left", "right"]
    assert [len(found[f"/{name}/points"]) for name in sensors] == [2, 1]
    assert [message.header.frame_id for _, message in found["/left/points"]] == ["left", "left"]
    assert found["/left/points"][0][1].fields[-1].name == "timestamp"
    assert found["/right/points"][0][1].fields[-1].name == "range"
    assert [message.topic for message in rosbag.read(tmp_path / "drive.mcap", topic="/left/points")] == [
        "/left/points"
    ] * 2


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_a_cloud_comes_back_in_the_vendors_units(suffix: str, cloud: PointCloud, tmp_path: Path) -> None:
    for layout, fields in {
        "velodyne": {"xyz", "intensity", "time", "ring"},
        "ouster": {"xyz", "intensity", "time", "ring", "range", "reflectivity", "ambient"},
        "hesai": {"xyz", "intensity", "time", "ring"},
        "autoware": {"xyz", "intensity", "time", "ring", "azimuth", "elevation", "distance", "return_type"},
    }.items():
        with rosbag.Writer(tmp_path / f"a{suffix}", layout=layout) as bag:
            bag.write_cloud(cloud, 7.25)
        loaded = PointCloud.load(tmp_path / f"a{suffix}")
        assert set(loaded.fields) == fields
        np.testing.assert_array_equal(loaded.xyz, cloud.xyz.astype(np.float32))
        np.testing.assert_array_equal(loaded.intensity, np.rint(100 * cloud.intensity))
        np.testing.assert_array_equal(loaded.ring, cloud.ring)
        # Half an ulp of float32 below 0.125 s; of float64 at 1.6e9 s; and half a nanosecond.
        atol = {"velodyne": 2.0**-28, "hesai": 2.0**-23 + 0.5e-9}.get(layout, 0.5e-9) + np.spacing(0.1)
        np.testing.assert_allclose(loaded.time, cloud.time, rtol=0, atol=atol)
        if layout == "ouster":
            np.testing.assert_allclose(loaded.range, cloud.range, rtol=0, atol=0.5e-3 + np.spacing(50.0))


def test_saving_and_loading_one_cloud(cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / "a.mcap")
    cloud.save(tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert len(PointCloud.load(tmp_path / "a.mcap")) == COUNT
    with rosbag.Writer(tmp_path / "a.mcap") as bag:
        bag.write_cloud(cloud)
        bag.write_cloud(cloud, 0.1)
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(tmp_path / "a.mcap")
    reason = "it holds several clouds: read them one by one with lidarsim.io.rosbag.read"
    assert str(caught.value) == f"{tmp_path / 'a.mcap'}: not a readable .mcap point cloud: {reason}"


ODD = ["a%41.db3", "100%.db3", "really?.db3", "take#2.db3", "a b\nc.db3"]


@pytest.mark.parametrize("name", ODD + ["a\udcff.db3"] * (sys.platform == "linux"))
def test_names_that_mean_something_in_a_uri(
    name: str, cloud: PointCloud, ros: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """rosbags opens the file ``a%41.db3`` as ``aA.db3``, which is another."""
    monkeypatch.chdir(tmp_path)
    PointCloud(xyz=[[9, 9, 9]]).save("aA.db3")
    cloud.save(name)
    shutil.copy(name, "plain.db3")
    (message,) = messages(Path("plain.db3"), ros)["/lidar/points"]
    assert message[1].width == COUNT
    assert len(PointCloud.load(name)) == len(next(rosbag.read(tmp_path / name)).cloud) == COUNT

    def refuse(*_: object) -> None:
        raise OSError(1314, "A required privilege is not held by the client")

    monkeypatch.setattr(Path, "symlink_to", refuse)
    with pytest.raises(FileFormatError, match=r"expected a plain path that ends in \.db3, since links cannot be made"):
        PointCloud.load(name)
    assert len(PointCloud.load("plain.db3")) == COUNT


@pytest.mark.parametrize(
    ("suffix", "name"), [(".mcap", "a.bin"), (".mcap", "a.db3"), (".db3", "a.mcap"), (".db3", "a.xyz")]
)
def test_a_bag_is_known_by_its_signature(suffix: str, name: str, cloud: PointCloud, tmp_path: Path) -> None:
    cloud.save(tmp_path / f"b{suffix}")
    (tmp_path / f"b{suffix}").rename(tmp_path / name)
    assert len(PointCloud.load(tmp_path / name)) == COUNT
    assert len(next(rosbag.read(tmp_path / name)).cloud) == COUNT


def write_bag(path: Path, ros: Any, *entries: tuple[str, str, Any], compress: CompressionMode | None = None) -> Path:
    """Write messages by rosbags alone, and return the file."""
    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    writer = BagWriter(path.with_suffix(""), version=8, storage_plugin=plugin)
    if compress:
        writer.set_compression(compress, CompressionFormat.ZSTD)
    with writer:
        for topic, kind, message in entries:
            connection = writer.add_connection(topic, kind, typestore=ros)
            writer.write(connection, 5, ros.serialize_cdr(message, kind))
    (file,) = path.with_suffix("").glob(f"*{path.suffix}")
    return file


def point_cloud(ros: Any, records: np.ndarray, **changes: Any) -> Any:
    """Return a PointCloud2 of records, with any of its parts changed."""
    codes = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    fields = []
    for name, (part, offset) in records.dtype.fields.items():
        count = int(np.prod(part.shape, dtype=int))
        fields.append(ros.types["sensor_msgs/msg/PointField"](name, offset, codes[part.base.str[1:]], count))
    header = ros.types["std_msgs/msg/Header"](ros.types["builtin_interfaces/msg/Time"](3, 500_000_000), "map")
    parts = {
        "header": header,
        "height": 1,
        "width": len(records),
        "fields": fields,
        "is_bigendian": False,
        "point_step": records.dtype.itemsize,
        "row_step": records.nbytes,
        "data": np.frombuffer(records.tobytes(), np.uint8),
        "is_dense": True,
    }
    return ros.types[CLOUD](**(parts | changes))


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_we_read_any_point_cloud(suffix: str, big: bool, ros: Any, tmp_path: Path) -> None:
    order = ">" if big else "<"
    dtype = np.dtype(
        {
            "names": ["x", "y", "z", "rgb", "timestamp", "descriptor"],
            "formats": [f"{order}f8", f"{order}f8", f"{order}f8", f"{order}u4", f"{order}f8", (f"{order}f4", (3,))],
            "offsets": [0, 8, 16, 28, 40, 48],
            "itemsize": 64,
        }
    )
    records = np.zeros(4, dtype)
    records["x"], records["rgb"], records["timestamp"] = [1, 2, np.nan, 4], 7, 3.75
    records["descriptor"] = [[1, 2, 3]] * 4
    message = point_cloud(ros, records, is_bigendian=big, height=2, width=2, row_step=128, is_dense=False)
    (read,) = rosbag.read(write_bag(tmp_path / f"other{suffix}", ros, ("/points", CLOUD, message)))
    assert (read.topic, read.frame_id, read.stamp) == ("/points", "map", 3_500_000_000)
    assert read.cloud.fields == ("xyz", "time", "descriptor", "rgb")
    np.testing.assert_array_equal(read.cloud.xyz[:, 0], [1, 2, np.nan, 4])
    assert read.cloud.rgb.tolist() == [7] * 4
    assert read.cloud.time.tolist() == [0.25] * 4
    assert read.cloud.descriptor.tolist() == [[1, 2, 3]] * 4


THREE = np.zeros(2, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"width": 2**32 - 1}, "4294967295 × 1 points of 12 bytes have 24 together"),
        ({"width": 2**31, "height": 2**31}, "2147483648 × 2147483648 points of 12 bytes have 24 together"),
        ({"point_step": 0, "row_step": 0}, "2 × 1 points of 0 bytes have 24 together"),
        (
            {"point_step": 0, "row_step": 0, "data": np.empty(0, np.uint8)},
            "its field x ends outside a point of 0 bytes",
        ),
        ({"point_step": 8, "width": 3}, "its field z ends outside a point of 8 bytes"),
        ({"fields": [("x", 0, 9, 1)]}, "its field x has the unknown type 9"),
        ({"fields": [("x", 0, 7, 10**9)]}, "its field x ends outside a point of 12 bytes"),
        ({"fields": [("x", 0, 7, 1), ("y", 4, 7, 1)]}, "it has no z among its fields x, y"),
        ({"fields": [("x", 0, 7, 1)] * 2}, "it has two fields named 'x'"),
    ],
)
def test_hostile_point_clouds(changes: dict[str, Any], reason: str, ros: Any, tmp_path: Path) -> None:
    if "fields" in changes:
        new = ros.types["sensor_msgs/msg/PointField"]
        changes = {"fields": [new(*field) for field in changes["fields"]]}
    path = write_bag(tmp_path / "bad.mcap", ros, ("/points", CLOUD, point_cloud(ros, THREE, **changes)))
    with pytest.raises(FileFormatError) as caught:
        list(rosbag.read(path))
    assert str(caught.value) == f"{path}: not a readable ROS 2 bag: {reason}"


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_messages_that_are_no_clouds(suffix: str, ros: Any, tmp_path: Path) -> None:
    clock = ros.types["rosgraph_msgs/msg/Clock"](ros.types["builtin_interfaces/msg/Time"](1, 2))
    path = write_bag(tmp_path / f"clock{suffix}", ros, ("/clock", "rosgraph_msgs/msg/Clock", clock))
    with pytest.raises(FileFormatError) as caught:
        PointCloud.load(path)
    reason = "it has no point clouds; its topics are /clock (rosgraph_msgs/msg/Clock)"
    assert str(caught.value) == f"{path}: not a readable {suffix} point cloud: {reason}"
    path = write_bag(
        tmp_path / f"both{suffix}",
        ros,
        ("/clock", "rosgraph_msgs/msg/Clock", clock),
        ("/points", CLOUD, point_cloud(ros, THREE)),
    )
    assert len(PointCloud.load(path)) == 2
    with pytest.raises(FileFormatError, match="it has no point clouds under /clock; its topics are /clock"):
        list(rosbag.read(path, topic="/clock"))
    with pytest.raises(FileFormatError, match="it has no point clouds under /none; its topics are"):
        list(rosbag.read(path, topic="/none"))


def test_compressed_bags(ros: Any, tmp_path: Path) -> None:
    message = point_cloud(ros, THREE)
    path = write_bag(tmp_path / "small.mcap", ros, ("/points", CLOUD, message), compress=CompressionMode.STORAGE)
    assert len(PointCloud.load(path)) == 2
    content = path.read_bytes()
    assert b"zstd" in content
    path.write_bytes(content.replace(b"zstd", b"zzzz"))
    with pytest.raises(FileFormatError, match="its chunks are compressed by 'zzzz', expected zstd or lz4"):
        PointCloud.load(path)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_we_read_what_mcap_writes(compression: CompressionType, ros: Any, tmp_path: Path) -> None:
    message = point_cloud(ros, np.zeros(2000, THREE.dtype))
    definition, _ = ros.generate_msgdef(CLOUD, ros_version=2)
    path = tmp_path / "other.mcap"
    writer = McapWriter(str(path), compression=compression)
    writer.start(profile="ros2", library="")
    schema = writer.register_schema(CLOUD, "ros2msg", definition.encode())
    channel = writer.register_channel("/points", "cdr", schema)
    writer.add_message(channel, 5, bytes(ros.serialize_cdr(message, CLOUD)), 5)
    writer.finish()
    content = path.read_bytes()
    (read,) = rosbag.read(path)
    assert (read.topic, len(read.cloud)) == ("/points", 2000)
    if compression is CompressionType.NONE:
        place = content.index(b"PointCloud2") + 20_000
        path.write_bytes(content[:place] + b"\1" + content[place + 1 :])
        with pytest.raises(FileFormatError, match="a chunk is damaged"):
            list(rosbag.read(path))


def test_a_bomb(ros: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    message = point_cloud(ros, np.zeros(200_000, THREE.dtype))
    path = write_bag(tmp_path / "zeros.mcap", ros, ("/points", CLOUD, message), compress=CompressionMode.STORAGE)
    assert len(PointCloud.load(path)) == 200_000
    content = path.read_bytes()
    assert len(content) < 2_400_000 // 100
    monkeypatch.setattr(_records, "SMALL", 1 << 16)
    with pytest.raises(FileFormatError, match="refused as a decompression bomb"):
        PointCloud.load(path)
    size = content.index(b"zstd") - 8 - 4 - 4 + 4  # before the checksum and the length of the name
    changed = bytearray(content)
    changed[size - 4 : size + 4] = (1000).to_bytes(8, "little")
    path.write_bytes(changed)
    tracemalloc.start()
    with pytest.raises(FileFormatError, match="a chunk is damaged: it claims 1,000 bytes"):
        PointCloud.load(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000, "it is not decompressed to its 2.4 MB"


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_no_part_of_a_bag_is_taken_for_a_whole(suffix: str, cloud: PointCloud, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    cloud.save(path)
    content, refused = path.read_bytes(), 0
    for size in range(0, len(content), 211):
        path.write_bytes(content[:size])
        try:
            loaded = PointCloud.load(path)
        except FileFormatError:
            refused += 1
        else:  # what follows the messages may be missing: an index, a page of SQLite
            np.testing.assert_array_equal(loaded.xyz, cloud.xyz.astype(np.float32))
            np.testing.assert_array_equal(loaded.ring, cloud.ring)
    data = COUNT * rosbag.LAYOUTS["velodyne"].itemsize
    assert refused > data // 211


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda cloud, bag: bag.write_cloud(cloud, sensor="roof"), "sensor: expected one of a, b, got 'roof'"),
        (lambda cloud, bag: bag.write_cloud(cloud), "sensor: expected the name of one of a, b, got none"),
        (lambda cloud, bag: bag.write_cloud(cloud, -1e10, sensor="a"), "time: expected a time from 1970 to 2038"),
        (lambda cloud, bag: bag.write_cloud(cloud, np.nan, sensor="a"), "time: expected a finite number, got nan"),
        (
            lambda cloud, bag: [bag.write_cloud(cloud, time, sensor=name) for time in (0.2, 0.1) for name in "ab"],
            r"time: expected a frame of 'a' after 0\.2 s, got one at 0\.1 s; Lidar\.scan\(…, time=\) sets it",
        ),
    ],
)
def test_bad_calls(use: Callable[[PointCloud, Any], None], message: str, cloud: PointCloud, tmp_path: Path) -> None:
    sensors = {"a": np.eye(4), "b": np.eye(4)}
    with pytest.raises(ValueError, match=message), rosbag.Writer(tmp_path / "a.mcap", sensors=sensors) as bag:
        use(cloud, bag)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda bag: bag.write(iter([])), "scans: expected a Scan, or Scans by name, got <list_iter"),
        (
            lambda bag: bag.write({"lidar": PointCloud(np.zeros((1, 3)))}),
            "scans: expected a Scan, or Scans by name, got",
        ),
        (lambda bag: bag.write_cloud(np.zeros((1, 3))), "cloud: expected a PointCloud, got an array"),
        (lambda bag: bag.write_imu(ls.Imu(10.0)), "samples: expected ImuSamples, got"),
        (lambda bag: bag.write_gnss(ls.Gnss(10.0)), "fixes: expected GnssFixes, got"),
    ],
)
def test_what_is_written_has_its_type(use: Callable[[Any], None], message: str, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=message), rosbag.Writer(tmp_path / "a.mcap") as bag:
        use(bag)
    lidar: Any = ls.Lidar.preset("velodyne-vlp16")
    with pytest.raises(TypeError, match="sensors: expected mounts by name, or a Rig, got"):
        rosbag.Writer(tmp_path / "a.mcap", sensors=lidar)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("layout", rosbag.LAYOUTS)
@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"xyz": [[1, 2, 3], [4, 1e39, 6]]}, r"y: expected numbers that float32 can hold, got y\[1\] = 1e\+39"),
        ({"intensity": [1, np.nan]}, r"intensity: expected numbers from 0 to inf, got intensity\[1\] = nan"),
        ({"intensity": [1, -0.5]}, r"intensity: expected numbers from 0 to inf, got intensity\[1\] = -0\.5"),
    ],
)
def test_no_number_becomes_another_silently(layout: str, fields: dict[str, Any], message: str, tmp_path: Path) -> None:
    lost = PointCloud({"xyz": [[1, 2, 3], [4, 5, 6]], **fields})
    with pytest.raises(FileFormatError, match=message), rosbag.Writer(tmp_path / "a.mcap", layout=layout) as bag:
        bag.write_cloud(lost)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": "a.bag"}, r"a.bag: unknown extension '.bag', expected .db3 or .mcap"),
        (
            {"sensors": {"/top": np.eye(4)}},
            r"sensors: expected a name of ASCII letters, digits and _ that .*, got '/top'",
        ),
        ({"sensors": {"1top": np.eye(4)}}, r"sensors: expected a name of .* that begins with a letter, got '1top'"),
        ({"sensors": {"top": np.zeros((4, 4))}}, r"sensors\['top'\]: expected a last row of"),
        (
            {"layout": "pandar"},
            "layout: expected one of velodyne, ouster, hesai, autoware, livox, livox_cloud, laserscan, got 'pandar'",
        ),
        ({"layout": {"top": "hesai"}}, "layout: expected names of the sensors lidar, got 'top'"),
        ({"rate": 0}, "rate: expected a finite number > 0, got 0"),
        ({"start": -1}, "start: expected a moment from 1970-01-01 to 2038-01-19 UTC, got -1 s since 1970"),
        ({"start": 2**31}, "start: expected a moment from 1970-01-01 to 2038-01-19 UTC, got 2147483648 s"),
        ({"start": datetime(2026, 5, 1)}, "start: expected a datetime with a time zone, got 2026-05-01T00:00:00"),
        (
            {"start": datetime(1969, 12, 31, tzinfo=UTC)},
            r"start: expected a moment from 1970-01-01 to 2038-01-19 UTC, got 1969-12-31T00:00:00\+00:00",
        ),
        (
            {"start": datetime(2038, 1, 19, 3, 14, 8, tzinfo=UTC)},
            r"start: expected a moment from 1970-01-01 to 2038-01-19 UTC, got 2038-01-19T03:14:08\+00:00",
        ),
        ({"world": ""}, "world: expected a name of ASCII letters, digits and _ that .*, got ''"),
        ({"trajectory": np.zeros((4, 4))}, "trajectory: expected a last row of"),
    ],
)
def test_bad_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rosbag.Writer(**({"path": "a.mcap"} | arguments))


@pytest.mark.parametrize(
    ("layout", "fields", "message"),
    [
        ("livox", {"ring": [0, 256]}, "ring: expected 0 to 255 for line in the livox layout, got ring[1] = 256"),
        (
            "ouster",
            {"time": [0, 5]},
            "time in ns: expected 0 to 4294967295 for t in the ouster layout, got time in ns[1]",
        ),
        ("autoware", {"time": [-1, 0]}, "time in ns: expected 0 to 4294967295 for time_stamp in the autoware layout"),
        ("ouster", {"range": [1e7, 0]}, "range in mm: expected 0 to 4294967295 for range in the ouster layout"),
    ],
)
def test_what_does_not_fit(layout: str, fields: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"old")
    with pytest.raises(FileFormatError) as caught, rosbag.Writer(path, layout=layout) as bag:
        bag.write_cloud(PointCloud(xyz=np.ones((2, 3)), **fields))
    assert str(caught.value).startswith(message)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_a_full_disk_leaves_the_old_file(suffix: str, cloud: PointCloud, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource", reason="Windows has no limit on the size of a file")
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, hard))
    try:
        with pytest.raises(OSError, match=r"cannot be written") as caught, rosbag.Writer(path) as bag:  # noqa: PT012
            for frame in range(100):
                bag.write_cloud(cloud, frame / 10)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    reason = "File too large" if suffix == ".mcap" else "disk I/O error"
    assert str(caught.value) == f"{path}: cannot be written: {reason}"
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failing_block_leaves_nothing(cloud: PointCloud, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), rosbag.Writer(tmp_path / "a.mcap") as bag:  # noqa: PT012
        bag.write_cloud(cloud)
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="expected to be written in a with block"):
        bag.write_cloud(cloud)
    with pytest.raises(FileNotFoundError, match="does not exist"), rosbag.Writer(tmp_path / "none" / "a.mcap"):
        pass


def test_a_bag_without_clouds_is_a_bag(ros: Any, tmp_path: Path) -> None:
    with rosbag.Writer(tmp_path / "a.mcap"):
        pass
    assert messages(tmp_path / "a.mcap", ros) == {}


def test_without_the_extra(cloud: PointCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rosbag._typestore.cache_clear()
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(MissingExtraError) as caught:
        cloud.save(tmp_path / "a.mcap")
    assert str(caught.value) == 'ROS bags needs rosbags.typesys: pip install "lidarsim[formats]"'
    assert not list(tmp_path.iterdir())


STAMP = 1_700_000_000_123_456_789
XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]


def cloud_message(ros: Any, records: np.ndarray, stamp: int = STAMP, **changes: Any) -> Any:
    header = ros.types["std_msgs/msg/Header"](ros.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "map")
    return point_cloud(ros, records, header=header, **changes)


def read_back(path: Path, ros: Any, message: Any) -> PointCloud:
    (read,) = rosbag.read(write_bag(path / "a.mcap", ros, ("/points", CLOUD, message)))
    return read.cloud


SECONDS = STAMP / 1e9


@pytest.mark.parametrize(
    ("field", "values"),
    [
        # as FORMATS of drivers have them, see lidarsim.io._times
        (("time", "<f4"), [0.0, 0.05]),
        (("t", "<u4"), [0, 50_000_000]),
        (("timestamp", "<f8"), [SECONDS, SECONDS + 0.05]),
        (("timestamp", "<f8"), [float(STAMP), float(STAMP + 50_000_000)]),
        (("offset_time", "<u4"), [0, 50_000_000]),
        (("time_stamp", "<u4"), [0, 50_000_000]),
        # others
        (("time", ">f4"), [0.0, 0.05]),
        (("time", "<f8"), [0.0, 0.05]),
        (("time", "<f8"), [SECONDS, SECONDS + 0.05]),
        (("time", "<u4"), [0, 50_000_000]),
        (("time", "<f4"), [0.0, 50.0]),
        (("time", "<f4"), [0.0, 5e4]),
        (("time", "<f4"), [0.0, 5e7]),
        (("t", "<f4"), [0.0, 0.05]),
        (("t", "<f8"), [0.0, 5e7]),
        (("timestamp", "<f4"), [0.0, 0.05]),
        (("timestamp", "<f8"), [0.0, 0.05]),
        (("timestamp", "<f8"), [SECONDS * 1e3, SECONDS * 1e3 + 50]),
        (("timestamp", "<f8"), [SECONDS * 1e6, SECONDS * 1e6 + 5e4]),
        (("timeStamp", "<f8"), [SECONDS, SECONDS + 0.05]),
        (("offset_time", "<f4"), [0.0, 5e7]),
        (("time_offset", "<u4"), [0, 50_000_000]),
    ],
)
def test_times_of_points_in_any_unit(field: tuple[str, str], values: list[float], ros: Any, tmp_path: Path) -> None:
    big = field[1].startswith(">")
    types = [(name, code.replace("<", ">") if big else code) for name, code in [*XYZ, field]]
    records = np.array([(1, 2, 3, value) for value in values], types)
    cloud = read_back(tmp_path, ros, cloud_message(ros, records, is_bigendian=big))
    assert cloud.fields == ("xyz", "time")
    # float64 has steps of 0.24 µs at 1.7e9 s, and of 0.26 µs at 1.7e18 ns
    assert np.abs(cloud.time - [0.0, 0.05]).max() < 1e-6


def test_times_before_the_stamp_and_of_points_without_one(ros: Any, tmp_path: Path) -> None:
    late = np.array([(1, 2, 3, -0.1), (1, 2, 3, 0.0)], [*XYZ, ("time", "<f4")])
    assert read_back(tmp_path, ros, cloud_message(ros, late)).time.tolist() == [float(np.float32(-0.1)), 0.0]
    zeros = np.array([(0, 0, 0, 0.0), (1, 2, 3, SECONDS + 0.05)], [*XYZ, ("timestamp", "<f8")])
    (tmp_path / "zeros").mkdir()
    first, second = read_back(tmp_path / "zeros", ros, cloud_message(ros, zeros)).time
    assert np.isnan(first)
    assert abs(second - 0.05) < 1e-6


@pytest.mark.parametrize(
    ("field", "values", "stamp", "expected"),
    [
        (("timestamp", "<f8"), [100.5, 100.55], 100_500_000_000, [0.0, 0.05]),  # a clock that began with the sensor
        (("timestamp", "<f8"), [0.0, 0.05], 100_500_000_000, [0.0, 0.05]),
        (("time", "<f4"), [0.0, 0.05], 10_000_000, [0.0, 0.05]),
        (("time", "<f8"), [0.0, 0.05], 10_000_000, [0.0, 0.05]),
        (("timestamp", "<f8"), [SECONDS + 3600, SECONDS + 3600.05], STAMP, [3600.0, 3600.05]),
    ],
)
def test_times_of_points_by_other_clocks(
    field: tuple[str, str], values: list[float], stamp: int, expected: list[float], ros: Any, tmp_path: Path
) -> None:
    records = np.array([(1, 2, 3, value) for value in values], [*XYZ, field])
    assert np.abs(read_back(tmp_path, ros, cloud_message(ros, records, stamp)).time - expected).max() < 1e-6


@pytest.mark.parametrize(
    ("field", "values", "message"),
    [
        (("time", "<f4"), [0.0, 5e3], "its field time has times from 5000 to 5000, in no unit that fits the stamp"),
        (("t", "<f4"), [SECONDS, SECONDS], "its field t has times from 1700000000 to 1700000000, in no unit that fits"),
        (("timestamp", "<f8"), [1e8, 4e9], "its field timestamp has times from 100000000 to 4000000000, in no unit"),
        (("time", "<u2"), [0, 5], "its field time has the type uint16, expected one number of 32 or 64 bits"),
        (("time", "<u4", 2), [[0, 1], [5, 6]], "its field time has the type uint32, expected one number of 32 or"),
        (("timestamp", "<u4"), [1_700_000_000] * 2, "its field timestamp has whole seconds since 1970"),
    ],
)
def test_times_of_points_in_no_unit(
    field: tuple[Any, ...], values: list[Any], message: str, ros: Any, tmp_path: Path
) -> None:
    records = np.array([(1, 2, 3, value) for value in values], [*XYZ, field])
    with pytest.raises(FileFormatError, match=re.escape(message)):
        read_back(tmp_path, ros, cloud_message(ros, records))


def test_long_frames_keep_their_seconds(tmp_path: Path) -> None:
    cloud = PointCloud(xyz=np.ones((2, 3)), time=np.array([0.0, 250.0]))
    for suffix in rosbag.SUFFIXES:
        cloud.save(tmp_path / f"a{suffix}")
        assert PointCloud.load(tmp_path / f"a{suffix}").time.tolist() == [0.0, 250.0]


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("claimed", [True, False])
@pytest.mark.parametrize("last", [True, False])
@pytest.mark.parametrize("height", [1, 3])
def test_rows_of_clouds(padding: int, claimed: bool, last: bool, height: int, ros: Any, tmp_path: Path) -> None:
    records = np.zeros((height, 4), XYZ)
    records["x"] = np.arange(height * 4).reshape(height, 4)
    records["z"][0, 1] = np.nan
    data = b"".join(row.tobytes() + bytes(padding) for row in records)
    if padding and not last:
        data = data[:-padding]
    step = (4 * 12 + padding) if claimed or padding else 0
    message = cloud_message(
        ros,
        records.reshape(-1),
        width=4,
        height=height,
        row_step=step,
        data=np.frombuffer(data, np.uint8),
        is_dense=False,
    )
    cloud = read_back(tmp_path, ros, message)
    assert cloud.xyz[:, 0].tolist() == list(range(4 * height))
    assert np.isnan(cloud.xyz[1, 2])


@pytest.mark.parametrize("order", "<>")
def test_types_of_fields(order: str, ros: Any, tmp_path: Path) -> None:
    types = [(axis, f"{order}f8") for axis in "xyz"]
    types += [("intensity", f"{order}u2"), ("ring", "u1"), ("range", f"{order}f4"), ("tag", f"{order}i2")]
    records = np.array([(5e6, 1 / 3, 2.0, 300, 7, 2.5, -3), (0, 0, 1, 0, 1, 0.5, 0)], types)
    cloud = read_back(tmp_path, ros, cloud_message(ros, records, is_bigendian=order == ">"))
    assert cloud.xyz.tolist() == [[5e6, 1 / 3, 2.0], [0, 0, 1]]
    assert (cloud.intensity.dtype, cloud.intensity.tolist()) == (np.float32, [300, 0])
    assert (cloud.ring.dtype, cloud.ring.tolist()) == (np.uint16, [7, 1])
    assert cloud.range.tolist() == [2.5, 0.5]
    assert cloud.tag.tolist() == [-3, 0]


def test_clouds_of_no_points(ros: Any, tmp_path: Path) -> None:
    records = np.zeros(0, [*XYZ, ("intensity", "u1"), ("timestamp", "<f8")])
    cloud = read_back(tmp_path, ros, cloud_message(ros, records))
    assert (len(cloud), cloud.fields) == (0, ("xyz", "intensity", "time"))


def test_an_older_rosbags_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    PointCloud(xyz=np.ones((1, 3))).save(path)
    monkeypatch.setattr("importlib.metadata.version", lambda _: "0.9.23")
    rosbag._typestore.cache_clear()
    message = r"ROS bags need rosbags 0\.11 or newer, got 0\.9\.23"
    for call in (lambda: list(rosbag.read(path)), lambda: rosbag.Writer(path), lambda: PointCloud.load(path)):
        with pytest.raises(MissingExtraError, match=message):
            call()


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
@pytest.mark.parametrize("clockwise", [False, True])
def test_scans_of_2d_lidars_are_laser_scans(clockwise: bool, suffix: str, ros: Any, tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Polygon([(3, -9, -1), (3, 9, -1), (3, 9, 1), (3, -9, 1)]))
    pattern = ls.patterns.Spinning([0.0], columns=360, rate=10.0, clockwise=clockwise)
    lidar = ls.Lidar(pattern, min_range=0.1, max_range=8.0)
    scans = [lidar.scan(scene, time=frame / 10, frame=frame) for frame in range(2)]
    path = tmp_path / f"drive{suffix}"
    with rosbag.Writer(path, layout="laserscan", start=100.0) as bag:
        for scan in scans:
            bag.write(scan)
        with pytest.raises(ValueError, match=r"after 0\.1 s, got one at 0\.1 s"):
            bag.write(scans[1])
    found = messages(path, ros)["/lidar/scan"]
    assert len(found) == 2
    for (recorded, message), scan in zip(found, scans, strict=True):
        right = scan.laser_scan()
        assert message.header.frame_id == "lidar"
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        assert stamp == round((100.0 + right.time) * 1e9)
        assert recorded == round((100.0 + scan.time + scan.pulses.time[-1]) * 1e9)
        for name in ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min"):
            assert getattr(message, name) == np.float32(getattr(right, name))
        np.testing.assert_array_equal(message.ranges, right.ranges)
        np.testing.assert_array_equal(message.intensities, right.intensities)
        assert np.isinf(message.ranges).any()
    clouds = [message.cloud for message in rosbag.read(path)]
    for cloud, scan in zip(clouds, scans, strict=True):
        order = slice(None, None, -1) if clockwise else slice(None)
        points = scan.point_cloud()[order]
        assert len(cloud) == len(points) > 100
        # Ranges below 8 m and angles below 4 rad are float32, the latter with the step times up to 360.
        np.testing.assert_allclose(cloud.xyz, points.xyz, atol=8 * 361 * 2.0**-23)
        # The step in time is float32, too, and a stamp whole nanoseconds.
        near = 2.0**-24 * 0.1 + 1e-9
        np.testing.assert_allclose(cloud.time, points.time - scan.pulses.time[order][0], rtol=0, atol=near)
        np.testing.assert_array_equal(cloud.intensity, points.intensity)


def test_laser_scans_are_refused_of_other_sensors_and_of_clouds(cloud: PointCloud, tmp_path: Path) -> None:
    scan = ls.Lidar.preset("velodyne-vlp16").scan(ls.Scene())
    with (
        pytest.raises(ValueError, match="scan: expected one of a 2D lidar"),
        rosbag.Writer(tmp_path / "a.mcap", layout="laserscan") as bag,
    ):
        bag.write(scan)
    with (
        pytest.raises(ValueError, match="layout: expected one of point clouds, or scans by `write`"),
        rosbag.Writer(tmp_path / "a.mcap", layout="laserscan") as bag,
    ):
        bag.write_cloud(cloud)
    with pytest.raises(ValueError, match="expected to be written in a with block"):
        rosbag.Writer(tmp_path / "a.mcap", layout="laserscan").write(ls.Lidar.preset("sick-lms111").scan(ls.Scene()))
    assert not any(tmp_path.iterdir())


COMPRESSED = [(plugin, mode) for plugin in StoragePlugin for mode in (CompressionMode.FILE, CompressionMode.MESSAGE)]


def compress(folder: Path, ros: Any, plugin: StoragePlugin, mode: CompressionMode, *clouds: Any) -> Path:
    """The bag of some clouds as the recorder compresses it."""
    writer = BagWriter(folder, version=8, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/points", CLOUD, typestore=ros)
        for time, message in enumerate(clouds):
            writer.write(connection, time, ros.serialize_cdr(message, CLOUD))
    return folder


@pytest.mark.parametrize(("plugin", "mode"), COMPRESSED)
def test_bags_that_the_recorder_compresses(
    plugin: StoragePlugin, mode: CompressionMode, ros: Any, tmp_path: Path
) -> None:
    clouds = [point_cloud(ros, THREE), point_cloud(ros, np.zeros(2000, THREE.dtype))]
    folder = compress(tmp_path / "bag", ros, plugin, mode, *clouds)
    (file,) = (path for path in folder.iterdir() if path.suffix != ".yaml")
    assert (file.suffix == ".zstd") == (mode is CompressionMode.FILE)
    for path in (folder, file):
        assert [len(message.cloud) for message in rosbag.read(path)] == [2, 2000]
    assert rosbag.is_bag(file)
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("zstd\n", "lzma\n"))
    with pytest.raises(FileFormatError, match="it is compressed by 'lzma', expected zstd or no compression"):
        list(rosbag.read(folder))


@pytest.mark.parametrize(("plugin", "mode"), COMPRESSED)
def test_bombs_of_the_recorder(
    plugin: StoragePlugin, mode: CompressionMode, ros: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = compress(tmp_path / "bag", ros, plugin, mode, point_cloud(ros, np.zeros(400_000, THREE.dtype)))
    assert len(next(rosbag.read(folder)).cloud) == 400_000
    monkeypatch.setattr(_records, "SMALL", 1 << 16)
    with pytest.raises(FileFormatError, match="refused as a decompression bomb"):
        list(rosbag.read(folder))


def test_a_truncated_compressed_file(ros: Any, tmp_path: Path) -> None:
    folder = compress(tmp_path / "bag", ros, StoragePlugin.MCAP, CompressionMode.FILE, point_cloud(ros, THREE))
    (file,) = folder.glob("*.zstd")
    file.write_bytes(file.read_bytes()[:-9])
    with pytest.raises(FileFormatError, match="not a readable ROS 2 bag"):
        list(rosbag.read(folder))


def test_a_message_whose_compression_is_damaged_is_left_out(ros: Any, tmp_path: Path) -> None:
    clouds = [point_cloud(ros, THREE), point_cloud(ros, THREE)]
    folder = compress(tmp_path / "bag", ros, StoragePlugin.MCAP, CompressionMode.MESSAGE, *clouds)
    (file,) = folder.glob("*.mcap")
    data = bytearray(file.read_bytes())
    at = data.index(b"\x28\xb5\x2f\xfd")
    data[at + 4 : at + 40] = bytes(36)
    file.write_bytes(data)
    with pytest.warns(UserWarning, match="a cloud of /points is left out"):
        assert len(list(rosbag.read(folder))) == 1


def test_odd_clouds_do_not_stop_the_others(ros: Any, tmp_path: Path) -> None:
    flat = np.zeros(2, [("range", "<f4"), ("speed", "<f4")])
    good, odd = point_cloud(ros, THREE), point_cloud(ros, flat)
    sent = [("/radar", odd), ("/points", good), ("/radar", odd), ("/mixed", good), ("/mixed", odd), ("/points", good)]
    with BagWriter(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {topic: writer.add_connection(topic, CLOUD, typestore=ros) for topic in dict(sent)}
        for time, (topic, message) in enumerate(sent):
            writer.write(topics[topic], time, ros.serialize_cdr(message, CLOUD))
    path = tmp_path / "bag" / "bag.mcap"
    with pytest.warns(UserWarning, match="left out") as caught:
        read = [message.topic for message in rosbag.read(path)]
    assert read == ["/points", "/mixed", "/points"]
    reason = "is left out: it has no x among its fields range, speed"
    assert sorted(str(warning.message) for warning in caught) == sorted(
        f"{path}: {text}"
        for text in (
            f"a cloud of /radar {reason}",
            f"a cloud of /mixed {reason}",
            "2 of 2 clouds of /radar are left out",
        )
    )
    assert {warning.filename for warning in caught} == {__file__}
    with pytest.raises(FileFormatError, match="it has no x among its fields range, speed"):
        list(rosbag.read(path, topic="/radar"))


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3"])
def test_bags_of_ros_1_are_told_apart(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(b"#ROSBAG V2.0\nE\0\0\0")
    for read in (PointCloud.load, lambda path: list(rosbag.read(path))):
        with pytest.raises(FileFormatError, match="bags of ROS 1 are not read; convert it: rosbags-convert --src"):
            read(path)
