"""Hold presets against captures of real sensors; prints a table and writes reality.png.

captures.csv has the figures of the captures: noise (mm) at a range x (m), share of the pulses that a road at x returns
or that a wall at x loses, shares of edges with a dual return, a lost pulse or a mixed point at a jump of x, the median
intensity of a road at x, and how much intensities scatter from pulse to pulse along a ring. The table and where the
figures come from: lidarsim/presets/README.md.
"""

import csv
import dataclasses
import functools
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls

WHAT = {
    "noise": ("noise at {x} m, reflectivity {reflectivity}, mm", ".1f"),
    "road": ("road at {x} m, share returned", ".2f"),
    "dual returns": ("edges of {x} m, share with dual returns", ".2f"),
    "lost returns": ("edges of {x} m, share with lost pulses", ".2f"),
    "mixed points": ("edges of {x} m, share with mixed points", ".2f"),
    "holes": ("holes in surfaces at {x} m, share", ".4f"),
    "intensity": ("road at {x} m, median intensity", ".3f"),
    "scatter": ("{material} at {x} m, scatter of intensities", ".2f"),
}
BINS = {0.375: "0.3 to 0.45 m", 4.0: "3 to 5 m"}  # of the jump at an edge


@functools.cache
def edges(lidar: ls.Lidar, jump: float, material: ls.Material) -> ls.Comparison:
    """Compare with itself a scan of boards, 4 m away before a round wall; they lean, so edges meet columns anywhere."""
    scene = ls.Scene()
    scene.add(ls.Cylinder((0, 0, -20), (0, 0, 20), 4.0 + jump, capped=False), material=material)
    for angle in np.linspace(0.0, 6.0, 17):
        turn = Rotation.from_euler("xz", [0.07, angle])
        board = RigidTransform.from_components(turn.apply([4.0, 0.0, 0.0]), turn)
        scene.add(ls.Box((0.001, 0.5, 30)), material=material, transform=board)
    both = dataclasses.replace(lidar, measurement=dataclasses.replace(lidar.measurement, returns="dual"))
    return ls.compare(*[both.scan(scene, seed=1)] * 2)


def simulate(row: dict[str, str], noise: str) -> float:
    """Return the figure of a row of captures.csv for a preset with this noise."""
    lidar, x, quantity = ls.Lidar.preset(row["preset"], noise=noise), float(row["x"]), row["quantity"]
    roughness = float(row["roughness"] or 0.0) if noise == "measured" else 0.0  # data sheets: Lambert's law
    material = ls.Material(reflectivity=float(row["reflectivity"] or 1.0), roughness=roughness)
    if quantity in {"dual returns", "lost returns", "mixed points"}:
        if lidar.measurement.beam is None:
            return 0.0
        cells = {cell.label: cell.real for cell in edges(lidar, x, material)[f"{quantity} at edges"].cells}
        return cells[BINS[x]]
    angles, surface = np.linspace(-0.2, 0.2, 128), ls.Plane((1, 0, 0), x)
    pattern = ls.patterns.Grid(angles, angles, rate=10.0)
    if row["height"]:
        height = float(row["height"])
        surface = ls.Plane((0, 0, 1), -height)
        pattern = ls.patterns.Grid(np.linspace(-np.pi, np.pi, 4000), [-np.arcsin(height / x)], rate=10.0)
    if quantity == "scatter":
        material = ls.materials.named(row["material"])
        rings = pattern.elevations[0] + np.linspace(0.0, 1e-3, 64)
        pattern = ls.patterns.Grid(np.arange(-0.5, 0.5, np.radians(0.172)), rings, rate=10.0)
    scene = ls.Scene()
    scene.add(surface, material=material)
    effects = dataclasses.replace(lidar.measurement, beam=None, channel_bias_sigma=0.0)
    scan = dataclasses.replace(lidar, pattern=pattern, measurement=effects, range_offset=0.0).scan(scene, seed=1)
    if quantity == "noise":
        return float(1e3 * scan.point_cloud().range_error.std())
    if quantity == "intensity":
        seen = scan.intensity[~np.isnan(scan.intensity)]
        return float(np.median(seen)) if len(seen) else np.nan
    if quantity == "scatter":  # robust: of second differences, relative to the mean of three
        of = scan.image("intensity").T.astype(float)
        second = (of[2:] - 2 * of[1:-1] + of[:-2]) / 6**0.5
        return float(1.4826 * np.nanmedian(np.abs(second / ((of[2:] + of[1:-1] + of[:-2]) / 3))))
    return float(((scan.status == ls.Status.hit) == (quantity == "road")).mean())


rows = list(csv.DictReader(Path(__file__).with_name("captures.csv").read_text(encoding="utf-8").splitlines()))
results = [(row, float(row["real"]), simulate(row, "measured"), simulate(row, "datasheet")) for row in rows]
print("| preset | quantity | real | measured | data sheet | real unit |\n|---|---|---|---|---|---|")
for row, *figures in results:
    what, form = WHAT[row["quantity"]]
    shown = ["none" if np.isnan(figure) else format(figure, form) for figure in figures]
    print(f"| `{row['preset']}` | {what.format(**row)} | {' | '.join(shown)} | {row['unit']} |")

picture = Figure(figsize=(11, 4.4), layout="constrained")
noises, roads = picture.subplots(1, 2)
noise = np.array([figures for row, *figures in results if row["quantity"] == "noise"])
noises.loglog(noise[:, 0], noise[:, 1:], "o", label=["measured", "data sheet"])
noises.plot([1, 50], [1, 50], color="0.7", zorder=0)
noises.set(xlabel="noise of real ranges [mm]", ylabel="noise of simulated ranges [mm]")
noises.legend()
for name in dict.fromkeys(row["preset"] for row in rows if row["quantity"] == "road"):
    of = [(float(row["x"]), *f) for row, *f in results if (row["preset"], row["quantity"]) == (name, "road")]
    x, real, measured, sheet = np.array(of).T
    (line,) = roads.semilogx(x, measured, label=name)
    roads.plot(x, real, "o", x, sheet, ":", color=line.get_color())
roads.set(xlabel="range [m]", ylabel="share of pulses that a road returns")
picture.legend(*roads.get_legend_handles_labels(), loc="outside right upper", title="dots: real\ndotted: data sheet")
picture.savefig("reality.png", dpi=100)
