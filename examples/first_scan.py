"""Build a scene, scan it, and see what happened to every pulse; writes scan.pcd and first_scan.png."""

from __future__ import annotations

import numpy as np

import lidarsim as ls

# Objects get the ids 0, 1, 2, … in the order of their addition.
scene = ls.Scene()
scene.add(ls.Plane((0, 0, 1), 0.0), name="ground", label=1, material=ls.Material(reflectivity=0.2))
scene.add(ls.Sphere((8, 2, 1), 1.0), name="ball", label=2, material=ls.Material(reflectivity=0.8))
scene.add(ls.Cylinder((6, -3, 0), (6, -3, 4), 0.3), name="post", label=3)
scene.add(ls.Box((1, 4, 2), center=(12, 0, 1)), name="wall", label=4)

# Any affine transform can place a shape, here a tent.
tent = ls.TriangleMesh(
    [(0, -1, 0), (0, 1, 0), (0, 0, 1.5), (3, -1, 0), (3, 1, 0), (3, 0, 1.5)],
    [(0, 2, 1), (3, 4, 5), (0, 3, 5), (0, 5, 2), (1, 2, 5), (1, 5, 4)],
)
turn = np.array([[0, -1, 0, 4], [1, 0, 0, 4], [0, 0, 1, 0], [0, 0, 0, 1.0]])
scene.add(tent, name="tent", label=5, transform=turn)

# The sensor is on a mast of 1.7 m. The noise of its data sheet is off by default.
mast = np.eye(4)
mast[2, 3] = 1.7
lidar = ls.Lidar.preset("ouster-os1-64", noise="datasheet")
scan = lidar.scan(scene, mast, seed=1)
print(scan.summary())

cloud = scan.point_cloud(frame="world")
print(cloud)
for item in scene:
    seen = cloud[cloud.object_id == item.id]
    error = 1e3 * np.std(seen.range_error) if len(seen) else np.nan
    print(f"{item.name:8} {len(seen):6} points, range noise {error:.1f} mm")

cloud.save("scan.pcd")
names = {item.label: item.name for item in scene.objects}
scan.plot(
    scene=scene,
    color_by="label",
    class_names=names,
    camera=[(-13, -7, 10), (6, 0.5, 0), (0, 0, 1)],
    size=(1000, 620),
    save="first_scan.png",
)
