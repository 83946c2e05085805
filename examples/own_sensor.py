"""A sensor of one's own: rings, pulse timing, range gate and noise in a few lines; writes own_sensor.png.

The same in YAML is configs/sensors/city-lidar.yaml, which starts from a preset. A table of directions
(`ls.patterns.Table`) or a vendor's calibration file (`ls.Lidar.from_file`) describes any other sensor.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import lidarsim as ls

CONFIG = Path(__file__).parents[1] / "configs" / "demo.yaml"

# 40 rings, dense at the horizon and sparse below, which all fire together at 1024 azimuths, ten times a second.
elevations = np.radians([*np.linspace(6, -6, 25), *np.linspace(-7, -25, 15)])
pattern = ls.patterns.Spinning(elevations=elevations, columns=1024, rate=10.0)

# It resolves millimetres, errs by a centimetre, and more where little light returns; beyond that it detects nothing.
measurement = ls.Measurement(range_sigma=0.01, range_resolution=0.001, detection=ls.Detection(0.1, 80.0))
lidar = ls.Lidar(pattern, measurement=measurement, min_range=0.5, max_range=80.0, name="mine")
print(lidar)

run = ls.config.load(CONFIG)
scan = lidar.scan(run.scene, run.pose, seed=1)
print(scan.summary())
cloud = scan.point_cloud("world")
print(f"range noise: {1e3 * np.std(cloud.range_error):.1f} mm")
cloud.plot(scene=run.scene, color_by="ring", pose=run.pose, size=(1000, 620), save="own_sensor.png")
