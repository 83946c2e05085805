"""Hold odometry against the true poses of a drive: KISS-ICP, if it is installed; writes slam.png.

`pip install kiss-icp` adds the odometry (I. Vizzo et al., IEEE Robotics and Automation Letters 8, 2023); without it,
the true poses alone make the map. For other SLAM, `lidarsim scan ahead -o drive.mcap` writes a ROS 2 bag.
"""

from __future__ import annotations

import importlib.util

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls

FRAMES, SPEED = 80, 9.0  # m/s
draw = np.random.default_rng(4)


def pose_at(x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> RigidTransform:
    """Return a pose."""
    return RigidTransform.from_components((x, y, z), Rotation.from_euler("z", yaw))


# A street with houses that stand at random angles, poles and trees.
scene = ls.Scene()
scene.add(ls.Plane((0, 0, 1), 0.0), name="ground")
for side in (-1, 1):
    x = -30.0
    while x < 110.0:
        width, depth, height = draw.uniform((6, 6, 4), (18, 12, 15))
        place = pose_at(x + width / 2, side * (draw.uniform(13, 19) + depth / 2), height / 2, draw.uniform(-0.2, 0.2))
        scene.add(ls.Box((width, depth, height)), name="house", transform=place)
        x += width + draw.uniform(0.5, 8)
    for x in draw.uniform(-30, 110, 20):
        y, height, radius = draw.uniform((9, 3, 0.05), (12, 7, 0.3))
        scene.add(ls.Cylinder((x, side * y, 0), (x, side * y, height), radius), name="pole")
        if radius > 0.2:
            scene.add(ls.Sphere((x, side * y, height), 1.5), name="crown")

# A drive that winds a little, and the points as a driver gives them: skewed by the motion of the car.
times = np.arange(0.0, FRAMES / 10 + 0.2, 0.1)
yaw = 0.3 * np.sin(0.8 * times)
x, y = (np.cumsum(SPEED * 0.1 * along) for along in (np.cos(yaw), np.sin(yaw)))
poses = RigidTransform.concatenate([pose_at(*at, 1.8, turn) for *at, turn in zip(x, y, yaw, strict=True)])
drive = ls.Trajectory(times, poses, interpolation="spline")
lidar = ls.Lidar.preset("ouster-os1-64", noise="datasheet")
scans = list(lidar.frames(scene, drive, FRAMES, seed=1))

ends = drive.at([scan.time + 0.1 for scan in scans]).as_matrix()  # deskewed points stand for the end of a frame
found = None
if importlib.util.find_spec("kiss_icp"):
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    settings = KISSConfig()
    settings.mapping.voxel_size = 1.0
    odometry, steps = KissICP(settings), []
    for scan in scans:
        cloud = scan.point_cloud()
        odometry.register_frame(cloud.xyz.astype(float), 10.0 * (cloud.time - scan.time).astype(float))
        steps.append(odometry.last_pose)
    found = ends[0] @ np.linalg.inv(steps[0]) @ np.array(steps)
    off = np.linalg.norm(found[:, :3, 3] - ends[:, :3, 3], axis=1)
    length = np.linalg.norm(np.diff(ends[:, :3, 3], axis=0), axis=1).sum()
    print(f"KISS-ICP: {off[-1]:.2f} m off after {length:.0f} m, at most {off.max():.2f} m on the way")
else:
    print("KISS-ICP is not installed (pip install kiss-icp); the map below is that of the true poses")

figure, axes = plt.subplots(figsize=(10, 4.6), layout="constrained", facecolor="#14181f")
for scan, pose in zip(scans, ends if found is None else found, strict=True):
    cloud = scan.point_cloud(deskew="end")
    points = cloud.xyz @ pose[:3, :3].T + pose[:3, 3]
    points = points[(points[:, 2] > 0.3) & (np.abs(points[:, 1]) < 32)]
    shown = axes.scatter(*points[::3, :2].T, c=points[::3, 2], s=0.3, cmap="viridis", vmin=0, vmax=8, linewidths=0)
axes.plot(*ends[:, :2, 3].T, color="white", linewidth=4, label="true path")
if found is not None:
    axes.plot(*found[:, :2, 3].T, color="#ff5a9c", linewidth=1.5, label="KISS-ICP")
axes.set(xlim=(-35, 115), ylim=(-32, 32), aspect="equal", facecolor="#14181f")
axes.tick_params(colors="white")
axes.set_xlabel("x [m]", color="white")
axes.set_ylabel("y [m]", color="white")
axes.legend(loc="lower right", labelcolor="white", facecolor="#14181f", edgecolor="none")
bar = figure.colorbar(shown, ax=axes, shrink=0.85)
bar.set_label("height [m]", color="white")
bar.ax.tick_params(colors="white")
figure.savefig("slam.png", dpi=100)
