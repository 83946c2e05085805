"""A robot of MuJoCo drives through a warehouse and maps it with a lidar: writes the map and a picture.

Needs `pip install "lidarsim[mujoco]"`. Usage: python warehouse.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np

import lidarsim as ls

FRAMES = 40
SPEEDS = {"left": 6.0, "right": 8.0}  # of the wheels, rad/s: a wide turn to the left

world = ls.mujoco.World(Path(__file__).parents[1] / "configs" / "scenes" / "warehouse.xml")
model, data = world.model, mujoco.MjData(world.model)
for name, speed in SPEEDS.items():
    data.actuator(name).ctrl = speed
robot = [world.bodies[name] for name in ("robot", "left wheel", "right wheel")]

# The world stands still during a scan, here of one turn: MuJoCo simulates the time between scans.
lidar = ls.Lidar.preset("velodyne-vlp16", noise="datasheet")
steps = round(1 / (lidar.pattern.rate * model.opt.timestep))
clouds, path = [], []
for frame in range(FRAMES):
    mujoco.mj_step(model, data, nstep=steps)
    mujoco.mj_forward(model, data)
    world.update(data)
    pose = world.pose(data, site="lidar")
    cloud = lidar.scan(world.scene, pose, frame=frame).point_cloud(frame="world")
    clouds.append(cloud[~np.isin(cloud.instance, robot)])
    path.append(pose[:3, 3])

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
whole = ls.PointCloud.concatenate(clouds)
whole.save(folder / "warehouse.ply")
length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
print(f"{len(whole):,} points from {FRAMES} scans along {length:.1f} m")
ls.show(
    whole[::20],
    scene=world.scene,
    color_by="height",
    camera=[(-11, -9, 9), (0, 0, -0.5), (0, 0, 1)],
    save=folder / "warehouse.png",
)
