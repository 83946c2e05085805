"""Make the valley of configs/scenes/valley.tif, a digital elevation model with a lake, and fly a survey over it.

The hills are random, smooth at small scale. The lake has no data, as in elevation models made by lidar: water returns
few pulses, and here none. Usage: python make_terrain.py [FILE]; also writes make_terrain.png.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import rasterio

import lidarsim as ls

ROWS, COLUMNS, SPACING = 140, 240, 5.0  # m
WEST, NORTH = 612_000.0, 5_264_700.0  # m, in UTM zone 32
GROUND, NO_DATA = 2, -9999.0


def valley() -> np.ndarray:
    """Return heights, m, from north to south; NaN in the lake."""
    rng = np.random.default_rng(4)
    waves = np.hypot(*np.meshgrid(np.fft.fftfreq(COLUMNS), np.fft.fftfreq(ROWS)))  # per node
    waves[0, 0] = np.inf  # no mean
    hills = np.fft.ifft2(np.fft.fft2(rng.normal(size=waves.shape)) * waves**-2.2).real
    x, y = np.meshgrid(np.linspace(-1, 1, COLUMNS), np.linspace(1, -1, ROWS))
    basin = np.exp(-(((x - 0.15) / 0.3) ** 2) - ((y - 0.1) / 0.4) ** 2)
    z = 560 + 22 * hills / hills.std() + 60 * y**2 - 60 * basin
    z = np.round(16 * z) / 16  # m; few digits compress well
    lake = (basin > 0.2) & (z < np.quantile(z[basin > 0.2], 0.3))
    return np.where(lake, np.nan, z)


z = valley()
path = Path(sys.argv[1] if len(sys.argv) > 1 else "valley.tif")
profile = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": "EPSG:32632", "nodata": NO_DATA}
place = rasterio.Affine(SPACING, 0, WEST, 0, -SPACING, NORTH)
smallest = {"compress": "deflate", "predictor": 3, "zlevel": 9}
with rasterio.open(path, "w", height=ROWS, width=COLUMNS, transform=place, **profile, **smallest) as file:
    file.write(np.where(np.isnan(z), NO_DATA, z).astype(np.float32), 1)

terrain = ls.TriangleMesh.from_raster(path)
scene = ls.Scene(class_names={GROUND: "ground"})
scene.add(terrain, name="valley", label=GROUND, material=ls.materials.GRASS)
print(f"{path}: {terrain}, {z.size - len(terrain.vertices):,} nodes of lake, {path.stat().st_size / 1e3:.0f} kB")

# A scanner with an oscillating mirror, 450 m above the valley, at 60 m/s to the east. Its x axis points down, z ahead.
lidar = ls.Lidar.preset("leica-als50", mode="20khz", noise="datasheet")
lidar = replace(lidar, pattern=replace(lidar.pattern, rate=0.05))  # 20 s in one frame
start = np.eye(4)
start[:3] = [(0, 0, 1, WEST), (0, 1, 0, NORTH - ROWS * SPACING / 2), (-1, 0, 0, 1000)]
flight = ls.Trajectory.from_twist(start, linear=(0, 0, 60), angular=(0, 0, 0))
scan = lidar.scan(scene, flight)
print(scan.summary())
ls.show(scan, scene=scene, color_by="height", camera="orbit", size=(1000, 620), save="make_terrain.png")
