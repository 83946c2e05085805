"""Scan a scan: points of a terrestrial scanner become surfels, which another sensor scans; writes scan_as_scene.png.

This is how a real survey becomes a scene: `ls.PointCloud.load` reads it, and each point becomes a disk. In a
configuration, `{shape: surfels, file: survey.las}` does the same.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import lidarsim as ls

CONFIG = Path(__file__).parents[1] / "configs" / "terrestrial.yaml"

# The survey: a dome of 0.3° around each of three stations, without noise, so that all errors are those of the surfels.
run = ls.config.load(CONFIG)
angles = np.radians(np.arange(-180, 180, 0.3)), np.radians(np.arange(-60, 60, 0.3))
scanner = ls.Lidar(ls.patterns.Grid(*angles, rate=1.0), name="survey")
survey = ls.PointCloud.concatenate([scanner.scan(run.scene, leg.pose).point_cloud("world") for leg in run.legs])
survey.save("survey.ply")

# A scene of surfels, with the labels of the points that they stand for.
survey = ls.PointCloud.load("survey.ply")
disks, index = ls.Disks.from_points(survey.xyz, return_index=True)
copy = ls.Scene(class_names=run.scene.class_names)
copy.add(disks, name="survey", label=survey.label[index])
print(f"{len(survey):,} points, {len(index):,} surfels")

# The sensor of a car scans the copy, from a place where no station was; the scene itself tells how right that is.
place = np.eye(4)
place[:3, 3] = 4.0, -3.0, 1.8
lidar = ls.Lidar.preset("ouster-os1-64")
seen, true = lidar.scan(copy, place), lidar.scan(run.scene, place)
both = (seen.status == ls.Status.hit) & (true.status == ls.Status.hit)
error = np.abs(seen.range - true.range)[both]
print(f"{both.sum():,} of {np.sum(true.status == ls.Status.hit):,} pulses meet a surfel")
print(f"range errors: median {1e3 * np.median(error):.2f} mm, 95 % within {1e3 * np.quantile(error, 0.95):.0f} mm")
seen.plot(color_by="label", camera="orbit", size=(1000, 620), save="scan_as_scene.png")
