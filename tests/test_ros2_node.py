"""The node of ROS 2: what it publishes, to stand-ins for ROS's packages, which take the same arguments."""

from __future__ import annotations

import runpy
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.io import rosbag

NODE = Path(__file__).parents[1] / "examples" / "ros2_node.py"
SLOTS = {
    "builtin_interfaces.msg.Time": "sec nanosec",
    "geometry_msgs.msg.Quaternion": "x y z w",
    "geometry_msgs.msg.Vector3": "x y z",
    "geometry_msgs.msg.Transform": "translation rotation",
    "geometry_msgs.msg.TransformStamped": "header child_frame_id transform",
    "rosgraph_msgs.msg.Clock": "clock",
    "sensor_msgs.msg.PointCloud2": "header height width fields is_bigendian point_step row_step data is_dense",
    "sensor_msgs.msg.PointField": "name offset datatype count",
    "std_msgs.msg.Header": "stamp frame_id",
    "tf2_msgs.msg.TFMessage": "transforms",
}
"""Fields of the messages, from the definitions of ROS 2's common_interfaces, rcl_interfaces and geometry2."""
CONFIG = """\
frames: 2
pose: {linear_m_per_s: [3, 0, 0]}
rig:
  top: {sensor: {preset: hesai-xt32}, position_m: [0, 0, 1]}
  left: {sensor: {preset: livox-mid360}}
scene: [{shape: sphere, center_m: [0, 0, 0], radius_m: 9}]
"""


class Message:
    """A message that has the fields of its definition and no others, as those of ROS."""

    slots: tuple[str, ...] = ()

    def __init__(self, **given: Any) -> None:
        for name, value in given.items():
            setattr(self, name, value)

    def __setattr__(self, name: str, value: Any) -> None:
        assert name in self.slots, name
        object.__setattr__(self, name, value)


@pytest.fixture
def published(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for path, slots in SLOTS.items():
        module, _, name = path.rpartition(".")
        for part in (module.partition(".")[0], module):
            if not isinstance(sys.modules.get(part), ModuleType) or part not in sys.modules:
                monkeypatch.setitem(sys.modules, part, ModuleType(part))
        setattr(sys.modules[module], name, type(name, (Message,), {"slots": tuple(slots.split())}))
    qos: Any = ModuleType("rclpy.qos")
    qos.DurabilityPolicy = SimpleNamespace(TRANSIENT_LOCAL=1)
    qos.QoSProfile = lambda **given: given
    qos.qos_profile_sensor_data = "sensor data"
    rclpy: Any = ModuleType("rclpy")
    turns = iter([True, True, False])
    rclpy.init, rclpy.ok, rclpy.try_shutdown = (lambda: None), (lambda: next(turns)), (lambda: None)

    def create_publisher(_: Any, topic: str, __: Any) -> Any:
        return SimpleNamespace(publish=lambda message: found.append((topic, message)))

    rclpy.create_node = lambda _: SimpleNamespace(create_publisher=create_publisher, destroy_node=lambda: None)
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    monkeypatch.setitem(sys.modules, "rclpy.qos", qos)
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    return found


def nanoseconds(stamp: Any) -> int:
    return int(stamp.sec * 10**9 + stamp.nanosec)


def test_what_is_published(published: list[tuple[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run.yaml").write_text(CONFIG, encoding="utf-8")
    monkeypatch.setattr(sys, "argv", [str(NODE), str(tmp_path / "run.yaml")])
    runpy.run_path(str(NODE), run_name="__main__")
    run = ls.config.load(tmp_path / "run.yaml")
    scans = list(run.scans())
    by_topic: dict[str, list[Any]] = {}
    for topic, message in published:
        by_topic.setdefault(topic, []).append(message)
    (still,) = by_topic["/tf_static"]
    places = {link.child_frame_id: (link.header.frame_id, link.transform.translation.z) for link in still.transforms}
    assert places == {"top": ("base_link", 1.0), "left": ("base_link", 0.0)}
    for name in ("top", "left"):
        clouds = by_topic[f"/{name}/points"]
        # Two repetitions of two frames of 0.1 s, whose times go on.
        assert [nanoseconds(cloud.header.stamp) for cloud in clouds] == [0, 10**8, 2 * 10**8, 3 * 10**8]
        for cloud, given in zip(clouds, [*scans, *scans], strict=True):
            points = given[name].point_cloud()
            assert (cloud.header.frame_id, cloud.height, cloud.width) == (name, 1, len(points))
            assert len(cloud.data) == cloud.row_step == cloud.width * cloud.point_step
            kinds = {7: "<f4", 8: "<f8", 4: "<u2", 2: "u1"}  # constants of sensor_msgs/msg/PointField
            dtype = np.dtype(
                {
                    "names": [field.name for field in cloud.fields],
                    "formats": [kinds[field.datatype] for field in cloud.fields],
                    "offsets": [field.offset for field in cloud.fields],
                    "itemsize": cloud.point_step,
                }
            )
            records = np.frombuffer(cloud.data, dtype)
            order = np.argsort(points.time, kind="stable")
            for axis, column in enumerate("xyz"):
                np.testing.assert_array_equal(records[column], points.xyz[order, axis].astype(np.float32))
            np.testing.assert_array_equal(records["ring" if name == "top" else "line"], points.ring[order])
            if name == "top":  # Hesai's times are absolute; they are whole ns, and a float64 below 1 rounds by 2^-54
                since = records["timestamp"] - nanoseconds(cloud.header.stamp) / 1e9
                np.testing.assert_allclose(since, points.time[order], rtol=0, atol=0.5e-9 + 2.0**-52)
    moved = [link.transform.translation.x for message in by_topic["/tf"] for link in message.transforms]
    expected = [3.0 * scan.time for _ in range(2) for given in scans for scan in given.values()]
    np.testing.assert_allclose(moved, expected, rtol=0, atol=2.0**-52)  # a product below 1, and a pose of it
    ticks = [nanoseconds(message.clock) for message in by_topic["/clock"]]
    assert ticks == sorted(ticks)
    assert len(ticks) >= 40


def test_without_ros(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    runpy.run_path(str(NODE), run_name="__main__")
    out = capsys.readouterr().out
    assert out.startswith("this example needs ROS 2")
    assert out.count("\n") == 1


def test_layouts_of_point_clouds() -> None:
    cloud = ls.PointCloud(xyz=[[1, 2, 3], [np.nan, 0, 0]], ring=[7, 1])
    for layout in sorted(rosbag.LAYOUTS.keys() - {"livox"}):
        found = rosbag.point_cloud2(cloud, layout=layout)
        assert (found.width, found.point_step) == (1, rosbag.LAYOUTS[layout].itemsize)
        assert np.frombuffer(found.data, "<f4", 3).tolist() == [1, 2, 3]
    livox = ls.Lidar.preset("livox-mid360")
    assert [name for name, _, _ in rosbag.point_cloud2(cloud, lidar=livox).fields][-1] == "timestamp"
    for wrong in ("livox", "laserscan", ""):
        with pytest.raises(
            ValueError, match="layout: expected one of velodyne, ouster, hesai, autoware, livox_cloud, got"
        ):
            rosbag.point_cloud2(cloud, layout=wrong)
    with pytest.raises(ValueError, match="stamp: expected an integer >= 0"):
        rosbag.point_cloud2(cloud, stamp=-1)
