"""Make a labelled data set of a drive, check that a seed reproduces the same bits, and show it; writes dataset.gif."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import lidarsim as ls

CONFIG = Path(__file__).parents[1] / "configs" / "demo.yaml"
FRAMES = 5

run = ls.config.load(CONFIG, ["sensor.preset=velodyne-vlp16", "sensor.noise=datasheet"])
out = Path("dataset")
out.mkdir(exist_ok=True)

poses, scans = [], []
for frame in range(FRAMES):
    pose = np.eye(4)
    pose[:3, 3] = -20 + 4 * frame, -1.8, 1.9  # 4 m per frame
    scan = run.lidar.scan(run.scene, pose, frame=frame, seed=run.seed)
    cloud = scan.point_cloud()  # in the sensor frame, like a driver's
    cloud.save(out / f"{frame:04}.npz")
    poses.append(pose)
    scans.append(scan)
    labels, counts = np.unique(cloud.label, return_counts=True)
    print(f"frame {frame}: {len(cloud)} points, by label {dict(zip(labels.tolist(), counts.tolist(), strict=True))}")
np.save(out / "poses.npy", poses)

# Noise depends only on seed, sensor, frame and pulse: one frame can be reproduced without the others.
again = run.lidar.scan(run.scene, poses[3], frame=3, seed=run.seed).point_cloud()
stored = ls.PointCloud.load(out / "0003.npz")
same = all(np.array_equal(getattr(again, field), getattr(stored, field)) for field in stored.fields)
print(f"frame 3, made again on its own, is the same to the last bit: {same}")

ls.show(scans, scene=run.scene, color_by="label", size=(1000, 620), save="dataset.gif")
