"""Scan the street with your own sensor, and count the points on each class; writes street.ply."""

from pathlib import Path

import numpy as np

import lidarsim as ls

HERE = Path(__file__).parent

scene = ls.Scene.from_file(HERE / "scenes" / "street.yaml")
lidar = ls.Lidar.from_file(HERE / "sensors" / "city-lidar.yaml")

roof = np.eye(4)  # sensor to world: x forward, y left, z up
roof[:3, 3] = 0.0, -1.8, 1.9  # m
scan = lidar.scan(scene, roof, seed=1)
print(scan.summary())

cloud = scan.point_cloud(frame="world")
for label, name in sorted(scene.class_names.items()):
    print(f"{name:12} {np.count_nonzero(cloud.label == label):7,} points")
cloud.save("street.ply")
