"""A junction with moving cars, scanned by two lidars on a moving car: writes clouds of all frames and a picture.

Points have the label and instance of the object that was hit, and the radial velocity that an FMCW lidar would measure.
Usage: python junction.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls

ROAD, BUILDING, CAR = 8, 5, 1
FRAMES = 5


def place(x: float, y: float, heading: float = 0.0, z: float = 0.0) -> RigidTransform:
    """Return a pose at the height z, with the heading in degrees."""
    return RigidTransform.from_components((x, y, z), Rotation.from_euler("z", heading, degrees=True))


car = ls.TriangleMesh.from_file(Path(__file__).parents[1] / "configs" / "scenes" / "car.ply")
scene = ls.Scene(class_names={ROAD: "road", BUILDING: "building", CAR: "car"})
scene.add(ls.Plane((0, 0, 1), 0.0), name="road", label=ROAD, material=ls.Material(reflectivity=0.2))
for x in (-30.0, 30.0):
    for y in (-28.0, 28.0):
        scene.add(ls.Box((40, 36, 14), (x, y, 7)), name="building", label=BUILDING)

# Cars from the left and the right, a waiting queue, and a car that turns left.
for x, speed in ((-45.0, 13.0), (-28.0, 12.0), (-8.0, 12.5)):
    motion = ls.Trajectory.from_twist(place(x, -4.0), linear=(speed, 0, 0))
    scene.add(car, name="from the left", label=CAR, motion=motion)
for x, speed in ((16.0, 9.0), (40.0, 11.0)):
    motion = ls.Trajectory.from_twist(place(x, 4.0, 180), linear=(speed, 0, 0))
    scene.add(car, name="from the right", label=CAR, motion=motion)
for y in (14.0, 21.0, 28.0):
    scene.add(car, name="waiting", label=CAR, transform=place(-4.0, y, -90).as_matrix())
turning = ls.Trajectory(
    [0.0, 1.0, 2.0, 3.0],
    RigidTransform.concatenate([place(-4, 10, -90), place(-3, 2, -75), place(2, -4, -25), place(12, -4.5, 0)]),
    interpolation="spline",
)
scene.add(car, name="turning", label=CAR, motion=turning)

# The sensor car comes from the south, with one lidar on its roof and one behind its grille.
rig = ls.Rig(
    {
        "roof": (ls.Lidar.preset("ouster-os1-64", noise="datasheet"), place(0.0, 0.0, z=1.8)),
        "front": (ls.Lidar.preset("hesai-at128"), place(2.3, 0.0, z=0.6)),
    }
)
drive = ls.Trajectory.from_twist(place(4.0, -30.0, 90), linear=(8.0, 0, 0))

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
for number, scans in enumerate(rig.frames(scene, drive, FRAMES, first=10)):
    clouds = {name: scan.point_cloud("world") for name, scan in scans.items()}
    for name, cloud in clouds.items():
        cloud.save(folder / f"junction_{name}_{number}.ply")
cloud = ls.PointCloud.concatenate(clouds.values())
cars = cloud[cloud.label == CAR]
print(f"{len(cloud):,} points in the last frame, of which {len(cars):,} on {len(np.unique(cars.instance))} cars")
print(f"radial velocities from {np.nanmin(cars.radial_velocity):.1f} to {np.nanmax(cars.radial_velocity):.1f} m/s")
ls.show(
    scans,
    scene=scene,
    color_by="radial_velocity",
    camera=[(-8, -72, 62), (2, -2, 0), (0, 0, 1)],
    save=folder / "junction.png",
)
