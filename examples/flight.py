"""Fly a survey in strips over a valley, and map its density, its overlap and its relief from the files."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LightSource

import lidarsim as ls

CONFIG = Path(__file__).parents[1] / "configs" / "airborne.yaml"
WEST, SOUTH, EAST, NORTH = AREA = 612_000, 5_264_000, 613_200, 5_264_700  # m, in UTM zone 32
CELL = 5.0  # m

run = ls.config.load(CONFIG)
strips = [ls.PointCloud.load(path) for path in run.write("flight.laz") if path.suffix == ".laz"]
for leg, strip in zip(run.legs, strips, strict=True):
    (start, end), angle = leg.pose.span, np.degrees(strip.scan_angle)
    angles = f"{angle.min():.1f} to {angle.max():.1f}°"
    print(f"strip {leg.number}: {start:.0f} to {end:.0f} s, {len(strip):,} points at scan angles from {angles}")

flight = ls.PointCloud.concatenate(strips)
counts = np.array([np.nan_to_num(strip.raster(cell=CELL, statistic="count", bounds=AREA).values) for strip in strips])
heights = flight.raster(cell=CELL, statistic="mean", bounds=AREA)
heights.save("heights.tif", crs=run.crs)
covered, water = (counts > 0).sum(axis=0), np.isnan(heights.values)
print(f"{counts.sum() / (~water).sum() / CELL**2:.2f} points/m², {(covered > 1).sum() / (~water).sum():.0%} seen twice")

shade = LightSource(azdeg=315, altdeg=40).hillshade(np.nan_to_num(heights.values, nan=520.0), dx=CELL, dy=CELL)
density = np.where(water, np.nan, counts.sum(axis=0) / CELL**2)
kilometres = {"extent": [WEST / 1e3, EAST / 1e3, SOUTH / 1e3, NORTH / 1e3], "interpolation": "nearest"}
figure, axes = plt.subplots(1, 3, figsize=(13, 2.9), layout="constrained", sharey=True)
steps, most = np.arange(len(strips) + 1), np.nanpercentile(density, 98)
colors = plt.get_cmap("Blues", len(steps))
maps = (
    axes[0].imshow(density, cmap="viridis", vmin=0.0, vmax=most, **kilometres),
    axes[1].imshow(np.where(water, np.nan, covered), cmap=colors, vmin=-0.5, vmax=len(strips) + 0.5, **kilometres),
    axes[2].imshow(heights.values, cmap="terrain", **kilometres),
)
axes[2].imshow(np.where(water, np.nan, shade), cmap="gray", alpha=0.55, **kilometres)
titles = (
    "density, points/m², and lines of flight",
    "number of strips that see a cell",
    "height, m, with its hillshade",
)
for axis, shown, title, ticks in zip(axes, maps, titles, (None, steps, None), strict=True):
    figure.colorbar(shown, ax=axis, shrink=0.68, ticks=ticks)
    axis.set(title=title, xlabel="east, km")
for leg in run.legs:
    axes[0].plot(*leg.pose.poses.translation[:, :2].T / 1e3, "w--", linewidth=1)
axes[0].ticklabel_format(useOffset=False)
axes[0].set(ylabel="north, km", xlim=(WEST / 1e3, EAST / 1e3), ylim=(SOUTH / 1e3, NORTH / 1e3))
figure.savefig("flight.png", dpi=80)
