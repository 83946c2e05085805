"""Make a labelled data set of a drive, check that a seed reproduces the same bits, and show it; writes dataset.gif."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import lidarsim as ls

FRAMES, STEP, SEED = 8, 3, 7  # a point of the lane is a metre on

street = ls.worlds.street(12, "city", length=120)
lane, lidar = street.ways.lanes[0], ls.Lidar.preset("velodyne-hdl32e", noise="datasheet")
out = Path("dataset")
out.mkdir(exist_ok=True)

poses, scans = [], []
for frame in range(FRAMES):
    pose = np.eye(4)
    pose[:3, 3] = lane[30 + STEP * frame] + (0.0, 0.0, 1.9)
    scan = lidar.scan(street.scene, pose, frame=frame, seed=SEED)
    cloud = scan.point_cloud()  # in the sensor frame, like a driver's
    cloud.save(out / f"{frame:04}.npz")
    poses.append(pose)
    scans.append(scan)
    labels, counts = np.unique(cloud.label, return_counts=True)
    print(f"frame {frame}: {len(cloud)} points, by label {dict(zip(labels.tolist(), counts.tolist(), strict=True))}")
np.save(out / "poses.npy", poses)

# Noise depends only on seed, sensor, frame and pulse: one frame can be reproduced without the others.
again = lidar.scan(street.scene, poses[3], frame=3, seed=SEED).point_cloud()
stored = ls.PointCloud.load(out / "0003.npz")
same = all(np.array_equal(getattr(again, field), getattr(stored, field)) for field in stored.fields)
print(f"frame 3, made again on its own, is the same to the last bit: {same}")

ls.show(scans, color_by="label", camera="behind", size=(600, 370), save="dataset.gif")
