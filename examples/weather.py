"""The street of configs/demo.yaml in clear air, in fog and in rain: counts what comes back, and draws weather.png."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lidarsim as ls

CONFIG = Path(__file__).parents[1] / "configs" / "demo.yaml"
AIR = 99  # label of the echoes of fog and rain

# Where the receiver sees the beam decides how bright the fog close to the sensor is: here, all of it from 5 m on.
run = ls.config.load(CONFIG, ["sensor.preset=hesai-pandar64", "sensor.measurement.crossover_m=[1, 5]"])
weather = {
    "clear air": None,
    "fog, visibility 50 m": ls.Atmosphere.fog(visibility=50.0, label=AIR),
    "rain, 25 mm/h": ls.Atmosphere.rain(rate=25.0, label=AIR),
}
figure, axes = plt.subplots(1, 3, figsize=(15, 4.7), layout="constrained", facecolor="black")
for axis, (name, atmosphere) in zip(axes, weather.items(), strict=True):
    run.scene.atmosphere = atmosphere
    scan = run.scan()
    cloud = scan.point_cloud("world")
    in_air = cloud.label == AIR
    counts = f"{np.sum(~in_air):,} points on surfaces, {np.sum(in_air):,} in the air"
    print(f"{name}: {counts}, {np.mean(scan.status == ls.Status.below_threshold):.1%} of the pulses hit too weakly")
    x, y, z = cloud.xyz[~in_air].T
    axis.scatter(x, y, s=0.5, c=z, cmap="cool", vmin=0, vmax=8, linewidths=0, rasterized=True)
    axis.scatter(*cloud.xyz[in_air, :2].T, s=1.0, c="gold", linewidths=0, rasterized=True)
    axis.set(xlim=(-32, 32), ylim=(-26, 22), aspect="equal", facecolor="black", xticks=[], yticks=[])
    axis.set_title(f"{name}\n{counts}", color="white", fontsize=12)
figure.savefig("weather.png", dpi=80)
