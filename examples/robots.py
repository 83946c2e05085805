"""Many worlds of robots in a warehouse: wheeled robots of MuJoCo, each with a Livox Mid-360 that scans at 10 Hz.

Run it with the number of worlds, such as ``python robots.py 1000``; the default is 16. Each world has one robot, with a
speed of its own, in the same warehouse. The states of all worlds are in one array, as a learner would have them. The
lidar does not see the robot that carries it. The picture shows where the robots have driven and what some of them saw,
above the true occupancy grid of the warehouse, which is also written as a map for ROS.
"""

import sys
import time

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import mujoco
import numpy as np

import lidarsim as ls

WORLDS = int(sys.argv[1]) if len(sys.argv) > 1 else 16
STEPS, RATE = 10, 10.0  # scans of each world, Hz

ROBOT = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <default><geom rgba="0.6 0.6 0.6 1"/></default>
  <worldbody>
    {shelves}
    <geom name="floor" type="plane" size="15 10 0.1"/>
    <geom name="north" type="box" size="15 0.1 1.5" pos="0 10 1.5"/>
    <geom name="south" type="box" size="15 0.1 1.5" pos="0 -10 1.5"/>
    <geom name="east" type="box" size="0.1 10 1.5" pos="15 0 1.5"/>
    <geom name="west" type="box" size="0.1 10 1.5" pos="-15 0 1.5"/>
    <body name="robot" pos="0 0 0.1">
      <freejoint/>
      <geom type="box" size="0.3 0.22 0.09" pos="0 0 0.08" mass="20"/>
      <geom type="cylinder" size="0.03 0.12" pos="0 0 0.29" mass="0.2"/>
      <geom type="sphere" size="0.05" pos="-0.24 0 -0.05" mass="0.5" friction="0 0 0"/>
      <site name="lidar" pos="0 0 0.45"/>
      <body name="left" pos="0.12 0.25 0">
        <joint name="left" axis="0 1 0" damping="0.02"/>
        <geom type="cylinder" size="0.1 0.025" zaxis="0 1 0" mass="1"/>
      </body>
      <body name="right" pos="0.12 -0.25 0">
        <joint name="right" axis="0 1 0" damping="0.02"/>
        <geom type="cylinder" size="0.1 0.025" zaxis="0 1 0" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="left" kv="3"/>
    <velocity joint="right" kv="3"/>
  </actuator>
</mujoco>
"""


def shelves() -> str:
    """Rows of shelves with boxes on them, as geoms of MJCF."""
    rng, geoms = np.random.default_rng(1), []
    for y in (-6.5, -3.25, 3.25, 6.5):
        for x in np.arange(-10.5, 11.0, 3.0):
            geoms += [
                f'<geom type="box" size="0.04 0.04 1.1" pos="{x + a:.2f} {y + b:.2f} 1.1"/>'
                for a in (-1.2, 1.2)
                for b in (-0.45, 0.45)
            ]
            geoms += [f'<geom type="box" size="1.2 0.45 0.02" pos="{x} {y} {z}"/>' for z in (0.25, 1.1, 1.95)]
            for z in (0.27, 1.12):
                size = rng.uniform((0.2, 0.2, 0.15), (0.5, 0.4, 0.35))
                place = x + rng.uniform(-0.6, 0.6), y, z + size[2]
                geoms.append(
                    f'<geom type="box" size="{size[0]} {size[1]} {size[2]}" pos="{" ".join(map(str, place))}"/>'
                )
    return "\n".join(geoms)


# The warehouse without its robot: what all worlds share, so that one scene does for all of them.
model = mujoco.MjModel.from_xml_string(ROBOT.format(shelves=shelves()))
world = ls.mujoco.World(model, rules=[ls.Rule(node="robot*", skip=True)])
lidar = ls.Lidar.preset("livox-mid360")

# The worlds: robots that start in the aisles and drive at speeds of their own.
rng = np.random.default_rng(0)
worlds = [mujoco.MjData(model) for _ in range(WORLDS)]
for data in worlds:
    data.qpos[:2] = rng.uniform(-11, 11), rng.choice([0.0, -4.9, 4.9])
    heading = rng.choice([0.0, np.pi]) + rng.normal(scale=0.1)
    data.qpos[3:7] = np.cos(heading / 2), 0, 0, np.sin(heading / 2)
    data.ctrl[:] = rng.uniform(10, 25) + rng.normal(scale=0.4, size=2)

simulated = scanned = 0.0
paths, hits, batch = [], 0, None
for step in range(STEPS):
    start = time.perf_counter()
    for data in worlds:
        mujoco.mj_step(model, data, nstep=round(1 / RATE / model.opt.timestep))
        mujoco.mj_kinematics(model, data)
    xpos, xquat = np.stack([data.xpos for data in worlds]), np.stack([data.xquat for data in worlds])
    middle = time.perf_counter()
    poses = world.poses(xpos, xquat, site="lidar")
    batch = lidar.scan_many(world.scene, poses, frame=step, fields=["xyz", "status"], out=batch)  # one call
    scanned += time.perf_counter() - middle
    simulated += middle - start
    paths.append(poses[:, :2, 3])
    hits += int((batch.status == ls.Status.hit).sum())
total = STEPS * WORLDS
print(f"{WORLDS} worlds, {total} scans of {batch.status.shape[1]} pulses, {hits / total:,.0f} points each")
print(f"{total / scanned:,.0f} scans/s, {total / (scanned + simulated):,.0f} steps/s with MuJoCo")

grid = ls.occupancy(world.scene, 0.05, z=0.45, free_from=(0, 0))
grid.save("warehouse_map.yaml")

figure, axes = plt.subplots(figsize=(9, 6.2), layout="constrained")
rows, columns = grid.cells.shape
(left, bottom), side = grid.origin, grid.resolution
shades = np.select([grid.cells == 100, grid.cells == 0], [0.25, 1.0], 0.85)
extent = (left, left + columns * side, bottom, bottom + rows * side)
axes.imshow(shades, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="nearest")
colors = plt.get_cmap("turbo")(np.linspace(0.08, 0.92, max(WORLDS, 2)))
for k in range(min(WORLDS, 4)):
    seen = batch.xyz[k][batch.status[k] == ls.Status.hit]
    points = seen @ poses[k, :3, :3].T + poses[k, :3, 3]
    points = points[(points[:, 2] > 0.3) & (points[:, 2] < 1.0)]
    axes.plot(*points[:, :2].T, ".", color=colors[k * (WORLDS - 1) // 3 if WORLDS > 3 else k], markersize=1.2)
for k, path in enumerate(np.swapaxes(paths, 0, 1)[:200]):
    axes.plot(*path.T, color=colors[k % len(colors)], linewidth=2)
    axes.plot(*path[-1], "o", color=colors[k % len(colors)], markeredgecolor="black", markersize=6)
axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=f"{WORLDS} worlds of a robot with a Mid-360")
figure.savefig("robots.png", dpi=100)
