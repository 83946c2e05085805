"""Traffic in a town: over two hundred cars and people that never touch, and the boxes of what a car among them sees.

The recipe configs/recipes/traffic.yaml scatters instances of several parts: cars whose wheels turn, and people whose
limbs swing. `lidarsim generate` makes a data set of it; this scans one frame of its first sequence.
Usage: python traffic.py [FOLDER]
"""

from __future__ import annotations

import dataclasses
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.image import imread

from lidarsim.datasets.recipe import load

RECIPE = Path(__file__).parents[1] / "configs" / "recipes" / "traffic.yaml"
FRAME = 36
COLORS = {"car": "#4fc3f7", "person": "#ffb74d"}

recipe = load(RECIPE, ["run.sensor.noise=none"]).source  # noise moves points out of their boxes
run = recipe.run(0)
instances, _ = recipe.placed[0]
counts = Counter(item.group for item in instances)
print(f"{counts.total()} instances:", ", ".join(f"{count} {group}" for group, count in counts.items()))

((scan,),) = (scans.values() for scans in dataclasses.replace(run, frames=range(FRAME, FRAME + 1)).scans())
cloud = scan.point_cloud("world", deskew="middle", deskew_movers=True)
boxes = scan.boxes(frame="world", deskew="middle", min_points=1)
named = np.array([boxes.class_names.get(label, "") for label in boxes.label.tolist()])
inside = boxes.contain(cloud.xyz)
for name in COLORS:
    chosen = np.flatnonzero(named == name)
    own = cloud.instance == boxes.instance[chosen, None]
    share = (inside[chosen] & own).sum() / own.sum()
    moving = np.linalg.norm(boxes.velocity[chosen, :2], axis=1) > 0.1
    print(f"{name}: {len(chosen)} boxes, {moving.sum()} moving, {own.sum():,} points, {share:.2%} of them inside")

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
picture = folder / "traffic.png"
run.scene.plot(camera=[(-6, -97, 5), (3, -66, 0.5), (0, 0, 1)], color_by="label", size=(1000, 760), save=picture)
street = imread(picture)[:, :740]  # without the legend

figure = Figure((12, 6), facecolor="#14181f", layout="constrained")
above, beside = figure.subplots(1, 2, width_ratios=(1, 740 / 760))
above.set_facecolor("#14181f")
x, y = run.pose.at(scan.time).translation[:2]
above.scatter(*cloud.xyz[:, :2].T, s=0.1, color="#78838f", linewidths=0)
for name, color in COLORS.items():
    chosen = named == name
    plan = boxes.corners[chosen][:, [0, 2, 6, 4], :2]  # the lower corners, in order
    above.add_collection(PolyCollection(plan, facecolors="none", edgecolors=color, linewidths=1, label=name))
    center, velocity = boxes.center[chosen, :2], boxes.velocity[chosen, :2]
    above.quiver(*center.T, *velocity.T, angles="xy", scale_units="xy", scale=1, width=0.002, color=color)
above.plot(x, y, marker="*", color="white", markersize=9)
above.set(xlim=(x - 60, x + 60), ylim=(y - 60, y + 60), aspect="equal", xticks=[], yticks=[])
above.legend(loc="upper right", labelcolor="white", facecolor="#14181f", edgecolor="none")
beside.imshow(street)
beside.axis("off")
figure.savefig(picture, dpi=90)
