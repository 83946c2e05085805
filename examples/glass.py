"""Scan a shop front: the room behind the glass, and ghosts in mirrors; writes glass.png."""

from __future__ import annotations

import numpy as np

import lidarsim as ls

PLASTER, WOOD = ls.Material(reflectivity=0.6), ls.Material(reflectivity=0.4)


def panel(corner: tuple[float, float, float], across: tuple[float, float, float], height: float) -> ls.Polygon:
    """Return an upright rectangle."""
    low, along, up = np.array(corner), np.array(across), np.array((0.0, 0.0, height))
    return ls.Polygon([low, low + along, low + along + up, low + up])


scene = ls.Scene()
scene.add(ls.Box((24, 16, 0.2), center=(6, 0, -0.1)), name="ground", material=ls.materials.CONCRETE)

# The front of the shop is at x = 8: walls, a sill, and a window of 5 m between them.
for y in (-7.0, 2.5):
    scene.add(panel((8, y, 0), (0, 4.5, 0), 3.0), name="front", material=ls.materials.BRICK)
scene.add(panel((8, -2.5, 0), (0, 5, 0), 0.4), name="sill", material=ls.materials.BRICK)
window = scene.add(panel((8, -2.5, 0.4), (0, 5, 0), 2.6), name="window", material=ls.materials.GLASS)

# The room behind it, with a counter, shelves, a customer, and a mirror on the back wall.
for corner, across in (((8, -4, 0), (6, 0, 0)), ((8, 4, 0), (6, 0, 0)), ((14, -4, 0), (0, 8, 0))):
    scene.add(panel(corner, across, 3.0), name="wall", material=PLASTER)
scene.add(ls.Box((0.8, 2.6, 1.0), center=(11.2, -1.6, 0.5)), name="counter", material=WOOD)
for y in (2.2, 3.2):
    scene.add(ls.Box((2.0, 0.4, 1.8), center=(11.0, y, 0.9)), name="shelf", material=WOOD)
scene.add(ls.Capsule((9.6, 0.6, 0.3), (9.6, 0.6, 1.5), 0.25), name="customer", material=ls.materials.CLOTH)
scene.add(panel((13.9, -2.6, 0.3), (0, 5.2, 0), 2.2), name="mirror", material=ls.materials.MIRROR)

# A passer-by and a bollard in the street. The glass mirrors them, faintly.
scene.add(ls.Capsule((5.0, -1.2, 0.3), (5.0, -1.2, 1.5), 0.25), name="passer-by", material=ls.materials.CLOTH_LIGHT)
scene.add(ls.Cylinder((5.5, 2.6, 0), (5.5, 2.6, 1.0), 0.12), name="bollard", material=PLASTER)

# Light goes on to the fourth surface of each way: out through the glass, say, after the mirror.
pattern = ls.patterns.Grid(np.radians(np.linspace(50, -50, 900)), np.radians(np.linspace(12, -22, 110)), rate=10.0)
measurement = ls.Measurement(range_sigma=0.01, detection=ls.Detection(0.1, 60.0), depth=4, returns=4)
lidar = ls.Lidar(pattern, measurement=measurement)
mast = np.eye(4)
mast[2, 3] = 1.5
scan = lidar.scan(scene, mast, seed=1)

# A point that is not where its light comes from is a ghost.
cloud = scan.point_cloud(frame="world")
off = np.linalg.norm(scan.true_points("world") - cloud.xyz, axis=1)
kinds = {0: "seen directly", 1: "the pane", 2: "through the glass", 3: "ghosts in mirrors"}
cloud.label = np.where(off > 0.1, 3, np.where(cloud.object_id == window, 1, 2 * np.minimum(cloud.path, 1)))
cloud.class_names = kinds
for label, kind in kinds.items():
    print(f"{kind:18} {np.count_nonzero(cloud.label == label):6} points")

cloud[cloud.label != 1].plot(
    color_by="label",
    camera=[(-3.0, -13.0, 17.0), (12.5, 0.8, 0), (0, 0, 1)],
    size=(1000, 620),
    point_size=2.5,
    save="glass.png",
)
