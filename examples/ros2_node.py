"""A ROS 2 node that publishes the lidars of a configuration: their clouds, ``/tf``, ``/tf_static`` and ``/clock``.

It needs rclpy, which comes with ROS 2: source its setup.bash, and run this with ROS's Python, such as
``python3 ros2_node.py run.yaml``. The default is a spinning lidar that drives past pillars. Each sensor publishes
``/NAME/points`` at its rate, in the layout of its vendor's driver; the run begins again after its last frame, until
Ctrl-C. Nodes that listen run with ``use_sim_time:=true``.
"""

from __future__ import annotations

import sys
import time
from array import array
from pathlib import Path
from tempfile import TemporaryDirectory

from scipy.spatial.transform import Rotation

import lidarsim as ls

try:
    import rclpy
    from builtin_interfaces.msg import Time
    from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
    from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import PointCloud2, PointField
    from std_msgs.msg import Header
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:
    rclpy = None

CONFIG = """
frames: 50
sensor: {preset: velodyne-vlp16}
pose: {position_m: [0, 0, 1.8], linear_m_per_s: [3, 0, 0]}
scene:
  - {shape: plane, normal: [0, 0, 1]}
  - {shape: cylinder, start_m: [6, 4, 0], end_m: [6, 4, 4], radius_m: 0.3}
  - {shape: cylinder, start_m: [12, -4, 0], end_m: [12, -4, 4], radius_m: 0.3}
"""


def load(arguments: list[str]) -> ls.run.Run:
    """Return the run of a configuration, or the default."""
    if arguments:
        return ls.config.load(arguments[0])
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.yaml"
        path.write_text(CONFIG, encoding="utf-8")
        return ls.config.load(path)


def stamp(moment: float) -> Time:
    """Return a time of ``/clock``, s."""
    seconds, nanoseconds = divmod(round(1e9 * moment), 10**9)
    return Time(sec=seconds, nanosec=nanoseconds)


def links(moment: float, parent: str, poses: dict[str, object]) -> TFMessage:
    """Return the poses of frames in another one, (4, 4)."""
    transforms = []
    for child, pose in poses.items():
        place = Vector3(**dict(zip("xyz", map(float, pose[:3, 3]), strict=True)))
        turn = Quaternion(**dict(zip("xyzw", Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(), strict=True)))
        header, transform = Header(stamp=stamp(moment), frame_id=parent), Transform(translation=place, rotation=turn)
        transforms.append(TransformStamped(header=header, child_frame_id=child, transform=transform))
    return TFMessage(transforms=transforms)


def message(scan: ls.Scan, name: str, moment: float) -> PointCloud2:
    """Return the points of a scan as the driver of its sensor publishes them."""
    found = ls.io.rosbag.point_cloud2(scan.point_cloud(), lidar=scan.lidar, stamp=round(1e9 * moment))
    cloud = PointCloud2(header=Header(stamp=stamp(moment), frame_id=name), height=1, width=found.width)
    cloud.fields = [PointField(name=field, offset=at, datatype=code, count=1) for field, at, code in found.fields]
    cloud.point_step, cloud.row_step, cloud.is_dense = found.point_step, found.width * found.point_step, True
    cloud.data = array("B", found.data.tobytes())  # which rclpy takes as it is
    return cloud


def main() -> None:
    """Publish until Ctrl-C."""
    if rclpy is None:
        print("this example needs ROS 2, whose Python packages are not there: source /opt/ros/DISTRO/setup.bash first")
        return
    run = load(sys.argv[1:])
    rig = run.sensor if isinstance(run.sensor, ls.Rig) else ls.Rig({"lidar": (run.sensor, None)})
    rclpy.init()
    node = rclpy.create_node("lidarsim")
    clouds = {name: node.create_publisher(PointCloud2, f"/{name}/points", qos_profile_sensor_data) for name in rig}
    clock, moving = node.create_publisher(Clock, "/clock", 10), node.create_publisher(TFMessage, "/tf", 10)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    still = node.create_publisher(TFMessage, "/tf_static", latched)
    still.publish(links(0.0, "base_link", {name: sensor.mount for name, sensor in rig.items()}))
    first, last = run.span
    begin, turns = time.monotonic(), 0
    try:
        while rclpy.ok():
            shift = turns * (last - first) - first
            for scans in run.scans():
                for name, scan in scans.items():
                    start = scan.time + shift
                    end = start + 1.0 / scan.lidar.pattern.rate  # when a driver publishes the scan
                    while (now := time.monotonic() - begin) < end:
                        clock.publish(Clock(clock=stamp(now)))
                        time.sleep(min(0.01, end - now))
                    moving.publish(links(start, "map", {"base_link": run.body_pose(scan.time)}))
                    clouds[name or "lidar"].publish(message(scan, name or "lidar", start))
            turns += 1
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
