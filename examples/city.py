"""Map a city street by class, with its houses, leaves, cars and people; writes city.ply and city.png.

The street is one of `lidarsim.worlds`; vehicles and people are added along its lanes and pavements, and a lidar on a
car scans it every five metres.
"""

from __future__ import annotations

import numpy as np

import lidarsim as ls

rng = np.random.default_rng(2)
street = ls.worlds.street(9, "city", length=140)


def along(way: np.ndarray, i: int) -> np.ndarray:
    """Return the pose at a point of a way, heading along it."""
    x, y, _ = way[i + 1] - way[i]
    pose = np.eye(4)
    pose[:2, :2] = np.array([(x, -y), (y, x)]) / np.hypot(x, y)
    pose[:3, 3] = way[i]
    return pose


for way in street.ways.pavements:
    for i in rng.choice(len(way) - 1, len(way) // 6):
        ls.worlds.pedestrian(rng).add_to(street.scene, name="person", transform=along(way, i))
back = street.ways.lanes[1]
for i in range(5, len(back) - 5, 17):
    kind = rng.choice(["hatchback", "saloon", "estate", "suv", "van", "bus", "bicycle"])
    ls.worlds.vehicle(kind, rng).add_to(street.scene, name="vehicle", transform=along(back, i))

lidar = ls.Lidar.preset("ouster-os0-128")
lane, mount = street.ways.lanes[0], np.eye(4)
mount[2, 3] = 1.9
scans = [lidar.scan(street.scene, along(lane, i) @ mount, frame=i) for i in range(10, len(lane) - 10, 5)]
city = ls.PointCloud.concatenate([scan.point_cloud("world", fields=["label", "intensity"]) for scan in scans])
city.class_names = street.scene.class_names
city.save("city.ply")
print(f"{len(city):,} points in {len(scans)} frames, {len(street.scene):,} objects")

start = lane[20]
city.plot(
    color_by="label",
    camera=[(start[0] - 26, start[1] - 7, 15), (start[0] + 30, start[1] + 4, 0), (0, 0, 1)],
    size=(1200, 675),
    point_size=1.5,
    save="city.png",
)
