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

figure = Figure(figsize=(10, 6.2), layout="constrained")
axes = figure.add_subplot()
print(f"{'sensor':20}" + "".join(f"{distance:>8} m" for distance in DISTANCES))
for name in ls.Lidar.presets():
    lidar = ls.Lidar.preset(name)
    if isinstance(lidar.pattern, ls.patterns.Spinning) and lidar.pattern.shape[0] > 1:  # 2D lidars see over their heads
        cloud = lidar.scan(scene, roof).point_cloud()
        counts = np.bincount(cloud.object_id, minlength=len(scene))[1:]
        print(f"{name:20}" + "".join(f"{count:10}" for count in counts))
        axes.plot(DISTANCES, np.maximum(counts, 0.5), marker="o", label=name)

axes.set(xscale="log", yscale="log", xlabel="distance [m]", ylabel="points on a pedestrian")
axes.set_xticks(DISTANCES, DISTANCES)
axes.minorticks_off()
axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))
figure.savefig("compare_sensors.png", dpi=100)
