"""Count the points of each spinning preset on a pedestrian at several distances; writes compare_sensors.png."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import lidarsim as ls

DISTANCES = [10, 20, 40, 80]

scene = ls.Scene()
scene.add(ls.Plane((0, 0, 1), 0.0), name="ground")
for number, distance in enumerate(DISTANCES):  # none hides another
    azimuth = np.radians(20 * number)
    x, y = distance * np.cos(azimuth), distance * np.sin(azimuth)
    scene.add(ls.Ellipsoid((x, y, 0.85), (0.2, 0.25, 0.85)), name=f"pedestrian at {distance} m", label=30)

roof = np.eye(4)
roof[2, 3] = 1.8

counts = {}
print(f"{'sensor':20}" + "".join(f"{distance:>8} m" for distance in DISTANCES))
for name in ls.Lidar.presets():
    lidar = ls.Lidar.preset(name)
    spins = isinstance(lidar.pattern, ls.patterns.Spinning) and lidar.pattern.rate >= 1  # terrestrial ones take seconds
    if spins and lidar.pattern.shape[0] > 1:  # 2D lidars see over their heads
        cloud = lidar.scan(scene, roof).point_cloud()
        counts[name] = np.bincount(cloud.object_id, minlength=len(scene))[1:]
        print(f"{name:20}" + "".join(f"{count:10}" for count in counts[name]))

names = sorted(counts, key=lambda name: -counts[name].sum())
table = np.array([counts[name] for name in names])
figure = Figure(figsize=(7, 7.5), layout="constrained")
axes = figure.add_subplot()
axes.imshow(np.log10(np.maximum(table, 1)), aspect="auto", cmap="cividis")
for (row, column), count in np.ndenumerate(table):
    light = count > np.sqrt(table.max())  # the middle of a logarithmic scale
    axes.text(column, row, f"{count:,}", ha="center", va="center", color="black" if light else "white")
axes.set_xticks(range(len(DISTANCES)), [f"{distance} m" for distance in DISTANCES])
axes.set_yticks(range(len(names)), names)
axes.tick_params(length=0)
axes.set_title("points on a pedestrian")
figure.savefig("compare_sensors.png", dpi=100)
