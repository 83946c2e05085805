"""Hold presets against captures of real sensors; prints a table and writes reality.png.

captures.csv has the figures of the captures: the noise of ranges (mm) at a range (m) and a reflectivity, the share of
pulses that a road returns at a range, the shares of edges with a dual return or a mixed point at a jump of the range,
and the share of pulses lost on smooth surfaces. lidarsim/presets/README.md says where they come from.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import lidarsim as ls

HEIGHTS = {"ouster-os0-128": 1.963, "ouster-os1-128": 1.932, "velodyne-vls128": 1.979, "velodyne-hdl64e-s3": 1.753}
ROUGHNESS = {"ouster-os0-128": 0.3, "ouster-os1-128": 0.3, "velodyne-vls128": 0.2, "velodyne-hdl64e-s3": 1.2}
"""Roughness of the roads with which the detection of the presets was fitted; data sheets are held against Lambert's."""


def looking(lidar: ls.Lidar, pattern: ls.patterns.Grid, scene: ls.Scene) -> ls.Scan:
    """Scan with the effects of a sensor but without its beam and the biases of its channels."""
    effects = dataclasses.replace(lidar.measurement, beam=None, channel_bias_sigma=0.0)
    return dataclasses.replace(lidar, pattern=pattern, measurement=effects, range_offset=0.0).scan(scene, seed=1)


def wall(lidar: ls.Lidar, distance: float, reflectivity: float) -> ls.Scan:
    """Scan a wall that the sensor faces."""
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), distance), material=ls.Material(reflectivity=reflectivity))
    angles = np.linspace(-0.2, 0.2, 128)
    return looking(lidar, ls.patterns.Grid(angles, angles, rate=10.0), scene)


def road(lidar: ls.Lidar, distance: float, reflectivity: float, roughness: float) -> float:
    """Return the share of the pulses of a ring that a road returns."""
    height = HEIGHTS[lidar.name]
    scene = ls.Scene()
    asphalt = ls.Material(reflectivity=reflectivity, roughness=roughness)
    scene.add(ls.Plane((0, 0, 1), -height), material=asphalt)
    ring = ls.patterns.Grid(np.linspace(-np.pi, np.pi, 4000), [-np.arcsin(height / distance)], rate=10.0)
    return float((looking(lidar, ring, scene).status == ls.Status.hit).mean())


@functools.cache
def edges(lidar: ls.Lidar, jump: float, reflectivity: float) -> dict[str, float]:
    """Return the shares of vertical edges with a dual return and with a mixed point, at walls 3 m and more away."""
    if lidar.measurement.beam is None:
        return {"dual": 0.0, "mixed": 0.0}
    # 36 walls, alternately near and far; they lean, so that rings meet their edges at all phases of their columns
    angle = np.linspace(0, 2 * np.pi, 36 * 8 + 1)
    radius = np.where(np.arange(36 * 8) // 8 % 2, 3.0 + jump, 3.0)
    corners = np.stack(
        [
            np.stack([radius * np.cos(a), radius * np.sin(a), np.full_like(radius, z)], axis=-1)
            for z, lean in ((-20.0, 0.0), (20.0, 1.0))
            for a in (angle[:-1] + lean, angle[1:] + lean)
        ],
        axis=1,
    )
    faces = 4 * np.arange(len(radius))[:, None, None] + [[0, 1, 2], [1, 3, 2]]
    scene = ls.Scene()
    mesh = ls.TriangleMesh(corners.reshape(-1, 3), faces.reshape(-1, 3))
    scene.add(mesh, material=ls.Material(reflectivity=reflectivity))
    both = dataclasses.replace(lidar, measurement=dataclasses.replace(lidar.measurement, returns="dual"))
    scan = both.scan(scene, seed=1)
    comparison = ls.compare(scan, scan)
    found = {}
    for name, measure in (("dual", "dual returns at edges"), ("mixed", "mixed points at edges")):
        cells = comparison[measure].cells
        found[name] = max(cells, key=lambda cell: cell.n_real).real
    return found


def simulated(row: dict[str, str], noise: str) -> float:
    """Return the figure of a row of captures.csv for a preset with this noise."""
    lidar, x, reflectivity = preset(row["preset"], noise), float(row["x"]), float(row["reflectivity"])
    if row["quantity"] == "noise":
        return float(1e3 * wall(lidar, x, reflectivity).point_cloud().range_error.std())
    if row["quantity"] == "holes":
        return float((wall(lidar, x, reflectivity).status != ls.Status.hit).mean())
    if row["quantity"] == "road":
        return road(lidar, x, reflectivity, ROUGHNESS[lidar.name] if noise == "measured" else 0.0)
    return edges(lidar, x, reflectivity)[row["quantity"]]


preset = functools.cache(lambda name, noise: ls.Lidar.preset(name, noise=noise))
with Path(__file__).with_name("captures.csv").open(encoding="utf-8", newline="") as file:
    rows = list(csv.DictReader(file))

WHAT = {
    "noise": "noise at {x} m, reflectivity {reflectivity}, mm",
    "road": "road at {x} m, share returned",
    "dual": "edges of {x} m, share with dual returns",
    "mixed": "edges of {x} m, share with mixed points",
    "holes": "holes in surfaces at {x} m, share",
}
print("| preset | quantity | real | measured | data sheet | real unit |")
print("|---|---|---|---|---|---|")
figure = Figure(figsize=(10, 4.4), layout="constrained")
noises, roads = figure.subplots(1, 2)
results = [(row, float(row["real"]), *(simulated(row, noise) for noise in ("measured", "datasheet"))) for row in rows]
for row, real, measured, sheet in results:
    form = {"noise": ".1f", "holes": ".4f"}.get(row["quantity"], ".2f")
    numbers = " | ".join(format(value, form) for value in (real, measured, sheet))
    print(f"| `{row['preset']}` | {WHAT[row['quantity']].format(**row)} | {numbers} | {row['unit']} |")

noise = np.array([result[1:] for result in results if result[0]["quantity"] == "noise"])
noises.plot([1, 50], [1, 50], color="0.7", zorder=0)
noises.loglog(noise[:, 0], noise[:, 1], "o", color="tab:blue", label="measured")
noises.loglog(noise[:, 0], noise[:, 2], "o", color="tab:orange", fillstyle="none", label="data sheet")
noises.set(xlabel="noise of real ranges [mm]", ylabel="noise of simulated ranges [mm]")
noises.legend()
for number, name in enumerate(HEIGHTS):
    x, real, measured, sheet = np.array(
        [(float(row["x"]), *values) for row, *values in results if (row["preset"], row["quantity"]) == (name, "road")]
    ).T
    roads.plot(x, real, "o", color=f"C{number}", label=name)
    roads.plot(x, measured, color=f"C{number}")
    roads.plot(x, sheet, ":", color=f"C{number}")
roads.set(xscale="log", xlabel="range [m]", ylabel="share of pulses that a road returns")
roads.set_title("dots: real, lines: measured, dotted: data sheet", fontsize=9)
roads.legend(fontsize=8)
figure.savefig("reality.png", dpi=100)
