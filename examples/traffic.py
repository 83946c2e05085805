"""Traffic in a town: over two hundred cars and people that never touch, and the boxes of what a car among them sees.

The recipe configs/recipes/traffic.yaml scatters things of several parts: cars whose wheels turn, and people whose limbs
swing. `lidarsim generate` makes a data set of it; this scans one frame of its first sequence.
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

import lidarsim as ls
from lidarsim.datasets.recipe import load

RECIPE = Path(__file__).parents[1] / "configs" / "recipes" / "traffic.yaml"
FRAME = 36
COLORS = {"car": "#4fc3f7", "person": "#ffb74d"}

recipe = load(RECIPE).source
run = recipe.run(0)
counts = Counter(item.group for item in recipe.placed[0])
print(f"{counts.total()} things:", ", ".join(f"{count} {group}" for group, count in counts.items()))

(scans,) = dataclasses.replace(run, frames=range(FRAME, FRAME + 1)).scans()
scan = scans[""]
cloud = scan.point_cloud("world", deskew="middle", deskew_movers=True)
boxes = scan.boxes(frame="world", deskew="middle")
named = np.array([boxes.class_names.get(label, "") for label in boxes.label.tolist()])
inside = boxes.contain(cloud.xyz)
for name in COLORS:
    chosen = np.flatnonzero((named == name) & (boxes.points > 0))
    own = cloud.instance == boxes.instance[chosen, None]
    share = (inside[chosen] & own).sum() / own.sum()
    moving = np.linalg.norm(boxes.velocity[chosen, :2], axis=1) > 0.1
    print(f"{name}: {len(chosen)} boxes, {moving.sum()} moving, {own.sum():,} points, {share:.2%} of them inside")

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
here = scan.pose.as_matrix()[:3, 3] if hasattr(scan.pose, "as_matrix") else run.pose.at(scan.time).translation
x, y = here[:2]
scan.plot(
    scene=run.scene,
    color_by="label",
    camera=[(x - 9, y + 1, 8), (x + 2, y + 14, 0), (0, 0, 1)],
    size=(760, 760),
    save=folder / "traffic.png",
)
close = imread(folder / "traffic.png")

figure = Figure((13, 6.5), facecolor="#14181f", layout="constrained")
above, beside = figure.subplots(1, 2, width_ratios=(1, 1))
above.set_facecolor("#14181f")
above.scatter(*cloud.xyz[:, :2].T, s=0.05, color="#78838f", linewidths=0)
for name, color in COLORS.items():
    chosen = named == name
    plan = boxes.corners[chosen][:, [0, 2, 6, 4], :2]  # the lower corners, in order
    above.add_collection(PolyCollection(plan, facecolors="none", edgecolors=color, linewidths=0.8, label=name))
    center, velocity = boxes.center[chosen, :2], boxes.velocity[chosen, :2]
    above.quiver(*center.T, *velocity.T, angles="xy", scale_units="xy", scale=1, width=0.0015, color=color)
above.plot(x, y, marker="*", color="white", markersize=9)
above.set(xlim=(x - 75, x + 75), ylim=(y - 75, y + 75), aspect="equal", xticks=[], yticks=[])
above.legend(loc="upper right", labelcolor="white", facecolor="#14181f", edgecolor="none")
beside.imshow(close)
beside.axis("off")
figure.savefig(folder / "traffic.png", dpi=85)
