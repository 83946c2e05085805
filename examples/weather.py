"""A city street in clear air, in fog and in rain: counts what comes back, and draws weather.png."""

from __future__ import annotations

import dataclasses

import numpy as np
from matplotlib.image import imread, imsave

import lidarsim as ls

AIR = 200  # label of the echoes of fog and rain

street = ls.worlds.street(4, "city", length=140)
lane, pose = street.ways.lanes[0], np.eye(4)
pose[:3, 3] = x, y, z = lane[60] + (0.0, 0.0, 1.9)
names = {**street.scene.class_names, AIR: "air"}

# Where the receiver sees the beam decides how bright the fog close to the sensor is: here, all of it from 5 m on.
lidar = ls.Lidar.preset("hesai-pandar64", noise="datasheet")
lidar = dataclasses.replace(lidar, measurement=dataclasses.replace(lidar.measurement, crossover=(1.0, 5.0)))
weather = {
    "clear air": None,
    "fog, visibility 50 m": ls.Atmosphere.fog(visibility=50.0, label=AIR),
    "rain, 25 mm/h": ls.Atmosphere.rain(rate=25.0, label=AIR),
}
for name, atmosphere in weather.items():
    street.scene.atmosphere = atmosphere
    scan = lidar.scan(street.scene, pose, seed=1)
    in_air = scan.point_cloud().label == AIR
    counts = f"{np.sum(~in_air):,} points on surfaces, {np.sum(in_air):,} in the air"
    print(f"{name}: {counts}, {np.mean(scan.status == ls.Status.below_threshold):.1%} of the pulses hit too weakly")
    camera, save = [(x - 16, y + 5, z + 10), (x + 14, y + 2.5, 0), (0, 0, 1)], f"{name.split(',')[0]}.png"
    scan.plot(color_by="label", class_names=names, camera=camera, size=(700, 560), title=name, save=save)
pictures = [imread(f"{name.split(',')[0]}.png") for name in weather]
imsave("weather.png", np.concatenate(pictures, axis=1))
